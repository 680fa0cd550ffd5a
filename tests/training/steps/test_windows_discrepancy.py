"""The discrepancy that windows say together, of records whose log evidence is given."""

from collections.abc import Callable
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from pinn_cli.model.knowledge import DiscrepancyEvidence
from pinn_cli.training.evidence import Trained
from pinn_cli.training.noise_model import NoiseLevels, NoiseModel
from pinn_cli.training.steps import windows_discrepancy
from pinn_cli.training.steps.windows_discrepancy import of_all_windows

# N: the sensors' noise hides what is much smaller than one.
LEAST = 1e-2
NOISE = NoiseLevels((NoiseModel({}, np.zeros(1), 1.0, 1.0),))


def hidden(values: float, found: float) -> Callable[[float], float]:
    """Log evidence of so many values with noise of one beside a discrepancy, which together have a size."""
    return lambda d: -0.5 * values * (np.log(1.0 + d**2) + found**2 / (1.0 + d**2))


def window(
    log_evidence: Callable[[float], float], own: float, before: DiscrepancyEvidence | None
) -> tuple[Any, DiscrepancyEvidence]:
    """A window of that evidence whose own search ended somewhere; where all windows put it."""

    def train(noise: NoiseLevels, *arguments: object, **settings: object) -> Any:
        found: Any = SimpleNamespace(point=None, converged=True)
        return Trained(found, noise, None, log_evidence(noise.discrepancy))  # type: ignore[arg-type]

    def floors(_: object, trained: Any) -> list[Any]:
        return [SimpleNamespace(discrepancy=min(LEAST, trained.noise.discrepancy))]

    levels = None if before is None else SimpleNamespace(windows=before)
    problem = SimpleNamespace(first=SimpleNamespace(earlier_levels=levels))
    evidence: Any = SimpleNamespace(problem=problem, train=train, each_record=floors)
    return of_all_windows(evidence, train(NOISE.with_discrepancy(own)))


@pytest.fixture(autouse=True)
def plain_units(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(windows_discrepancy, "discrepancy_unit", lambda evidence: 1.0)


def test_where_a_record_leaves_it_open_the_smallest_is_taken():
    found, told = window(hidden(10, 1.0), own=0.3, before=None)
    assert found.noise.discrepancy == pytest.approx(LEAST)
    assert found.noise.records[0].earlier_misfit == 1.0
    assert told.common
    assert told.at(np.array([-2.0, -1.0])) == pytest.approx([0.0, 0.0], abs=0.2)
    assert told.at(np.array([0.5]))[0] < -5.0


def test_what_no_window_tells_alone_they_tell_together():
    """Each is by 0.4 more probable with a discrepancy: twelve are sure of it, and of its size."""
    each, told, sizes, factors = hidden(10, 1.2), None, [], []
    for _ in range(12):
        found, told = window(each, own=0.05, before=told)
        sizes.append(found.noise.discrepancy)
        factors.append(found.noise.records[0].earlier_misfit)
    assert sizes[0] == pytest.approx(LEAST)
    assert 0.5 < sizes[-1] < 1.0
    # What earlier windows hid is counted with the size that is known now.
    assert np.prod(factors) == pytest.approx(sizes[0] / sizes[-1])


def test_a_window_that_tells_by_itself_keeps_its_own():
    _, before = window(hidden(10, 1.0), own=0.3, before=None)
    found, told = window(hidden(400, 3.0), own=2.8, before=before)
    assert found.noise.discrepancy == pytest.approx(2.8)
    assert not told.common
    assert told.at(np.array([-2.0, 0.0, 0.5])) == pytest.approx(before.at(np.array([-2.0, 0.0, 0.5])))
    after, told = window(hidden(10, 1.0), own=0.3, before=told)
    assert after.noise.discrepancy == pytest.approx(LEAST)
    assert after.noise.records[0].earlier_misfit == 1.0
    assert told.common


def test_a_window_that_contradicts_those_before_keeps_its_own():
    told = None
    for _ in range(20):
        _, told = window(hidden(10, 0.7), own=0.3, before=told)
    found, told = window(hidden(12, 2.2), own=1.9, before=told)
    assert found.noise.discrepancy == pytest.approx(1.9)
    assert not told.common
