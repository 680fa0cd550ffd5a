"""`data.records`, what every record has of its own and in common; and names of DOFs where settings ask for DOFs."""

from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from calls import Compose, refusal
from omegaconf import OmegaConf

from pinn_cli.cli.config import RunConfig
from pinn_cli.cli.prepare import check_records, prepare_problem
from pinn_cli.cli.records import data_of_records, numbered
from pinn_cli.network.mlp import Mlp
from pinn_cli.network.spline import Spline
from pinn_cli.runs.identity import Identity
from pinn_cli.scheme.joint_problem import JointProblem
from pinn_cli.settings.errors import InputError
from pinn_cli.system.parameters import Labels
from pinn_cli.training.estimator import TrainedNetwork
from pinn_cli.training.gauss_newton import GaussNewton
from pinn_cli.training.gradient.adam import Adam
from pinn_cli.validation.evidence import EvidenceScore
from pinn_cli.validation.forecast import Forecast
from pinn_cli.validation.none import NoValidation

COMMON = {"_target_": "x", "kind": "csv", "path": None, "force": {3: "f"}, "acceleration": {1: "a", 2: "b"}}
WEIGHTS = ("observation", "physics", "continuity")
CHAIN = ("data=csv", "system=linear", "system.ndof=3", "system.m=2000", "system.c=3000", "system.k=1e6")


def entries(records: object) -> list[dict]:
    return [OmegaConf.to_container(node) for node in data_of_records(OmegaConf.create(COMMON | {"records": records}))]


def test_an_entry_goes_before_what_all_have_in_common():
    first, second = entries([{"path": "a.csv", "acceleration": {3: "c"}}, {"path": "b.csv", "force": {}}])
    assert first == COMMON | {"path": "a.csv", "acceleration": {3: "c"}}
    assert second == COMMON | {"path": "b.csv", "force": {}}
    assert entries([]) == entries(None) == [COMMON]


@pytest.mark.parametrize(
    ("records", "said"),
    [
        ({"path": "a.csv"}, "data.records=.*: must be a list of maps"),
        ([{"path": "a.csv"}, "b.csv"], "record 2: data.records=b.csv: must be a map"),
        ([{}], "record 1: data.records"),
        ([{"acc": {}}], "record 1: data.records=acc: must be one of path, force, acceleration"),
        ([{"path": "a.csv"}, {"kind": "mat"}], "record 2: .* kind is the same for all records"),
    ],
)
def test_what_is_no_list_of_records_is_refused(records, said):
    with pytest.raises(InputError, match=said):
        entries(records)


def write(folder: Path, name: str, samples: int = 200) -> str:
    random, time = np.random.default_rng(len(name)), np.arange(samples) / 100.0
    columns = {"t": time, **{column: random.standard_normal(samples) for column in ("f", "a1", "a2", "a3")}}
    pd.DataFrame(columns).to_csv(folder / name, index=False)
    return str(folder / name)


def test_every_record_has_its_own_sensors_length_and_force(composed: Compose, tmp_path: Path):
    a, b = write(tmp_path, "a.csv"), write(tmp_path, "long.csv", 300)
    records = (
        f"data.records=[{{path: '{a}', acceleration: {{1: a1}}}}, {{path: '{b}', acceleration: {{2: a2, 3: a3}}}}]"
    )
    prepared = prepare_problem(RunConfig.read(composed(*CHAIN, "+data.force={3: f}", records)))
    first, second = (problem.record for problem in prepared.problem)
    assert (len(first.time), len(second.time)) == (200, 300)
    assert first.sensors("acceleration").tolist() == [True, False, False]
    assert second.sensors("acceleration").tolist() == [False, True, True]
    assert all(record.sensors("force").tolist() == [False, False, True] for record in (first, second))
    assert prepared.record is first
    assert len(prepared.truths) == 2
    assert len({problem.uncertain for problem in prepared.problem}) == 1
    records = f"data.records=[{{path: '{a}'}}, {{path: '{b}', acceleration: {{2: a2, 3: a3}}}}]"
    settings = "+data.force={3: f}", "+data.acceleration={1: a1}", f"+data.validation={{path: '{b}', start: 2}}"
    prepared = prepare_problem(RunConfig.read(composed(*CHAIN, *settings, records)))
    assert [len(problem.record.time) for problem in prepared.problem] == [200, 200]
    assert prepared.validation.of == 1
    assert prepared.validation.record.sensors("acceleration").tolist() == [False, True, True]


def test_an_error_says_which_record_it_is_about(composed: Compose, tmp_path: Path):
    a, b = write(tmp_path, "a.csv"), write(tmp_path, "b.csv")
    records = f"data.records=[{{path: '{a}', acceleration: {{1: a1}}}}, {{path: '{b}', acceleration: {{2: zz}}}}]"
    config = RunConfig.read(composed(*CHAIN, records))
    with pytest.raises(InputError, match=r"^record 2: data\.acceleration\.2='zz': must be a column"):
        prepare_problem(config)


def test_another_content_of_any_record_is_another_run(tmp_path: Path):
    a, b = write(tmp_path, "a.csv"), write(tmp_path, "b.csv")
    config = OmegaConf.create({"data": {"path": None, "records": [{"path": a}, {"path": b}]}})
    before = Identity.of(config)
    assert Identity.of(config).configuration == before.configuration
    write(tmp_path, "b.csv", 201)
    changes = Identity.of(config).changes_from(before)
    assert len(changes) == 1
    assert changes[0].startswith("data.records[1].path=file of SHA-256")
    config.data.records = 3  # refused by what reads it
    Identity.of(config)


def problem(records: int) -> JointProblem:
    return JointProblem((None,) * records)  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("network", "training", "baseline", "validation", "setting"),
    [
        (Mlp(), GaussNewton(), None, NoValidation(), "network=mlp"),
        (Spline(), GaussNewton(weights=dict.fromkeys(WEIGHTS, 1)), None, NoValidation(), "network=spline"),
        (Spline(), GaussNewton(), TrainedNetwork(Adam(), Mlp()), NoValidation(), "baseline=pinn"),
        (Spline(), GaussNewton(), None, Forecast(), "validation=forecast"),
    ],
)
def test_what_has_one_record_at_a_time_is_refused(network, training, baseline, validation, setting):
    with pytest.raises(InputError, match=f"^{setting}.*2 records of data.records"):
        check_records(problem(2), TrainedNetwork(training, network), baseline, validation)
    check_records(problem(1), TrainedNetwork(training, network), baseline, validation)
    check_records(problem(3), TrainedNetwork(GaussNewton(), Spline()), None, EvidenceScore())


LABELS = Labels(("ground_floor", "mezzanine", "roof"), ("a", "b", "c"))
CONNECTIONS = (
    "storey_1: {between: [ground, ground_floor], law: linear, c: 4500, k: 1.5e6}",
    "storey_2: {between: [ground_floor, mezzanine], law: linear, c: 4200, k: 1.4e6}",
    "storey_3: {between: [mezzanine, roof], law: linear, c: 3600, k: 1.2e6}",
    "brace: {between: [ground, mezzanine], law: linear, c: 0, k: 4e5}",
)
FRAME = (
    "system=structure",
    "system.dofs=[ground_floor,mezzanine,roof]",
    "system.mass=2000",
    f"system.connections={{{', '.join(CONNECTIONS)}}}",
)


def test_names_and_numbers_are_the_same_dofs():
    channels = {"x": {"sensor": "force", "dof": "roof"}, "y": {"between": ["roof", "ground"], "weights": None}}
    data = {"acceleration": {"roof": "a3", "1": "a1"}, "force": {2: "f", "roof": None}, "holdout": ["roof", 1]}
    data |= {"records": [{"path": "a.csv"}, {"path": "b.csv", "acceleration": {"roof": "a"}, "channels": channels}]}
    config = OmegaConf.create(
        {"data": data, "excitation": {"dofs": ["mezzanine"], "force": None}, "scheme": {"unobserved": "every_2nd"}}
    )
    found = numbered(config, LABELS)
    entry = found.data.records[1]
    assert (entry.acceleration, entry.channels.x.dof, entry.channels.y.between) == ({3: "a"}, 3, [3, "ground"])
    assert found.data.acceleration == {3: "a3", 1: "a1"}
    assert found.data.force == {2: "f", 3: None}
    assert (found.data.holdout, found.excitation.dofs, found.scheme.unobserved) == ([3, 1], [2], "every_2nd")
    assert numbered(config, Labels()) is config


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({"data": {"acceleration": {"rof": "a"}}}, "data.acceleration=rof: must be one of the DOFs ground_floor, mezz"),
        ({"data": {"records": [{"force": {"rof": "a"}}, {}]}}, "record 1: data.force=rof: must be one of the DOFs"),
        ({"data": {"force": {"roof": "a", 3: "b"}}}, "data.force=roof: must be there once only"),
        ({"data": {"holdout": [4]}}, "data.holdout=4: must be one of the DOFs"),
        ({"excitation": {"dofs": [0]}}, "or its number from 1 to 3"),
        ({"scheme": {"unobserved": [True]}}, "scheme.unobserved=True: must be one of the DOFs"),
        ({"excitation": {"force": {"dofs": ["attic"]}}}, "excitation.force.dofs=attic"),
    ],
)
def test_a_dof_that_there_is_not_is_answered_with_the_names(given, message):
    assert message in refusal(numbered, OmegaConf.create(given), LABELS)


def test_messages_about_a_file_name_the_dof_as_the_user_does(composed: Compose, tmp_path: Path) -> None:
    sensors = ("+data.force={roof: f}", "+data.acceleration={roof: a1, mezzanine: none}")
    frame = [setting.replace("system.connections", "++system.connections") for setting in FRAME]
    config = composed(*frame, "data=csv", f"data.path={write(tmp_path, 'a.csv')}", *sensors)
    with pytest.raises(InputError, match="data.acceleration.mezzanine='none'"):
        prepare_problem(RunConfig.read(config))
