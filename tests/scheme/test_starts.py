"""Which parameters of a structure are unknown, what must be given, how many starts there are, and where."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
import torch
from calls import Compose, PinnRun, refusal
from independent_records import IndependentRecord, frame, frame_record, measured, random_force
from omegaconf import DictConfig
from small_problems import accelerations, small_chain
from small_problems import measured as simulated

from pinn_cli.cli.config import RunConfig
from pinn_cli.record.channels import motion_amplitudes
from pinn_cli.record.excitation import BandedNoise
from pinn_cli.record.record import Record
from pinn_cli.record.simulated import Noise, Simulated
from pinn_cli.record.simulation import Simulation
from pinn_cli.scheme import starts as starting
from pinn_cli.scheme.bayesian import Bayesian
from pinn_cli.scheme.problem import Problem
from pinn_cli.scheme.scheme import check_given
from pinn_cli.scheme.starts import checked_starts
from pinn_cli.scheme.state_parameter import StateParameter
from pinn_cli.scheme.unknowns import parameters_called, unknown_parameters
from pinn_cli.settings.errors import InputError
from pinn_cli.system.building import build_chain
from pinn_cli.system.connection import Duffing, Polynomial
from pinn_cli.system.topology import build_structure

CONNECTIONS = {
    "storey_1": {"between": ["ground", "x1"], "law": "duffing", "c": 4500, "k": 1.5e6, "kappa": 1e9},
    "storey_2": {"between": ["x1", "x2"], "law": "linear", "c": 4200, "k": 1.4e6},
    "storey_3": {"between": ["x2", "x3"], "law": "linear", "c": 3600, "k": 1.2e6},
    "brace": {"between": ["ground", "x2"], "law": "polynomial", "c": 300, "k": 4e5, "k_3": 1e9},
    "damper": {"between": ["x1", "x3"], "law": "linear", "c": 3000, "k": 0},
    "slide": {"weights": {"x1": -0.8, "x3": 0.8}, "law": "friction", "speed": 0.02, "c": 0, "k": 0, "F_c": 50},
}
FRAME = build_structure(["x1", "x2", "x3"], {"x1": 2000, "x2": 2000, "x3": 1500}, CONNECTIONS)


@pytest.fixture(scope="module")
def made() -> IndependentRecord:
    return frame_record(duration=8.0)


def posed(made: IndependentRecord, factor: float, **settings):
    s = made.structure
    structure = build_chain(
        3, Duffing(), m=s.m.tolist(), c=s.c.tolist(), k=(factor * s.k).tolist(), kappa=s.kappa.tolist()
    )
    scheme = StateParameter(unobserved=[], unknown="k_*", **settings)
    return scheme.pose(structure, [made.record])


def starts(problem) -> list[np.ndarray]:
    return [start_of(one) for one in problem.starts]


def start_of(problem) -> np.ndarray:
    return np.array([p.prescribed for p in problem.alone.uncertain if p.unknown])


@pytest.mark.parametrize(("value", "most"), [("auto", None), ("given", 0), (1, 1), (5, 5)])
def test_how_many_starts_there_are_at_most(value, most):
    assert checked_starts(value) == most


@pytest.mark.parametrize("value", [0, -1, 1.5, "many", None, True])
def test_other_numbers_of_starts_are_refused(value):
    with pytest.raises(InputError, match=r"^scheme\.starts=.*: must be auto, given, or a whole number >= 1"):
        checked_starts(value)


@pytest.mark.parametrize("factor", [0.1, 10.0])
def test_the_first_start_is_near_whatever_a_user_says(made, factor):
    """A cubic spring makes the linear one that comes nearest stiffer than its own stiffness."""
    first = starts(posed(made, factor))[0] / made.structure.k
    assert np.all((first > 0.8) & (first < 2.0))


def test_there_are_no_more_starts_than_asked_for_all_of_the_same_problem(made):
    assert len(starts(posed(made, 10.0, starts=1))) == 1
    problem = posed(made, 10.0, starts=3)
    several = starts(problem)
    assert 1 <= len(several) <= 3
    for i, one in enumerate(several):
        assert all(np.abs(np.log(one / other)).max() > 0.01 for other in several[:i])
    for other in problem.other_starts:
        assert other.alone.record is problem.alone.record
        assert [p.name for p in other.alone.uncertain] == [p.name for p in problem.alone.uncertain]
        assert not other.other_starts


@pytest.mark.parametrize(("starts", "are_any"), [("auto", True), (2, False), ("given", False)])
def test_starts_elsewhere_are_others_and_only_where_nobody_says_how_many(starts, are_any, monkeypatch):
    twin = small_chain("linear")
    monkeypatch.setattr(starting, "RIVAL", 1e6)  # whatever fits worse, too
    record = accelerations(simulated(twin, snr_db=40.0).record, (1,))
    problem = StateParameter(unobserved=[], unknown="k_*", starts=starts).pose(twin, [record])
    others = problem.elsewhere()
    assert bool(others) is are_any
    every = [start_of(one) for one in (*problem.starts, *others)]
    assert all(np.abs(np.log(a / b)).max() > 0.1 for i, a in enumerate(every) for b in every[:i])
    shorter = problem.changed(lambda own: replace(own, record=own.record.until(50)))
    assert all(len(one.alone.record.time) == 50 for one in (*shorter.starts, *shorter.elsewhere()))


def test_starts_are_compared_where_noise_may_have_put_one_behind_another(made, monkeypatch):
    """What the user says is no candidate of the spectra: it is a start where none of these holds."""
    first, behind, far = (
        starting.Candidate({"m": made.structure.m, "k": k * made.structure.k}, misfit)
        for k, misfit in ((1.0, 0.1), (2.0, 0.12), (3.0, 0.15))
    )
    found = [first, behind, far]
    monkeypatch.setattr(starting.Screening, "candidates", lambda screening: found)
    assert posed(made, 10.0).compared == 2


@pytest.mark.parametrize("factor", [0.01, 100.0])
def test_what_the_user_says_is_a_start_of_its_own_beside_those_of_the_record(made, factor):
    """Unless the record starts there anyway, or a single start is asked for."""
    said = factor * made.structure.k * np.array([1.0, 1.3, 0.8])
    structure = build_chain(3, Duffing(), m=2000.0, c=[3000.0, 2800.0, 2400.0], k=said.tolist(), kappa=[5e9, 0.0, 0.0])
    for settings, last in (({}, True), ({"starts": 1}, False)):
        problem = StateParameter(unobserved=[], unknown="k_*", **settings).pose(structure, [made.record])
        assert np.allclose(starts(problem)[-1], said, rtol=1e-12) is last
        assert [p.said for p in problem.alone.uncertain if p.unknown] == pytest.approx(said)
    beside = structure.with_parameters(k=torch.as_tensor(1.05 * starts(problem)[0]))
    near = StateParameter(unobserved=[], unknown="k_*").pose(beside, [made.record])
    assert not any(np.allclose(one, [p.said for p in near.alone.uncertain if p.unknown]) for one in starts(near))


def test_without_a_spring_the_force_says_how_large_damping_and_friction_may_be(made):
    """A mass on a guide; a spring of no stiffness was 0 / 0."""
    guide = {"between": ["ground", "x"], "law": "friction", "speed": 0.01, "c": None, "k": 0.0, "F_c": None}
    structure = build_structure(["x"], {"x": 2000.0}, {"guide": guide})
    one = slice(2, 3)
    columns = {q: getattr(made.record, q)[:, one] for q in ("displacement", "velocity", "acceleration", "force")}
    record = Record(made.record.time, **columns, unforced=np.zeros(1, bool))
    problem = StateParameter(unobserved=[], unknown="missing").pose(structure, [record]).alone
    unknown = {p.kind: p for p in problem.uncertain}
    force, size = record.force.std(), motion_amplitudes(record)
    assert unknown["c"].scale == pytest.approx(force / size["velocity"], rel=0.01)
    assert unknown["F_c"].scale == pytest.approx(force, rel=0.1)
    assert (unknown["c"].prior_std, unknown["F_c"].prior_std) == (10 * unknown["c"].scale, 10 * unknown["F_c"].scale)


def test_laws_that_call_parameters_by_one_letter_have_a_size_each(made):
    """The larger of two was that of both: N s/m beside N (s/m)^3 shut a Van der Pol damper out."""
    laws = {"k": 1e6, "c": 1e3, "mu": None}
    connections = {
        "s1": {"weights": {"x": 1.0}, "law": "van_der_pol", **laws},
        "s2": {"weights": {"x": 1.0}, "law": "power_damping", "exponent": 3.0, **laws},
    }
    structure = build_structure(["x"], {"x": 2000.0}, connections)
    one = slice(2, 3)
    columns = {q: getattr(made.record, q)[:, one] for q in ("displacement", "velocity", "acceleration", "force")}
    record = Record(made.record.time, **columns, unforced=np.zeros(1, bool))
    size, force = motion_amplitudes(record), record.force.std()
    rate = size["velocity"]
    sizes = starting.parameter_scales(structure, [record])["mu"]
    np.testing.assert_allclose(sizes, force / np.array([rate * (1.0 - size["displacement"] ** 2), rate**3]), rtol=0.01)


def test_priors_are_as_wide_as_the_start_is_large_and_as_starts_of_its_kind_are(made):
    """A start decades too low would shut the truth out, were its prior as narrow as that."""
    unknown = [p for p in posed(made, 1.0, prior_width=7.0, starts=1).alone.uncertain if p.unknown]
    typical = np.median([p.prescribed for p in unknown])
    for parameter in unknown:
        assert parameter.prior_std == pytest.approx(7.0 * max(parameter.prescribed, typical))
        assert parameter.lower == -parameter.prescribed


@pytest.fixture(scope="module")
def framed() -> Record:
    """Of the frame with a brace, a damper and a slide."""
    force = BandedNoise(3, 12.0, 601, [0.5, 15.0], 2000.0, [3])
    return Simulated(force, Simulation(12.0, 601), Noise(40.0, 0)).measure(FRAME).record


def test_springs_and_dampers_of_a_structure_start_near_the_truth(framed):
    unknown = ["k_storey_*", "k_brace", "c_*", "kappa_*", "k_3_*", "F_c_*"]
    problem = StateParameter(unobserved=[], unknown=unknown, starts=1).pose(FRAME, [framed]).alone
    start = {p.name: p for p in problem.uncertain if p.unknown}
    for name in ("storey_1", "storey_2", "storey_3", "brace"):
        assert start[f"k_{name}"].prescribed == pytest.approx(CONNECTIONS[name]["k"], rel=0.3)
    for name in ("storey_1", "storey_2", "storey_3", "damper"):
        # One damping ratio for all: the order of magnitude.
        assert 0.1 < start[f"c_{name}"].prescribed / CONNECTIONS[name]["c"] < 10.0
    assert (start["kappa_storey_1"].prescribed, start["k_3_brace"].prescribed) == (0.0, 0.0)
    # Wide enough for the truth, each on the scale of its own connection.
    for name, connection in (("kappa", "storey_1"), ("k_3", "brace"), ("F_c", "slide")):
        assert start[f"{name}_{connection}"].prior_std > CONNECTIONS[connection][name]


def test_the_bayesian_scheme_takes_every_parameter_but_the_masses(framed):
    scheme = Bayesian(
        priors={"k_3": {"kind": "normal", "mean": 0.0, "std": 1e9}, "k_brace": {"kind": "half_normal", "scale": 1e6}}
    )
    problem = scheme.pose(FRAME, [scheme.observe(framed)]).alone
    assert [p.name for p in problem.uncertain] == [p.name for p in FRAME.every_parameter() if p.kind != "m"]
    priors = {p.name: p.prior for p in problem.uncertain}
    assert (priors["k_3_brace"].name, priors["k_brace"].scale) == ("normal", 1e6)
    assert priors["k_storey_1"].scale != 1e6


@pytest.mark.parametrize(
    ("sensors", "names"),
    [
        ([1, 3], ["k_storey_2", "k_storey_3", "k_brace", "k_3_brace"]),
        ([2, 3], ["k_storey_1", "k_storey_2", "k_damper", "k_slide", "kappa_storey_1", "F_c_slide"]),
    ],
)
def test_unknown_by_default_are_springs_that_end_where_there_is_no_sensor(framed, sensors, names):
    record = framed.keep({"acceleration": sensors})
    assert [p.name for p in unknown_parameters(FRAME, [record], None)] == names


@pytest.mark.parametrize(
    ("pattern", "names"),
    [
        ("k_brace", ["k_brace"]),
        ("k_storey_*", ["k_storey_1", "k_storey_2", "k_storey_3"]),
        ("k_3_*", ["k_3_brace"]),
        ("*_brace", ["c_brace", "k_brace", "k_3_brace"]),
        ("k_*", [f"k_{name}" for name in ("storey_1", "storey_2", "storey_3", "damper", "brace", "slide")]),
        ("m_x[12]", ["m_x1", "m_x2"]),
    ],
)
def test_patterns_mean_kinds_and_names(framed, pattern, names):
    assert sorted(p.name for p in unknown_parameters(FRAME, [framed], pattern)) == sorted(names)
    assert sorted(p.name for p in parameters_called(pattern, FRAME, "scheme.initial")) == sorted(names)


def test_a_kind_means_its_parameters_and_no_others():
    assert [p.name for p in parameters_called("k_3", FRAME, "scheme.initial")] == ["k_3_brace"]
    assert {p.kind for p in parameters_called("k", FRAME, "scheme.initial")} == {"k"}
    # Of a numbered chain k_2 is what it always was, the second spring.
    chain = build_chain(2, Polynomial(), m=1.0, c=1.0, k=1.0, k_2=3.0)
    assert [p.name for p in parameters_called("k_2", chain, "scheme.initial")] == ["k_2"]
    assert [p.name for p in parameters_called("k_2_*", chain, "scheme.initial")] == ["k_2_1", "k_2_2"]


def test_an_unknown_name_is_answered_with_those_that_there_are(framed):
    with pytest.raises(InputError, match=r"one of m_x1, m_x2, m_x3, c_storey_1.*did you mean k_brace\?"):
        unknown_parameters(FRAME, [framed], "k_brase")


def test_what_is_missing_is_told_as_it_would_be_given():
    connections = {
        "storey": {"between": ["ground", "x1"], "law": "linear", "c": 1.0, "k": None},
        "tie": {"between": ["x1", "x2"], "law": "linear", "c": None, "k": 3.0},
    }
    structure = build_structure(["x1", "x2"], {"x1": 1.0, "x2": None}, connections)
    with pytest.raises(InputError, match="kg.*N s/m.*N/m.*m_x2, c_tie, k_storey") as error:
        check_given(structure)
    assert error.value.setting == "system.mass.x2, system.connections.tie.c, system.connections.storey.k"
    check_given(structure, list(structure.every_parameter()))


@pytest.mark.slow
@pytest.mark.parametrize("factor", [0.1, 10.0])
def test_where_no_linear_chain_comes_near_the_free_run_says_how_stiff_it_is(factor):
    s = replace(frame(), kappa=np.array([0.0, 2e12, 2e12]))
    time = np.arange(600) / 100.0
    record = measured(s, s.moved(random_force(0.5, 20.0, 8000.0, 6.0), time), {"acceleration": (1, 3)}, 40.0).record
    values = {"m": s.m.tolist(), "c": s.c.tolist(), "k": (factor * s.k).tolist(), "kappa": s.kappa.tolist()}
    problem = StateParameter(unobserved=[], unknown="k_*").pose(build_chain(3, Duffing(), **values), [record])
    assert min(np.abs(np.log10(start / s.k)).max() for start in starts(problem)) < 0.3


CSV = (
    "data=csv",
    "data.path=rig.csv",
    "++data.force={1: f}",
    "++data.displacement={1: u1, 2: u2}",
    "++data.acceleration={1: a1, 2: a2}",
)
DUFFING = ("system.ndof=2", "system.m=10", "system.c=1", "system.k=15", "system.kappa=100")


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """With a record of a structure that has two DOFs, all sensors and one force."""
    where = tmp_path_factory.mktemp("rig")
    record = simulated(small_chain(ndof=2)).record
    columns = {"t": record.time, "f": record.force[:, 0]}
    for dof in (1, 2):
        columns[f"u{dof}"] = record.displacement[:, dof - 1]
        columns[f"a{dof}"] = record.acceleration[:, dof - 1]
    pd.DataFrame(columns).to_csv(where / "rig.csv", index=False)
    return where


def composed_problem(composition: DictConfig, folder: Path) -> Problem:
    config = RunConfig.read(composition, folder)
    record = config.observe(config.source.measure(config.structure).record)
    return config.scheme.pose(config.structure, [record]).alone


REFUSED = {
    ("system=duffing", "system.m=2", "system.k=3"): "system.c, system.kappa=(nothing)",
    ("scheme=state_parameter", "scheme.unknown=k_*", "system=linear", "system.m=2"): "system.c=(nothing)",
    ("scheme=state_parameter", "scheme.unknown=k_1", "system=linear", "system.m=2", "system.c=1"): "If k_2 are",
    ("scheme=bayesian",): "system.m=(nothing)",
}


@pytest.mark.parametrize(("overrides", "told"), REFUSED.items(), ids=map(" ".join, REFUSED))
def test_a_value_that_nobody_gave_is_asked_for(composed: Compose, folder: Path, overrides, told):
    message = refusal(composed_problem, composed(*CSV, "system.ndof=2", *overrides), folder)
    assert told in message
    assert "scheme.unknown" in message


@pytest.mark.parametrize(
    "overrides",
    [
        DUFFING,
        ("scheme=state_parameter", "scheme.unknown=[k_*, 'kappa_*']", *DUFFING[:3]),
        ("scheme=state_parameter", "scheme.unknown=[k_*, c_*]", "system=linear", "system.ndof=2", "system.m=10"),
        ("scheme=state_parameter", "scheme.unknown=k_2", *DUFFING[:3], "system.k=[15, null]", "system.kappa=100"),
        ("scheme=bayesian", *DUFFING[:2]),
    ],
    ids=" ".join,
)
def test_what_is_given_or_unknown_makes_a_problem(composed: Compose, folder: Path, overrides):
    problem = composed_problem(composed(*CSV, *overrides), folder)
    assert not problem.record.simulated
    for values in problem.structure.parameters.values():
        assert np.isfinite(values.numpy()).all()


def test_a_simulated_structure_has_every_value(composed: Compose):
    with pytest.raises(InputError, match=r"system\.k=nothing"):
        RunConfig.read(composed("system.k=null"))
    with pytest.raises(InputError, match=r"system\.k=.*every entry"):
        RunConfig.read(composed("system.ndof=2", "system.k=[1,null]"))


EXPERIMENT = """# @package _global_
defaults:
  - override /system: linear
  - override /data: csv
  - _self_
system: {ndof: 2, m: 10.0, c: 1.0, k: 15.0}
data: {path: rig.csv, force: {1: f}, displacement: {1: u1, 2: u2}}
"""
SYSTEM = """ndof: 2
m: 10.0
c: 1.0
k: 15.0
nonlinearity:
  _target_: pinn_cli.system.connection.linear.Linear
"""


def test_values_from_files_of_the_user(pinn_run: PinnRun, folder: Path, tmp_path: Path):
    (tmp_path / "rig.csv").write_text((folder / "rig.csv").read_text())
    for name, text in {"experiment/rig": EXPERIMENT, "system/rig": SYSTEM}.items():
        (tmp_path / "mine" / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / "mine" / f"{name}.yaml").write_text(text)
    read: list[list[float]] = []

    def task(config: DictConfig) -> None:
        read.append(RunConfig.read(config, tmp_path).structure.parameters["k"].tolist())

    for chosen in (["experiment=rig"], ["system=rig", *CSV], ["--multirun", "experiment=rig", "system.m=9,11"]):
        arguments = [argument.replace("++", "") for argument in chosen]
        assert pinn_run("--config-dir", "mine", *arguments, task=task).status == 0
    assert read == [[15.0, 15.0]] * 4
