"""Searches: what they write, failed trials, and going on after a stop."""

import math
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from calls import SMALL, Compose, PinnRun
from hydra import compose, initialize_config_module
from hydra.core.hydra_config import HydraConfig
from interrupted_runs import without_figures
from omegaconf import DictConfig

from pinn_cli.cli.config import RunConfig
from pinn_cli.cli.help import option_names
from pinn_cli.runs.identity import Identity
from pinn_cli.runs.writing import write_json
from pinn_cli.settings.errors import DivergenceError

pytest.importorskip("optuna", reason="the extra optuna is not installed")

import optuna

from pinn_cli.sweep.search import importance, read_space, within

SPACE = ("network.knots_per_period=interval(2.0,8.0)", "network.degree=choice(3,4,6)")
# A directory of its own for each job, whichever start of the search it belongs to.
SEARCH = (
    "--multirun", "hydra/sweeper=search", "validation=heldout", *SPACE, "hydra.sweep.dir=found",
    "hydra.sweep.subdir=${network.knots_per_period}_${network.degree}", "hydra.sweeper.sampler.startup=3",
)  # fmt: skip


def score(config: DictConfig) -> float:
    """Least at four knots and degree 6, kept as a run keeps it; a job that no run could do diverges."""
    if config.network.degree == 3:
        raise DivergenceError("diverged at iteration 7")
    found = float((config.network.knots_per_period - 4.0) ** 2 + (6 - config.network.degree))
    identity = Identity.of(config, Path.cwd()).configuration
    result = Path(HydraConfig.get().runtime.output_dir) / "run.json"
    write_json({"configuration": identity, "validation": {"score": found}}, result)
    return found


class StopsAt:
    """The same, killed in one of its jobs; how many have ended."""

    def __init__(self, job: float) -> None:
        self.left, self.made = job, 0

    def __call__(self, config: DictConfig) -> float:
        if self.left == self.made:
            raise KeyboardInterrupt
        found = score(config)
        self.made += 1
        return found


def read(directory: Path) -> pd.DataFrame:
    return pd.read_csv(directory / "found" / "search.csv").drop(columns=["seconds"])


@pytest.fixture
def search(pinn_run: PinnRun) -> Callable[..., int]:
    def call(*overrides: str, trials: int = 7, task: Callable[[DictConfig], float | None] = score) -> int:
        return pinn_run(*SEARCH, f"hydra.sweeper.n_trials={trials}", *overrides, task=task).status

    return call


def test_a_search_is_reported_and_failed_trials_take_no_other_along(search: Callable[..., int], tmp_path: Path) -> None:
    assert search() == 0  # though some trials diverged
    trials = read(tmp_path)
    assert trials["trial"].tolist() == list(range(7))
    failed = trials["network.degree"] == 3
    assert failed.any()
    assert trials.loc[failed, "state"].eq("failed").all()
    assert trials.loc[failed, "score"].isna().all()
    done = trials[~failed]
    expected = (done["network.knots_per_period"] - 4.0) ** 2 + 6 - done["network.degree"]
    pd.testing.assert_series_equal(done["score"], expected, check_names=False)
    best = done.loc[done["score"].idxmin()]
    text = (tmp_path / "found" / "search.md").read_text()
    assert f"network.degree={best['network.degree']}" in text.partition("pinn-run")[2].partition("\n")[0]
    assert "validation=heldout" in text
    assert {"search.png", "search.pdf"} <= {file.name for file in (tmp_path / "found").iterdir()}
    assert (tmp_path / "found" / str(best["directory"]) / ".hydra").is_dir()


@pytest.mark.parametrize(
    ("stop", "at_once"),
    [pytest.param(0, 1, marks=pytest.mark.slow), (3, 1), pytest.param(2, 2, marks=pytest.mark.slow)],
)
@pytest.mark.slow
def test_a_stopped_search_goes_on_as_if_never_stopped(search, tmp_path, stop, at_once):
    many = f"hydra.sweeper.n_jobs={at_once}"
    undisturbed, rest = StopsAt(math.inf), StopsAt(math.inf)
    assert search(many, trials=5, task=undisturbed) == 0
    trials = read(tmp_path)
    (tmp_path / "found").rename(tmp_path / "undisturbed")
    assert search(many, trials=5, task=StopsAt(stop)) == 130
    assert search(many, trials=5, task=rest) == 0
    pd.testing.assert_frame_equal(read(tmp_path), trials)
    assert rest.made == undisturbed.made - stop  # what has a score is not made again


@pytest.mark.slow
def test_a_finished_search_makes_no_trial_and_more_may_be_asked_for(search: Callable[..., int], tmp_path: Path) -> None:
    search(trials=1)
    before = read(tmp_path)
    assert search(trials=1, task=StopsAt(0)) == 0  # no job is started
    pd.testing.assert_frame_equal(read(tmp_path), before)
    assert search(trials=3) == 0
    assert len(read(tmp_path)) == 3
    pd.testing.assert_frame_equal(read(tmp_path).head(1), before, check_dtype=False)  # of an empty column


@pytest.mark.slow
def test_the_seed_decides(search: Callable[..., int], tmp_path: Path) -> None:
    search(trials=3)
    search("hydra.sweeper.sampler.seed=1", "hydra.sweep.dir=other", trials=3)
    first, other = read(tmp_path), pd.read_csv(tmp_path / "other" / "search.csv")
    assert not set(first["network.knots_per_period"][1:]) & set(other["network.knots_per_period"][1:])


def test_the_first_trial_is_as_configured(pinn_run: PinnRun, tmp_path: Path) -> None:
    pooled = "training.pooled=choice(true,false)"
    outcome = pinn_run(*SEARCH, pooled, "hydra.sweeper.n_trials=1", task=score)
    first = read(tmp_path).iloc[0]
    assert (first["network.degree"], first["training.pooled"]) == (6, False)
    assert 2.0 <= first["network.knots_per_period"] <= 8.0  # null: no number to begin with
    assert outcome.err.splitlines()[-1] == f"1 of 1  score {first['score']:.5g}  best {first['score']:.5g}"
    assert (
        f"as configured where the search may choose them: {first['score']:.5g}."
        in (tmp_path / "found" / "search.md").read_text()
    )


@pytest.mark.parametrize(
    ("space", "value", "drawn"),
    [
        ("interval(2.0,8.0)", 5, 5.0),
        ("interval(2.0,8.0)", 1.5, None),
        ("interval(2.0,8.0)", None, None),
        ("interval(2.0,8.0)", "many", None),
        ("tag(log,int(interval(8,48)))", 20, 20),
        ("int(interval(1,3))", 2.5, None),
        ("int(interval(0,3))", True, None),
        ("choice(true,false)", False, False),
        ("choice(0,1)", True, None),
        ("choice(sine,tanh)", "tanh", "tanh"),
        ("choice(sine,tanh)", "silu", None),
    ],
)
def test_what_may_be_drawn(space: str, value: object, drawn: object) -> None:
    found = within(read_space([f"x={space}"])[0]["x"], value)
    assert found == drawn
    assert isinstance(found, bool) == isinstance(drawn, bool)


def test_another_search_does_not_go_on_with_its_trials(search: Callable[..., int], pinn_run: PinnRun) -> None:
    search(trials=1)
    for other in ("seed=3", "+hydra.sweeper.params={seed:'choice(3,4)'}"):
        outcome = pinn_run(*SEARCH, "hydra.sweeper.n_trials=2", other, task=score).refused()
        assert "another search" in outcome.err or "they differ in seed=" in outcome.err


def test_a_search_needs_a_score(pinn_run: PinnRun, tmp_path: Path) -> None:
    pinn_run("--multirun", "hydra/sweeper=search", *SPACE, task=score).refused(
        "validation=none: must be heldout, forecast or evidence in a search"
    )
    assert not list(tmp_path.iterdir())
    pinn_run("--multirun", "hydra/sweeper=search", "validation=evidence", *SPACE, task=score).refused(
        "network.knots_per_period changes what the evidence is relative to"
    )
    overrides = ["network.degree=3", "network.knots_per_period=interval(2.0,8.0)", "hydra.sweeper.n_trials=2"]
    outcome = pinn_run("--multirun", "hydra/sweeper=search", "validation=heldout", *overrides, task=score)
    assert outcome.status == 2
    assert outcome.err.splitlines()[-1].endswith("every trial failed: diverged at iteration 7")


@pytest.mark.slow
def test_a_preset_of_real_runs(pinn_run: PinnRun, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Two trials of the splines' preset, each scored by the sensors that it did not see."""
    without_figures(monkeypatch)
    small = ["system.ndof=4", "scheme.unobserved_fraction=0.5", "simulation.duration=12", "simulation.samples=128"]
    small += ["excitation.band=[0.2,0.8]", "noise.snr_db=20", "validation.dofs=[1]"]
    outcome = pinn_run(
        "-m", "experiment=search/spline", *small, "hydra.sweeper.n_trials=2", "hydra.sweep.dir=found"
    ).done()
    trials, scores = read(tmp_path), pd.read_csv(tmp_path / "found" / "score.csv")
    last = scores[scores["withheld_dof"] == "all"]
    assert sorted(trials["score"]) == pytest.approx(sorted(last["score"]))  # jobs are in the order of their names
    first = {name: trials[name].iloc[0] for name in ("network.knots_per_period", "network.degree")}
    assert first == {"network.knots_per_period": 4.0, "network.degree": 6}
    assert "best of 2 trials" in outcome.out


PRESETS = [name for name in option_names("experiment") if name.startswith("search/")]


@pytest.mark.parametrize("preset", PRESETS)
def test_every_draw_of_a_preset_is_a_configuration(composed: Compose, preset: str) -> None:
    with initialize_config_module("pinn_cli.conf", version_base="1.3"):
        sweeper = compose("config", overrides=[f"experiment={preset}"], return_hydra_config=True).hydra.sweeper
    space, fixed = read_space([f"{name}={value}" for name, value in sweeper.params.items()])
    assert not fixed
    assert set(space) == set(sweeper.params)
    study = optuna.create_study(sampler=optuna.samplers.RandomSampler(seed=0))
    for _ in range(2):
        drawn = study.ask(space).params
        config = composed(f"experiment={preset}", *SMALL[:3], *(f"{name}={value}" for name, value in drawn.items()))
        assert RunConfig.read(config).validation.name == "heldout"


GENERATOR = np.random.default_rng(0)
NUMBER = pd.Series(GENERATOR.uniform(1.0, 100.0, 60))
CHOICE = pd.Series(GENERATOR.choice(["a", "b", "c"], 60))


def test_what_the_score_is_made_of_explains_it_and_nothing_else_does() -> None:
    assert importance(NUMBER, NUMBER**3) == pytest.approx(1.0)
    assert importance(NUMBER, (NUMBER - 50.0) ** 2) > 0.9  # least in the middle
    assert importance(CHOICE, CHOICE.map({"a": 3.0, "b": 1.0, "c": 2.0})) == pytest.approx(1.0)
    assert importance(NUMBER, pd.Series(GENERATOR.normal(size=60))) < 0.15
    assert importance(CHOICE, NUMBER) < 0.15
    assert np.isnan(importance(NUMBER[:3], NUMBER[:3]))
    assert np.isnan(importance(pd.Series(["a"] * 9), NUMBER[:9]))
