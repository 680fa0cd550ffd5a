"""What each release wrote is read by this one; what a later one wrote is refused in one line that names it."""

import json
import zipfile
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
import yaml
from calls import PinnRun

from pinn_cli import InputError, load
from pinn_cli.runs.checkpoint import CheckpointFiles, sealed
from pinn_cli.runs.identity import PACKAGES, package_version
from pinn_cli.runs.reading import this_release
from stored.__main__ import RUNS, SEARCH, SWEEP, TINY

ARCHIVES = sorted(Path(__file__).parent.glob("*.zip"))
LATER = {"format": 99, "written_by": "pinn-cli 9.9.9"}
TOLD = f"=format 99: must be of format {{}}; pinn-cli 9.9.9 wrote it and reads it; this is {this_release()}"


@pytest.fixture(params=ARCHIVES, ids=lambda archive: archive.stem)
def stored(request: pytest.FixtureRequest, tmp_path: Path) -> Path:
    """The folder with the runs of a release."""
    with zipfile.ZipFile(request.param) as content:
        content.extractall(tmp_path)
    return tmp_path


def lines(file: Path) -> str:
    return file.read_text(encoding="utf-8")


@pytest.mark.parametrize("name", RUNS)
def test_a_run_is_a_model(stored: Path, pinn_run: PinnRun, name: str) -> None:
    before = pd.read_csv(stored / name / "parameters.csv").set_index("parameter")
    pinn_run(*TINY, f"model={name}", "noise.seeds=null", "seed=5", "hydra.run.dir=new").done()
    after = pd.read_csv(stored / "new" / "parameters.csv").set_index("parameter")
    assert after["prescribed"]["k_2"] == pytest.approx(before["estimate"]["k_2"])


@pytest.mark.parametrize("name", RUNS)
def test_a_finished_run_is_finished(stored: Path, pinn_run: PinnRun, name: str) -> None:
    outcome = pinn_run(f"resume={name}")
    assert (outcome.status, outcome.out.splitlines()[0]) == (0, "finished before, nothing to do")


def test_a_checkpoint_is_taken_up_by_the_release_that_wrote_it(stored: Path, pinn_run: PinnRun) -> None:
    """Numbers of another one, or of another torch, would be others: it is refused, and names the release."""
    content = CheckpointFiles(stored / "mlp").read()
    wrote = content["identity"]["versions"]
    now = {name: package_version(name) or "unknown" for name in PACKAGES}
    outcome = pinn_run("resume=mlp")
    if wrote == now:
        assert outcome.status == 0, outcome.err
        assert "going on from the checkpoint" in lines(stored / "mlp" / "pinn-run.log")
        return
    assert (outcome.status, outcome.err.count("\n")) == (2, 1)
    for name in PACKAGES:
        assert wrote[name] == now[name] or f"{name}={now[name]} (was {wrote[name]})" in outcome.err


@pytest.mark.slow
def test_windows_go_on(stored: Path, pinn_run: PinnRun) -> None:
    first = (stored / "windows" / "windows" / "0001" / "window.json").read_bytes()
    pinn_run("resume=windows").done()
    assert (stored / "windows" / "windows" / "0001" / "window.json").read_bytes() == first
    assert len(load(stored / "windows").run_record["windows"]) > 1  # type: ignore[union-attr]


def test_a_sweep_is_collected_and_goes_on(stored: Path, pinn_run: PinnRun) -> None:
    outcome = pinn_run("collect=sweep")
    assert "2 jobs: 1 finished, 1 not started" in outcome.out
    (job,) = (stored / "sweep").glob("seed=0_*")
    before = (job / "run.json").read_bytes()
    outcome = pinn_run("--multirun", *SWEEP).done()
    assert "2 jobs: 2 finished" in outcome.out
    assert (job / "run.json").read_bytes() == before


@pytest.mark.slow
def test_a_search_goes_on(stored: Path, pinn_run: PinnRun) -> None:
    pytest.importorskip("optuna", reason="the extra optuna is not installed")
    before = pd.read_csv(stored / "search" / "search.csv")
    pinn_run("--multirun", *SEARCH, "hydra.sweeper.n_trials=3").done()
    after = pd.read_csv(stored / "search" / "search.csv")
    assert len(after) == len(before) + 1
    pd.testing.assert_frame_equal(after.head(len(before)), before, check_dtype=False)


def test_python_opens_them(stored: Path) -> None:
    results: dict[str, Any] = {name: load(stored / name) for name in (*RUNS, "sweep")}
    assert set(results["sparse_recovery"].response.sizes) >= {"time", "dof"}
    assert results["state_parameter"].parameters.set_index("parameter")["estimate"]["k_2"] > 0.0
    assert results["bayesian"].posterior.posterior.sizes["chain"] == 2
    assert len(results["sweep"].parameters) > 0


def later_json(file: Path) -> None:
    file.write_text(json.dumps(json.loads(lines(file)) | LATER))


def later_yaml(file: Path) -> None:
    file.write_text(yaml.safe_dump({**yaml.safe_load(lines(file)), **LATER}))


def later_checkpoint(file: Path) -> None:
    content = CheckpointFiles(file.parent).read()
    assert content is not None
    file.write_bytes(sealed(content | LATER))


def later_model(file: Path) -> None:
    with np.load(file) as content:
        arrays = dict(content)
    words = json.loads(bytes(arrays["content"]).decode()) | LATER
    np.savez_compressed(file, **arrays | {"content": np.frombuffer(json.dumps(words).encode(), dtype=np.uint8)})


def later_chain(file: Path) -> None:
    (file.parents[1] / "run.json").unlink()  # the run has not finished
    with np.load(file) as content:
        np.savez(file, **dict(content) | {name: np.array(value) for name, value in LATER.items()})


@pytest.mark.parametrize(
    ("file", "change", "command"),
    [
        ("sparse_recovery/run.json", later_json, (*TINY, "model=sparse_recovery")),
        ("sparse_recovery/run.json", later_json, ("resume=sparse_recovery",)),
        ("sparse_recovery/run.json", later_json,
         (*RUNS["sparse_recovery"], "hydra.run.dir=sparse_recovery", "resume=auto")),
        ("sparse_recovery/.hydra/hydra.yaml", later_yaml, ("resume=sparse_recovery",)),
        ("sparse_recovery/model.npz", later_model, (*TINY, "model=sparse_recovery")),
        ("mlp/checkpoint.pt", later_checkpoint, ("resume=mlp",)),
        ("windows/windows/windows.json", later_json, ("resume=windows",)),
        ("windows/windows/0001/handed_over/model.npz", later_model, ("resume=windows",)),
        ("bayesian/chains/chain_1.npz", later_chain, ("resume=bayesian",)),
    ],
)  # fmt: skip
def test_a_later_release_is_named(stored, pinn_run, file, change, command):
    change(stored / file)
    content = (stored / file).read_bytes()
    pinn_run(*command).refused(f"{file}{TOLD.format(2 if file.endswith('model.npz') else 1)}")
    assert (stored / file).read_bytes() == content


def test_a_later_release_is_named_where_a_sweep_is_collected_and_in_python(stored: Path, pinn_run: PinnRun) -> None:
    (job,) = (stored / "sweep").glob("seed=0_*")
    later_json(job / "run.json")
    assert TOLD.format(1) in pinn_run("collect=sweep").out
    with pytest.raises(InputError, match="pinn-cli 9.9.9 wrote it and reads it"):
        load(job)
