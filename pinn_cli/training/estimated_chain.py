"""The model with its estimated parameters in place."""

from __future__ import annotations

from collections.abc import Iterable

from pinn_cli.system.chain import Chain
from pinn_cli.training.estimate import ParameterEstimate


def estimated_chain(prescribed: Chain, parameters: Iterable[ParameterEstimate]) -> Chain:
    """The prescribed chain with its estimated parameters in place; those that are not listed stay as prescribed.

    Raises:
        ValueError: A parameter that the chain does not have.
    """
    values = {symbol: value.detach().cpu().double().clone() for symbol, value in prescribed.parameters.items()}
    for parameter in parameters:
        symbol, connection = split_name(parameter.name)
        if symbol not in values or connection > prescribed.ndof:
            raise ValueError(f"the chain of {prescribed.ndof} DOFs has no parameter {parameter.name}")
        values[symbol][connection - 1] = parameter.estimate
    return prescribed.with_parameters(**values)


def split_name(name: str) -> tuple[str, int]:
    """Symbol and connection of a parameter's name: ``kappa_4`` is ("kappa", 4).

    Raises:
        ValueError: If the name does not end in an underscore and a connection counted from 1.
    """
    symbol, _, connection = name.rpartition("_")
    if not symbol or not connection.isdigit() or int(connection) < 1:
        raise ValueError(f"parameter name {name!r} is not a symbol and a connection, such as k_2")
    return symbol, int(connection)
