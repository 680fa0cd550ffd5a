"""What a search may choose: the distribution of a setting, by its override, and what a trial has of it."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

from hydra.core.override_parser.types import IntervalSweep, Override, RangeSweep, Transformer
from optuna.distributions import BaseDistribution, CategoricalDistribution, FloatDistribution, IntDistribution

from pinn_cli.sweep.directories import parse


def read_space(overrides: Iterable[str]) -> tuple[dict[str, BaseDistribution], dict[str, str]]:
    """The settings that are searched, and the values of the others.

    Args:
        overrides: As typed; of those for one setting the last counts.

    Returns:
        Name to distribution, and name to value as text.
    """
    space: dict[str, BaseDistribution] = {}
    fixed: dict[str, str] = {}
    for override in map(parse, overrides):
        name = override.get_key_element()
        space.pop(name, None)
        fixed.pop(name, None)
        if override.is_sweep_override():
            space[name] = distribution(override)
        else:
            fixed[name] = override.get_value_element_as_str()
    return space, fixed


def distribution(override: Override) -> BaseDistribution:
    """Of `choice(a,b)`, `a,b`, `range(1,4)` with both its ends, `interval(1,3)`, `tag(log,interval(1,3))`."""
    value = override.value()
    if isinstance(value, IntervalSweep):
        return _numbers(value.start, value.end, log="log" in value.tags)
    if isinstance(value, RangeSweep):  # an order, as shuffle gives it one, means nothing here
        return _numbers(value.start, value.stop, step=value.step)
    choices: list[Any] = list(override.sweep_iterator(transformer=Transformer.encode))
    return CategoricalDistribution(choices)


def _numbers(low: Any, high: Any, step: Any = None, log: bool = False) -> BaseDistribution:
    if all(isinstance(number, int) for number in (low, high, 1 if step is None else step)):
        return IntDistribution(low, high, log=log, step=1 if step is None else step)
    return FloatDistribution(low, high, log=log, step=step)


def within(distribution: BaseDistribution, value: Any) -> Any:
    """The value as the distribution has it; None where it cannot be drawn from it."""
    if isinstance(distribution, CategoricalDistribution):
        alike = (c for c in distribution.choices if c == value and isinstance(c, bool) == isinstance(value, bool))
        return next(alike, None)
    if isinstance(value, bool) or not isinstance(value, int | float) or value != value:
        return None
    low, high, step = distribution.low, distribution.high, distribution.step  # type: ignore[attr-defined]
    if not low <= value <= high or (step and (value - low) % step):
        return None
    return int(value) if isinstance(distribution, IntDistribution) else float(value)
