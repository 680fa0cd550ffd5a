"""Polynomial spring."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from typing import Any

from pinn_cli.settings.errors import InputError
from pinn_cli.settings.legal_values import entries, is_whole_number
from pinn_cli.system.array_namespace import Array
from pinn_cli.system.connection.nonlinearity import Nonlinearity

LEAST_ORDER, MOST_ORDER = 2, 7
# One that is not the same in both directions, and one that is.
LOWEST_ORDERS = (2, 3)
_ORDINALS = ("Quadratic", "Cubic", "Quartic", "Quintic", "Sextic", "Septic")


class Polynomial(Nonlinearity):
    """Polynomial spring, r_n = k_2 e^2 + k_3 e^3 + ... + k_7 e^7, k_j in N/m^j.

    Args:
        orders: Those that the spring has; None: those whose coefficients are given, else `LOWEST_ORDERS`.

    Raises:
        InputError: ``orders`` are no different whole numbers from 2 to 7.
    """

    name = "polynomial"
    optional = tuple(f"k_{order}" for order in range(LEAST_ORDER, MOST_ORDER + 1))

    def __init__(self, orders: Sequence[int] | None = None) -> None:
        self.orders = None if orders is None else _checked_orders(orders)
        self.parameters = tuple(f"k_{order}" for order in self.orders or ())
        self.titles = {f"k_{order}": _ORDINALS[order - LEAST_ORDER] for order in self.orders or ()}
        self.units = {f"k_{order}": f"N/m^{order}" for order in self.orders or ()}

    def of_given(self, given: Collection[str]) -> Polynomial:
        """See :meth:`Nonlinearity.of_given`; where nothing is known of any order, `LOWEST_ORDERS`."""
        if self.orders is not None:
            return self
        orders = [order for order in range(LEAST_ORDER, MOST_ORDER + 1) if f"k_{order}" in given]
        return Polynomial(orders or LOWEST_ORDERS)

    def force(self, e: Array, de: Array, parameters: Mapping[str, Array]) -> Array:
        """See :meth:`Nonlinearity.force`."""
        # Horner's scheme: products, not powers, which cost ten times as much on a short vector.
        given = set(self.orders or ())
        total: Array = 0.0 * e
        for order in range(max(given, default=1), LEAST_ORDER - 1, -1):
            total = (total + parameters[f"k_{order}"] if order in given else total) * e
        return total * e


def _checked_orders(orders: Any) -> tuple[int, ...]:
    numbers = entries(orders)
    legal = all(is_whole_number(order) and LEAST_ORDER <= order <= MOST_ORDER for order in numbers)
    if not numbers or not legal or len(set(numbers)) < len(numbers):
        allowed = f"a list of different orders from {LEAST_ORDER} to {MOST_ORDER}, or null"
        raise InputError("system.nonlinearity.orders", orders, allowed, "the linear part is k")
    return tuple(sorted(int(order) for order in numbers))
