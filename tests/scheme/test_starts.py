"""How many starts unknown parameters have, and where."""

from __future__ import annotations

import numpy as np
import pytest
from calls import PinnRun
from independent_records import IndependentRecord, frame_record

from pinn_cli.record.amplitudes import motion_amplitudes
from pinn_cli.record.record import Record
from pinn_cli.scheme.starts import checked_starts
from pinn_cli.scheme.state_parameter import StateParameter
from pinn_cli.system.building import build_chain
from pinn_cli.system.connection import Duffing
from pinn_cli.system.topology import build_partial_structure


@pytest.fixture(scope="module")
def made() -> IndependentRecord:
    return frame_record(rate=100.0, duration=20.0)


def posed(made: IndependentRecord, factor: float, **settings):
    s = made.structure
    structure = build_chain(
        3, Duffing(), m=s.m.tolist(), c=s.c.tolist(), k=(factor * s.k).tolist(), kappa=s.kappa.tolist()
    )
    scheme = StateParameter(unobserved=[], unknown="k_*", **settings)
    return scheme.pose(structure, [made.record])


def starts(problem) -> list[np.ndarray]:
    return [np.array([q.prescribed for q in p.alone.uncertain if q.unknown]) for p in problem.starts]


def test_auto_and_whole_numbers_are_settings():
    assert checked_starts("auto") is None
    assert [checked_starts(n) for n in (1, 5)] == [1, 5]


@pytest.mark.parametrize("value", ["0", "-1", "1.5", "many", "null", "true"])
def test_others_are_refused_in_one_line(pinn_run: PinnRun, value: str) -> None:
    done = pinn_run("scheme=state_parameter", f"scheme.starts={value}")
    assert done.status == 2
    assert done.err.strip().count("\n") == 0
    assert done.err.startswith(f"pinn-run: scheme.starts={value if value not in ('null', 'true') else ''}")
    assert "must be auto, given, or a whole number >= 1" in done.err


@pytest.mark.parametrize("factor", [0.1, 1.0, 10.0])
def test_the_first_start_is_near_whatever_a_user_says(made, factor):
    """A cubic spring makes the linear one that comes nearest stiffer than its own stiffness."""
    first = starts(posed(made, factor))[0] / made.structure.k
    assert np.all((first > 0.8) & (first < 2.0))


def test_there_are_no_more_starts_than_asked_for(made):
    assert len(starts(posed(made, 10.0, starts=1))) == 1
    several = starts(posed(made, 10.0, starts=3))
    assert 1 <= len(several) <= 3
    for i, one in enumerate(several):
        assert all(np.abs(np.log(one / other)).max() > 0.01 for other in several[:i])


@pytest.mark.parametrize("factor", [0.01, 1.0, 100.0])
def test_what_the_user_says_is_a_start_of_its_own_beside_those_of_the_record(made, factor):
    """Unless the record starts there anyway, or a single start is asked for."""
    said = factor * made.structure.k * np.array([1.0, 1.3, 0.8])
    structure = build_chain(3, Duffing(), m=2000.0, c=[3000.0, 2800.0, 2400.0], k=said.tolist(), kappa=[5e9, 0.0, 0.0])
    for settings, last in (({}, True), ({"starts": 2}, True), ({"starts": 1}, False)):
        problem = StateParameter(unobserved=[], unknown="k_*", **settings).pose(structure, [made.record])
        assert np.allclose(starts(problem)[-1], said, rtol=1e-12) is last
        assert [p.said for p in problem.alone.uncertain if p.unknown] == pytest.approx(said)
    alone = build_chain(3, Duffing(), m=2000.0, c=3000.0, k=(1.05 * starts(problem)[0]).tolist(), kappa=0.0)
    near = StateParameter(unobserved=[], unknown="k_*").pose(alone, [made.record])
    assert not any(np.allclose(one, [p.said for p in near.alone.uncertain if p.unknown]) for one in starts(near))


def test_without_a_spring_the_force_says_how_large_damping_and_friction_may_be(made):
    """A mass on a guide; a spring of no stiffness was 0 / 0."""
    guide = {"between": ["ground", "x"], "law": "friction", "speed": 0.01, "c": None, "k": 0.0, "F_c": None}
    structure = build_partial_structure(["x"], {"x": 2000.0}, {"guide": guide})
    one = slice(2, 3)
    columns = {q: getattr(made.record, q)[:, one] for q in ("displacement", "velocity", "acceleration", "force")}
    record = Record(made.record.time, **columns, unforced=np.zeros(1, bool))
    problem = StateParameter(unobserved=[], unknown="missing").pose(structure, [record]).alone
    unknown = {p.kind: p for p in problem.uncertain}
    force, size = record.force.std(), motion_amplitudes(record)
    assert unknown["c"].scale == pytest.approx(force / size["velocity"], rel=0.01)
    assert unknown["F_c"].scale == pytest.approx(force, rel=0.1)
    assert (unknown["c"].prior_std, unknown["F_c"].prior_std) == (10 * unknown["c"].scale, 10 * unknown["F_c"].scale)


def test_alternatives_are_the_same_problem_from_elsewhere(made):
    problem = posed(made, 10.0, starts=3)
    for other in problem.other_starts:
        assert other.alone.record is problem.alone.record
        assert [p.name for p in other.alone.uncertain] == [p.name for p in problem.alone.uncertain]
        assert not other.other_starts


def test_priors_are_as_wide_as_the_start_is_large_and_as_starts_of_its_kind_are(made):
    """A start decades too low would shut the truth out, were its prior as narrow as that."""
    unknown = [p for p in posed(made, 1.0, prior_width=7.0).alone.uncertain if p.unknown]
    typical = np.median([p.prescribed for p in unknown])
    for parameter in unknown:
        assert parameter.prior_std == pytest.approx(7.0 * max(parameter.prescribed, typical))
        assert parameter.lower == -parameter.prescribed
