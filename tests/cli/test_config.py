"""The shipped configuration composes and builds; values that no run can use are told by the setting's name."""

from pathlib import Path

import numpy as np
import pytest
import torch
from calls import SMALL, Compose, PinnRun, refusal
from omegaconf import OmegaConf, open_dict

from pinn_cli.cli.config import RunConfig
from pinn_cli.cli.help import option_names
from pinn_cli.record.response import QUANTITIES
from pinn_cli.report.fitness import published
from pinn_cli.settings.errors import InputError

REFERENCE_SIGNALS = Path(__file__).parents[3] / "shared" / "data" / "reference_signals"
GROUPS = ("system", "excitation", "model_error", "data", "scheme", "network", "training", "validation", "baseline")
PAPER = [name.removeprefix("paper/") for name in option_names("experiment") if name.startswith("paper/")]


def test_defaults(composed: Compose) -> None:
    config = RunConfig.read(composed())
    assert (config.structure.ndof, config.source.snr_db, config.seed, config.device) == (6, 50.0, 0, "cpu")
    assert config.description.labels_of("pinn") == {
        "case": "default", "estimator": "pinn", "scheme": "sparse_recovery", "ndof": 6, "nonlinearity": "duffing",
        "model_error": "none", "snr_db": 50.0, "seed": 0,
    }  # fmt: skip


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


def test_experiments_of_a_list_lie_over_each_other(pinn_run: PinnRun) -> None:
    both = "experiment=[paper/sr_6dof_snr20,paper/sr_6dof_perturbed]"
    config = OmegaConf.create(pinn_run("--cfg", "job", both).done().out)
    assert (config.model_error._target_.split(".")[-1], config.noise.snr_db) == ("PerturbedModelError", 50.0)
    config = OmegaConf.create(pinn_run("--cfg", "job", "experiment=[paper/sr_6dof_snr20]").done().out)
    assert config.noise.snr_db == 20.0


@pytest.mark.parametrize("case", PAPER)
def test_paper_experiments(composed: Compose, case: str) -> None:
    config = RunConfig.read(composed(f"experiment=paper/{case}"))
    rows = published("fitness").query("case == @case")
    labels = config.description.labels_of("pinn")
    assert config.case == case
    for name in ("ndof", "nonlinearity", "model_error", "snr_db"):
        assert set(rows[name]) <= {labels[name]}  # no rows: a table of parameters has it
    file = Path(__file__).parents[2] / "conf" / "experiment" / "paper" / f"{case}.yaml"
    assert f"# pinn-run experiment=paper/{case}\n" in file.read_text()


@pytest.mark.parametrize("table", ["sr-summary", "spe-summary"])
def test_every_row_of_a_fitness_table_is_an_experiment(table: str) -> None:
    assert set(published("fitness").query("table == @table")["case"]) <= set(PAPER)


@pytest.mark.parametrize("table", ["spe-nonerr-duf", "spe-vdp-err", "mcmc-results"])
def test_published_parameters_are_those_of_the_experiment(composed: Compose, table: str) -> None:
    rows = published("parameters").query("table == @table")
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
        ("pe_2dof_duffing", "pe_2dof"),
        ("pe_2dof_van_der_pol", "pe_2dof_van_der_pol"),
    ],
)
def test_paper_experiments_have_the_authors_signals(composed: Compose, case: str, file: str) -> None:
    config = RunConfig.read(composed(f"experiment=paper/{case}"))
    true, _ = config.model_error.structures(config.structure)
    measurements = config.source.measure(true)
    reference = np.load(REFERENCE_SIGNALS / f"{file}.npz")
    of_truth = [(getattr(measurements.truth.response, quantity), reference[quantity]) for quantity in QUANTITIES]
    noisy = () if case.startswith("pe") else ("acceleration", "force")
    of_record = [(getattr(measurements.record, quantity), reference[f"{quantity}_snr50"]) for quantity in noisy]
    for seen, expected in (*of_truth, *of_record):
        np.testing.assert_allclose(seen, expected, rtol=1e-9, atol=1e-9 * np.abs(expected).max())


def test_the_perturbed_experiment_prescribes_the_nominal_chain(composed: Compose) -> None:
    config = RunConfig.read(composed("experiment=paper/sr_6dof_perturbed"))
    true, prescribed = config.model_error.structures(config.structure)
    assert torch.all(prescribed.parameters["k"] == 15.0)
    rows = published("perturbed_parameters").set_index("parameter")["true"]
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
    record = config.observe(config.source.measure(config.structure).record)
    assert record.observed.tolist() == [True, False]
    labels = config.description.labels_of("pinn")
    assert (labels["snr_db"], labels["model_error"]) == (None, None)


# Settings of the run as a whole; those of a group are tested where its classes are.
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
    "case=true": "case=True",
    "figures=3": "figures=3",
    "resume=3": "resume=3",
    "data.kind=csv": "data.kind=csv",
    "data=csv data.kind=simulated": "data.kind=simulated",
    "system.k=[1,2]": "system.ndof=6",
    "system.k=1e9": "the simulation takes",
    "noise.snr_db=loud": "noise.snr_db=loud",
    "+noise.seed=3": "noise.seed=3",
    "noise=5": "noise=5",
    "+simulation.steps=3": "simulation.steps=3",
    "excitation.dofs=[7]": "excitation.dofs=[7]",
    "simulation.duration=5 excitation.band=[0.05,0.1]": "excitation.band=[0.05, 0.1]",
    "+sesd=3": "did you mean seed?",
    "~noise": "noise=(missing)",
    "data=csv": "data.path=",
    "data=csv data.path=rig.csv ++data.velocity={1:v} model_error=perturbed": "model_error=perturbed",
    "scheme._target_=os.system": "scheme._target_=os.system",
    "scheme.unobserved=[1,2,3,4,5,6]": "scheme.unobserved=",
    "scheme=state_parameter scheme.positive=[k,z]": "no connection has z",
    "scheme=state_parameter +scheme.initial.c_1=3": "scheme.initial.c_1=3: must be of an unknown parameter",
    "training.iterations=0": "training.iterations=0",
    "training.checkpoint_every_s=0": "training.checkpoint_every_s=0: must be a finite number > 0",
    "report.export=[zip]": "report.export=",
}


@pytest.mark.parametrize(("overrides", "told"), UNUSABLE.items(), ids=UNUSABLE.keys())
def test_unusable_values(composed: Compose, overrides: str, told: str) -> None:
    def pose() -> None:
        config = RunConfig.read(composed(*overrides.split()))
        true, prescribed = config.model_error.structures(config.structure)
        config.scheme.pose(prescribed, [config.observe(config.source.measure(true).record)])

    assert told in refusal(pose)


def test_a_setting_that_only_a_file_has_is_not_passed_over(composed: Compose) -> None:
    config = composed()
    with open_dict(config):
        config.sytem = OmegaConf.create({"ndof": 3})
    with pytest.raises(InputError, match="did you mean system?"):
        RunConfig.read(config)
