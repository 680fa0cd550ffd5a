"""The shipped configuration composes and builds; values that no run can use are told by the setting's name."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import torch
from calls import SMALL, Compose
from omegaconf import OmegaConf, open_dict

from pinn_cli.cli.config import RunConfig
from pinn_cli.cli.config_names import option_names
from pinn_cli.record.response import QUANTITIES
from pinn_cli.report import published
from pinn_cli.settings.errors import InputError

REFERENCE_SIGNALS = Path(__file__).parents[3] / "shared" / "data" / "reference_signals"
GROUPS = ("system", "excitation", "model_error", "data", "scheme", "network", "training", "validation", "baseline")
PAPER = [name.removeprefix("paper/") for name in option_names("experiment") if name.startswith("paper/")]


def test_defaults(composed: Compose) -> None:
    config = RunConfig.read(composed())
    assert (config.structure.ndof, config.source.snr_db, config.seed, config.device) == (6, 50.0, 0, "cpu")
    assert config.description.labels_of("pinn") == {
        "case": "default",
        "estimator": "pinn",
        "scheme": "sparse_recovery",
        "ndof": 6,
        "nonlinearity": "duffing",
        "model_error": "none",
        "snr_db": 50.0,
        "seed": 0,
    }


# A file, a structure and a finished run are the user's own: without them there is nothing to build.
@pytest.mark.parametrize(
    "choice",
    [
        f"{group}={name}"
        for group in GROUPS
        for name in option_names(group)
        if name not in ("structure", "matrices", "modal", "update", "predict")
        and (group != "data" or name == "simulated")
    ],
)
def test_every_option_of_every_group_builds(composed: Compose, choice: str) -> None:
    RunConfig.read(composed(choice, *[s for s in SMALL if "band" not in s]))


def test_every_config_file_opens_with_a_comment() -> None:
    for file in (Path(__file__).parents[2] / "conf").rglob("*.yaml"):
        assert file.read_text(encoding="utf-8").startswith("#"), file


@pytest.mark.parametrize("case", PAPER)
def test_paper_experiments(composed: Compose, case: str) -> None:
    config = RunConfig.read(composed(f"experiment=paper/{case}"))
    rows = published.fitness().query("case == @case")
    labels = config.description.labels_of("pinn")
    assert config.case == case
    for name in ("ndof", "nonlinearity", "model_error", "snr_db"):
        assert set(rows[name]) <= {labels[name]}  # no rows: a table of parameters has it
    file = Path(__file__).parents[2] / "conf" / "experiment" / "paper" / f"{case}.yaml"
    assert f"# pinn-run experiment=paper/{case}\n" in file.read_text()


@pytest.mark.parametrize("table", ["sr-summary", "spe-summary"])
def test_every_row_of_a_fitness_table_is_an_experiment(table: str) -> None:
    assert set(published.fitness().query("table == @table")["case"]) <= set(PAPER)


@pytest.mark.parametrize("table", ["spe-nonerr-duf", "spe-vdp-err", "mcmc-results"])
def test_published_parameters_are_those_of_the_experiment(composed: Compose, table: str) -> None:
    rows = published.parameters().query("table == @table")
    for case, expected in rows.groupby("case"):
        config = RunConfig.read(composed(f"experiment=paper/{case}"))
        true, _ = config.model_error.structures(config.structure)
        values = {parameter.name: parameter.prescribed for parameter in true.every_parameter()}
        ours = [values[name] for name in expected["parameter"]]
        np.testing.assert_allclose(ours, expected["true"], atol=0.006)


@pytest.mark.skipif(not REFERENCE_SIGNALS.is_dir(), reason="the reference signals are not beside the checkout")
@pytest.mark.parametrize(
    ("case", "file"),
    [
        ("sr_6dof_snr50", "sr_6dof"),
        ("sr_20dof_snr50", "sr_20dof"),
        ("sr_6dof_perturbed", "sr_6dof_perturbed"),
        ("sp_5dof_snr50", "sp_5dof"),
        ("sp_5dof_van_der_pol", "sp_5dof_van_der_pol"),
        ("sp_5dof_perturbed", "sp_5dof_perturbed"),
    ],
)
def test_paper_experiments_have_the_authors_signals(composed: Compose, case: str, file: str) -> None:
    config = RunConfig.read(composed(f"experiment=paper/{case}"))
    true, _ = config.model_error.structures(config.structure)
    measurements = config.source.measure(true)
    reference = np.load(REFERENCE_SIGNALS / f"{file}.npz")
    for quantity in QUANTITIES:
        expected = reference[quantity]
        np.testing.assert_allclose(
            getattr(measurements.truth.response, quantity), expected, rtol=1e-9, atol=1e-9 * np.abs(expected).max()
        )
    for quantity in ("acceleration", "force"):
        seen = getattr(measurements.record, quantity)
        expected = reference[f"{quantity}_snr50"]
        np.testing.assert_allclose(seen, expected, rtol=1e-9, atol=1e-9 * np.abs(expected).max())


@pytest.mark.skipif(not REFERENCE_SIGNALS.is_dir(), reason="the reference signals are not beside the checkout")
@pytest.mark.parametrize(("case", "file"), [("duffing", "pe_2dof"), ("van_der_pol", "pe_2dof_van_der_pol")])
def test_bayesian_experiments_have_the_authors_motion(composed: Compose, case: str, file: str) -> None:
    config = RunConfig.read(composed(f"experiment=paper/pe_2dof_{case}"))
    response = config.source.measure(config.structure).truth.response
    reference = np.load(REFERENCE_SIGNALS / f"{file}.npz")
    for quantity in QUANTITIES:
        expected = reference[quantity]
        seen = getattr(response, quantity)
        np.testing.assert_allclose(seen, expected, rtol=1e-9, atol=1e-9 * np.abs(expected).max())


def test_the_perturbed_experiment_prescribes_the_nominal_chain(composed: Compose) -> None:
    config = RunConfig.read(composed("experiment=paper/sr_6dof_perturbed"))
    true, prescribed = config.model_error.structures(config.structure)
    assert torch.all(prescribed.parameters["k"] == 15.0)
    rows = published.perturbed_parameters().set_index("parameter")["true"]
    for i in range(6):
        assert float(true.parameters["k"][i]) == pytest.approx(rows[f"k_{i + 1}"], abs=0.006)


def test_seed_0_is_a_seed_and_seeds_differ(composed: Compose) -> None:
    def acceleration(*overrides: str) -> np.ndarray:
        config = RunConfig.read(composed(*SMALL, *overrides))
        return config.source.measure(config.structure).record.acceleration

    np.testing.assert_array_equal(acceleration("seed=0"), acceleration())
    np.testing.assert_array_equal(acceleration("seed=0"), acceleration("seed=0"))
    assert not np.array_equal(acceleration("seed=0"), acceleration("seed=1"))


def test_threads_reach_torch(composed: Compose) -> None:
    RunConfig.read(composed("threads=1"))
    assert torch.get_num_threads() == 1


@pytest.mark.parametrize("kind", sorted(set(option_names("data")) - {"simulated"}))
def test_every_option_of_measured_records_builds(composed: Compose, tmp_path: Path, kind: str) -> None:
    (tmp_path / "rig.csv").write_text("t,a\n" + "".join(f"{i / 10},{i % 5}\n" for i in range(64)))
    composition = composed(f"data={kind}", "data.path=rig.csv", "++data.acceleration={1: a}", "system.ndof=2")
    config = RunConfig.read(composition, base=tmp_path)
    assert config.source.measure(config.structure).record.observed.tolist() == [True, False]


def test_data_csv(composed: Compose, tmp_path: Path) -> None:
    (tmp_path / "rig.csv").write_text("t,f,a\n" + "".join(f"{i / 10},{i % 3},{i % 5}\n" for i in range(64)))
    columns = ["data.time=t", "++data.force={1: f}", "++data.acceleration={1: a}"]
    composition = composed("data=csv", "data.path=rig.csv", *columns, "system.ndof=2")
    config = RunConfig.read(composition, base=tmp_path)
    record = config.observe(config.source.measure(config.structure).record)
    assert record.observed.tolist() == [True, False]
    assert (config.description.labels_of("pinn")["snr_db"], config.description.labels_of("pinn")["model_error"]) == (
        None,
        None,
    )


UNUSABLE = {
    "seed=-1": "seed=-1",
    "seed=1.5": "seed=1.5",
    "seed=true": "seed=True",
    "seed=null": "seed=None",
    "threads=0": "threads=0",
    "device=gpu": "device=gpu",
    "device=cuda:99": "device=cuda:99",
    "case=a/b": "case=a/b",
    "case=..": "case=..",
    "case=''": "case=",
    "case=null": "case=None",
    "case=true": "case=True",
    "data.kind=csv": "data.kind=csv",
    "data=csv data.kind=simulated": "data.kind=simulated",
    "scheme=state_parameter scheme.positive=[k,z]": "no connection has z",
    "scheme=bayesian scheme.positive=[z]": "no connection has z",
    "scheme=state_parameter +scheme.initial.c_1=3": "scheme.initial.c_1=3: must be of an unknown parameter",
    "system.ndof=100000": "system.ndof=100000: must be a whole number <= 2000",
    "system.k=1e9": "the simulation takes",
    "system.ndof=0": "system.ndof=0",
    "system.ndof=2.5": "system.ndof=2.5",
    "system.k=[1,2]": "system.ndof=6",
    "system.m=0": "system.m=0",
    "noise.snr_db=inf": "noise.snr_db=inf",
    "noise.snr_db=nan": "noise.snr_db=nan",
    "noise.snr_db=loud": "noise.snr_db=loud",
    "noise.seeds={force:1}": "noise.seeds=",
    "+noise.seed=3": "noise.seed=3",
    "noise=5": "noise=5",
    "simulation.duration=0": "simulation.duration=0",
    "simulation.samples=15": "simulation.samples=15",
    "simulation.hold=first": "simulation.hold=first",
    "+simulation.steps=3": "simulation.steps=3",
    "excitation.band=[1.0,0.5]": "excitation.band=",
    "excitation.band=[0.05,100]": "Nyquist",
    "excitation.dofs=[7]": "excitation.dofs=[7]",
    "excitation.rms=-1": "excitation.rms=-1",
    "simulation.duration=5 excitation.band=[0.05,0.1]": "excitation.band=[0.05, 0.1]",
    "+sesd=3": "did you mean seed?",
    "~noise": "noise=(missing)",
    "data=csv": "data.path=",
    "data=csv data.path=rig.csv ++data.velocity={1:v} model_error=perturbed": "model_error=perturbed",
    "scheme._target_=os.system": "scheme._target_=os.system",
    "scheme.unobserved_fraction=1": "scheme.unobserved_fraction=1",
    "scheme.unobserved=[1,2,3,4,5,6]": "scheme.unobserved=",
    "scheme.unobserved=[7]": "scheme.unobserved=",
    "scheme.parameter_uncertainty=-0.1": "scheme.parameter_uncertainty=-0.1",
    "training.iterations=0": "training.iterations=0",
}


@pytest.mark.parametrize(("overrides", "told"), UNUSABLE.items(), ids=UNUSABLE.keys())
def test_unusable_values(composed: Compose, overrides: str, told: str) -> None:
    def pose() -> None:
        config = RunConfig.read(composed(*overrides.split()))
        true, prescribed = config.model_error.structures(config.structure)
        config.scheme.pose(prescribed, [config.observe(config.source.measure(true).record)])

    with pytest.raises(InputError) as error:
        pose()
    assert told in str(error.value)
    assert "\n" not in str(error.value)


def test_a_setting_that_only_a_file_has_is_not_passed_over(composed: Compose) -> None:
    config = composed()
    with open_dict(config):
        config.sytem = OmegaConf.create({"ndof": 3})
    with pytest.raises(InputError, match="did you mean system?"):
        RunConfig.read(config)
