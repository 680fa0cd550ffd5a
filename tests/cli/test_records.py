"""`data.records`: what every record has of its own, what all have in common, and what is refused in one line."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from calls import Compose
from omegaconf import OmegaConf

from pinn_cli.cli.config import RunConfig
from pinn_cli.cli.dof_names import numbered
from pinn_cli.cli.prepare import prepare_problem
from pinn_cli.cli.records import check_records, data_of_records
from pinn_cli.network.mlp import Mlp
from pinn_cli.network.spline import Spline
from pinn_cli.runs.identity import Identity
from pinn_cli.scheme.joint_problem import JointProblem
from pinn_cli.settings.errors import InputError
from pinn_cli.system.parameters import Labels
from pinn_cli.training.base import TrainedNetwork
from pinn_cli.training.gauss_newton import GaussNewton
from pinn_cli.training.gradient.adam import Adam
from pinn_cli.validation.evidence import EvidenceScore
from pinn_cli.validation.forecast import Forecast
from pinn_cli.validation.none import NoValidation

COMMON = {"_target_": "x", "kind": "csv", "path": None, "force": {3: "f"}, "acceleration": {1: "a", 2: "b"}}
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
        ("a.csv", "data.records=a.csv: must be a list of maps"),
        ({"path": "a.csv"}, "must be a list of maps"),
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


def test_an_error_says_which_record_it_is_about(composed: Compose, tmp_path: Path):
    a, b = write(tmp_path, "a.csv"), write(tmp_path, "b.csv")
    records = f"data.records=[{{path: '{a}', acceleration: {{1: a1}}}}, {{path: '{b}', acceleration: {{2: zz}}}}]"
    config = RunConfig.read(composed(*CHAIN, records))
    with pytest.raises(InputError, match=r"^record 2: data\.acceleration\.2='zz': must be a column"):
        prepare_problem(config)
    records = f"data.records=[{{path: '{a}', holdout: [2]}}, {{path: '{b}'}}]"
    config = composed(*CHAIN, "+data.acceleration={1: a1}", records)
    with pytest.raises(InputError, match=r"^record 1: data\.holdout"):
        RunConfig.read(config)


def test_data_to_try_the_system_on_beside_several_records(composed: Compose, tmp_path: Path) -> None:
    a, b = write(tmp_path, "a.csv"), write(tmp_path, "long.csv", 300)
    records = f"data.records=[{{path: '{a}'}}, {{path: '{b}', acceleration: {{2: a2, 3: a3}}}}]"
    settings = "+data.force={3: f}", "+data.acceleration={1: a1}", f"+data.validation={{path: '{b}', start: 2}}"
    prepared = prepare_problem(RunConfig.read(composed(*CHAIN, *settings, records)))
    assert [len(problem.record.time) for problem in prepared.problem] == [200, 200]
    assert prepared.validation.of == 1
    assert prepared.validation.record.sensors("acceleration").tolist() == [False, True, True]


def test_dofs_of_an_entry_go_by_their_names():
    labels = Labels(("floor", "roof"), ("a", "b"))
    entry = {"path": "b.csv", "acceleration": {"roof": "a"}, "channels": {"x": {"sensor": "force", "dof": "floor"}}}
    config = OmegaConf.create({"data": {"force": {"roof": "f"}, "records": [{"path": "a.csv"}, entry]}})
    found = OmegaConf.to_container(numbered(config, labels))["data"]["records"][1]
    assert found["acceleration"] == {2: "a"}
    assert found["channels"]["x"]["dof"] == 1
    config.data.records[1].acceleration = {"attic": "a"}
    with pytest.raises(InputError, match=r"^record 2: data\.acceleration=attic"):
        numbered(config, labels)


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
        (Spline(), Adam(), None, NoValidation(), "network=spline"),
        (
            Spline(),
            GaussNewton(weights={"observation": 1, "physics": 1, "continuity": 1}),
            None,
            NoValidation(),
            "netw",
        ),
        (Spline(), GaussNewton(), TrainedNetwork(Adam(), Mlp()), NoValidation(), "baseline=pinn"),
        (Spline(), GaussNewton(), None, Forecast(), "validation=forecast"),
    ],
)
def test_what_has_one_record_at_a_time_is_refused(network, training, baseline, validation, setting):
    with pytest.raises(InputError, match=f"^{setting}.*2 records of data.records"):
        check_records(problem(2), TrainedNetwork(training, network), baseline, validation)
    check_records(problem(1), TrainedNetwork(training, network), baseline, validation)


def test_splines_and_the_evidence_have_several():
    check_records(problem(3), TrainedNetwork(GaussNewton(), Spline()), None, EvidenceScore())
