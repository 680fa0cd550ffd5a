"""The cases, the counting and the exponents of `make bench`."""

from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from hydra.core.override_parser.overrides_parser import OverridesParser

from benchmarks.__main__ import exponents
from benchmarks.cases import grid, ring, structure
from benchmarks.scaling_figure import draw


def table() -> pd.DataFrame:
    size = np.array([10.0, 20.0, 40.0])
    own = {"training_cpu_s": 0.1 * size**2, "whole_cpu_s": 3.0 * size, "memory_mib": 50.0 * size**0.5}
    own |= {"gflop": size**3, "gflop_per_s": size, "factorisations": 20, "smoother_cpu_s": [1.0, 4.0, np.nan]}
    chain = pd.DataFrame({"against": "ndof", "ndof": size, "duration_s": 60, "topology": "chain", **own})
    return pd.concat([chain, chain.assign(against="topology", topology="grid")])


def test_exponents_are_slopes_of_logarithms() -> None:
    found = exponents(table()).set_index("against").loc["ndof"]
    expected = {"training_cpu_s": 2.0, "whole_cpu_s": 1.0, "memory_mib": 0.5, "gflop": 3.0, "smoother_cpu_s": 2.0}
    assert {name: found[name] for name in expected} == pytest.approx(expected)


def test_a_ring_and_a_grid_have_the_connections_of_their_kind() -> None:
    assert sorted(ring(3)) == sorted(
        [("ground", "m1"), ("ground", "m2"), ("ground", "m3"), ("m1", "m2"), ("m2", "m3"), ("m3", "m1")]
    )
    assert set(grid(2)) == {("ground", "m1"), ("m1", "m2"), ("ground", "m3"), ("m3", "m4"), ("m1", "m3"), ("m2", "m4")}


def test_the_overrides_are_read_as_a_structure() -> None:
    parsed = OverridesParser.create().parse_overrides(list(structure(grid(2))))
    values = {override.key_or_group: override.value() for override in parsed}
    assert values["system.dofs"] == ["m1", "m2", "m3", "m4"]
    connections = values["system.connections"]
    assert [tuple(each["between"]) for each in connections.values()] == list(grid(2))
    assert {each["law"] for each in connections.values()} == {"duffing"}


def test_the_figure_is_drawn(tmp_path: Path) -> None:
    assert all(place.stat().st_size > 5000 for place in draw(table(), 20.0, tmp_path))
