"""The families of random structures: each is a module of this folder with `draw(seed)`."""

from __future__ import annotations

from importlib import import_module

from benchmarks.trust.case import Case

FAMILIES = (
    "chain",
    "topology",
    "ground",
    "damping",
    "nonlinear",
    "degrading",
    "unknown_law",
    "unmeasured",
    "unmeasured_nonlinear",
    "lost_ground",
    "wind",
    "transient",
    "finite_elements",
    "sensors",
    "records",
    "posterior",
    "spoilt",
)


def drawn(family: str, seed: int) -> Case:
    """The case of a family and a seed: the same whenever it is drawn."""
    found = import_module(f"{__name__}.{family}").draw(seed)
    assert isinstance(found, Case)
    return found
