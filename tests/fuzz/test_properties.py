"""Whatever is written, the configuration, the reader of records and the reader of checkpoints take it or refuse it.

The same inputs at each call; `make fuzz` tries others, and the whole command.
"""

import pickle
import tempfile
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from fuzz import files, overrides
from fuzz.trial import Trial, put
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from pinn_cli.cli.composing import compose_config
from pinn_cli.cli.config import RunConfig
from pinn_cli.cli.help import explain
from pinn_cli.record.measured_data import MeasuredData
from pinn_cli.runs.checkpoint import FORMAT, LAST, PREVIOUS, Checkpoints, OtherRunError, sealed
from pinn_cli.runs.identity import Identity
from pinn_cli.settings.errors import InputError

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
