"""Whatever is written is taken or refused in one line: what failed once, and what is drawn, the same at each call."""

import pickle
import tempfile
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from fuzz import files, overrides
from fuzz.judge import LONGEST_LINE, Judge, Outcome, import_everything
from fuzz.trial import Starts, Trial, put
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from pinn_cli.cli.composing import compose_config
from pinn_cli.cli.config import RunConfig
from pinn_cli.cli.help import explain
from pinn_cli.record.measured_data import MeasuredData
from pinn_cli.runs.checkpoint import FORMAT, LAST, PREVIOUS, Checkpoints, OtherRunError, sealed
from pinn_cli.runs.identity import Identity
from pinn_cli.settings.errors import InputError

CORPUS = sorted((Path(__file__).parent / "corpus").glob("*.json"))
# One of each family that does not take a whole estimate goes with every change.
QUICK = {
    "bombs-b74dd02f86", "csv-c21cf8a4e0", "disk-64e1592469", "launchers-1da9aacd41", "options-0a0bd1bfc4",
    "terminal-4838b0a1da", "yaml-14b0948da4",
}  # fmt: skip


def _kept(file: Path) -> pytest.param:
    return pytest.param(file, id=file.stem, marks=() if file.stem in QUICK else pytest.mark.slow)


@pytest.fixture(scope="module")
def judge(tmp_path_factory: pytest.TempPathFactory) -> Judge:
    import_everything()
    return Judge(Starts(tmp_path_factory.mktemp("starts")))


@pytest.mark.parametrize("file", [*map(_kept, CORPUS)])
def test_an_input_that_once_failed(judge: Judge, file: Path) -> None:
    trial = Trial.read(file)
    outcome = judge.outcome(trial)
    assert outcome.fault(trial) == "", outcome


def test_an_input_is_read_as_it_was_written(tmp_path: Path) -> None:
    trial = Trial("csv", ("data=csv", "ä"), {"rig.csv": ("bytes", b"\xff\x00"), "x": ("cut", 0.5)}, "finished", 10)
    (tmp_path / "kept.json").write_text(trial.text(), encoding="utf-8")
    assert Trial.read(tmp_path / "kept.json") == trial


TRIAL = Trial("options", ("seed=-1",))
REFUSED = Outcome(2, "", "pinn-run: seed=-1: must be a whole number >= 0\n", 1.0, (), False)
DONE = Outcome(0, "verdict: sound\n/outputs\n", "", 1.0, ("outputs/fitness.csv",), False)


@pytest.mark.parametrize(
    ("outcome", "fault"),
    [
        (REFUSED, ""),
        (DONE, ""),
        (Outcome(3, "", "pinn-run: diverged\n", 1.0, ("run.json",), False), ""),
        (replace(REFUSED, executed=True), "code of the input was executed"),
        (replace(REFUSED, status=None), "still running"),
        (replace(REFUSED, status=-11), "exit status -11"),
        (replace(REFUSED, status=1), "exit status 1"),
        (replace(REFUSED, err="Traceback (most recent call last):\n"), "traceback"),
        (replace(REFUSED, err=""), "0 lines"),
        (replace(REFUSED, err=2 * REFUSED.err), "2 lines"),
        (replace(REFUSED, err=f"a warning\n{REFUSED.err}"), "not a line of pinn-run's: a warning"),
        (replace(REFUSED, err=f"pinn-run: {'x' * LONGEST_LINE}\n"), "a line of 1510 characters"),
        (replace(REFUSED, changes=("run/run.lock",)), "refused, but changed run/run.lock"),
        (replace(DONE, out="/outputs\n"), "no verdict"),
    ],
)
def test_a_fault_is_named(outcome: Outcome, fault: str) -> None:
    found = outcome.fault(TRIAL)
    assert fault in found
    assert bool(found) == bool(fault)


# Reproducible, and short: a failure is shrunk by make fuzz's or by a longer call here.
FIXED = settings(
    derandomize=True, database=None, deadline=None, suppress_health_check=list(HealthCheck), max_examples=100
)
IDENTITY = Identity({"seed": "0"}, {"torch": "2"})


def plain(depth: int = 3) -> st.SearchStrategy[Any]:
    """What a checkpoint may hold, of any shape."""
    leaves = st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=5)
    keys = st.sampled_from(("format", "identity", "settings", "versions", "trainings", "random", "state", "ended", "x"))
    return st.recursive(leaves, lambda inner: st.lists(inner, max_size=3) | st.dictionaries(keys, inner), max_leaves=8)


class Counter:
    """The least of trainings."""

    def __init__(self) -> None:
        self.count = 0

    def state_dict(self) -> dict[str, Any]:
        return {"count": self.count}

    def load_state_dict(self, state: dict[str, Any]) -> None:
        self.count = int(state["count"])


def check_line(refused: Exception) -> None:
    assert "\n" not in str(refused)
    assert len(str(refused)) < 1500


@settings(FIXED, max_examples=15)
@given(overrides.options() | overrides.numbers() | overrides.physics())
def test_a_configuration_is_built_or_refused(trial: Trial) -> None:
    given_ = [argument for argument in trial.arguments if not argument.startswith(("-", "@", "hydra", "+hydra", "++h"))]
    try:
        composed = compose_config(given_)
        RunConfig.read(composed, Path("/nowhere"))
    except Exception as error:
        told = explain(error, given_, None, composing=True)
        if told is None:
            raise
        check_line(told)


@FIXED
@given(files.tables())
def test_a_record_is_read_or_refused(content: bytes) -> None:
    with tempfile.TemporaryDirectory() as folder:
        Path(folder, "rig.csv").write_bytes(content)
        data = MeasuredData("rig.csv", "t", {1: "f"}, acceleration={1: "a"}, base=Path(folder))
        try:
            record = data.measure(1).record
        except InputError as refused:
            check_line(refused)
            return
        assert np.isfinite(record.acceleration).all()
        assert np.isfinite(record.force).all()
        assert record.step > 0


@FIXED
@given(
    st.sampled_from(("cut", "flipped", "bytes", "forged", "sealed", "sealed")),
    st.floats(0, 1),
    st.binary(max_size=60),
    plain(),
)
def test_a_checkpoint_is_taken_up_or_refused(form: str, part: float, data: bytes, content: Any) -> None:
    """Damaged ones start over; a forged one whose seal is right is another run's, or no state of this training."""
    with tempfile.TemporaryDirectory() as folder:
        place, marker, training = Path(folder, LAST), Path(folder, "executed"), Counter()
        kept = Checkpoints(Path(folder), IDENTITY, None)
        kept.write(kept.packed(training))
        if form == "sealed":
            within = {"format": FORMAT, "identity": asdict(IDENTITY), "trainings": [], "random": {}}
            place.write_bytes(
                sealed({**within, **content} if isinstance(content, dict) else within | {"trainings": content})
            )
        else:
            put(place, form, {"cut": part, "flipped": part, "bytes": data, "forged": "checkpoint"}[form], marker)
        taken = Checkpoints(Path(folder), IDENTITY, None)
        try:
            if taken.take_up():
                taken.begin(training)
        except (OtherRunError, InputError) as refused:
            check_line(refused)
        assert not marker.exists()
        assert not Path(folder, PREVIOUS).exists()


@pytest.mark.parametrize("kind", ["bare", "archive", "checkpoint"])
def test_a_forged_checkpoint_would_execute_code(tmp_path: Path, kind: str) -> None:
    """Otherwise nothing would be shown by those that do not."""
    put(tmp_path / LAST, "forged", kind, tmp_path / "executed")
    if kind == "bare":
        pickle.loads((tmp_path / LAST).read_bytes())
    else:
        torch.load(tmp_path / LAST, weights_only=False)
    assert (tmp_path / "executed").is_dir()
