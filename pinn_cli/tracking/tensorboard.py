"""Tracking with TensorBoard: event files in the run's directory."""

from __future__ import annotations

import threading
from collections.abc import Mapping, Sequence
from contextlib import suppress
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING

from pinn_cli.runs.tracking_state import NOTHING, TrackingState
from pinn_cli.settings.errors import InputError
from pinn_cli.settings.paths import located
from pinn_cli.tracking.base import TrackedRun, Tracker, Tracking, require
from pinn_cli.tracking.outcome import Outcome

if TYPE_CHECKING:
    from torch.utils.tensorboard.writer import SummaryWriter

FOLDER = "tensorboard"


class TensorboardTracking(Tracking):
    """Scalars by iteration, figures as images, the settings as text and as hyperparameters.

    Args:
        directory: Where the event files of all runs go, in a folder for each; None: into the run's own directory.
        base: The folder that a relative directory starts from; None: the current one.

    Raises:
        InputError: TensorBoard is not installed, or the directory is none.
    """

    name = "tensorboard"

    def __init__(self, directory: str | None = None, base: Path | None = None) -> None:
        require("tensorboard", self.name)
        if directory is not None and (not isinstance(directory, str) or not directory):
            raise InputError("tracking.directory", directory, "null or a folder")
        self.directory = None if directory is None else located(directory, (base or Path()).absolute())

    def open(self, run: TrackedRun, state: TrackingState, known: bool) -> TensorboardTracker:
        """See :meth:`Tracking.open`."""
        known = known and state.logged > NOTHING  # there may be less than the settings otherwise
        place = run.directory / FOLDER if self.directory is None else self.directory / run.name
        try:
            place.mkdir(parents=True, exist_ok=True)
            from torch.utils.tensorboard import SummaryWriter

            if not known:
                for events in place.glob("events.out.tfevents.*"):  # of a run that this one replaces
                    events.unlink()
            _leave_failures_to_calls()
            # A reader passes over what lies there of later rows: those that were written, but not noted, before a kill.
            writer = SummaryWriter(log_dir=str(place), purge_step=int(state.logged) + 1 if known else None)
            tracker = TensorboardTracker(writer, place, run)
            if not known:
                tracker.settings()
        except (OSError, ValueError) as error:  # a null character is a ValueError
            if not known:
                _take_away(place)
            hint = f"{place}: {getattr(error, 'strerror', None) or error}"
            raise InputError("tracking.directory", self.directory, "a folder that can be written to", hint) from error
        return tracker


class TensorboardTracker(Tracker):
    """One folder of event files."""

    def __init__(self, writer: SummaryWriter, place: Path, run: TrackedRun) -> None:
        self.writer, self.place, self.run = writer, place, run

    def settings(self) -> None:
        """Note them as text."""
        table = ["| setting | value |", "| --- | --- |", *(f"| {n} | {v} |" for n, v in self.run.settings.items())]
        self.writer.add_text("settings", "\n".join(table))
        self.writer.flush()

    def rows(self, rows: Sequence[Mapping[str, float]]) -> None:
        """See :meth:`Tracker.rows`: the step is the iteration."""
        for row in rows:
            for name, value in row.items():
                if name != "iteration":
                    self.writer.add_scalar(_grouped(name), value, int(row["iteration"]))
        self.writer.flush()

    def results(self, outcome: Outcome) -> None:
        """See :meth:`Tracker.results`."""
        import numpy as np
        from matplotlib.image import imread
        from torch.utils.tensorboard.summary import hparams

        metrics = {f"results/{name}": value for name, value in outcome.metrics.items()}
        # SummaryWriter.add_hparams would make another run of them, beside this one.
        for summary in hparams(dict(self.run.settings), metrics):
            self.writer._get_file_writer().add_summary(summary)
        for name, value in metrics.items():
            self.writer.add_scalar(name, value, 0)
        for figure in outcome.figures:
            self.writer.add_image(figure.stem, np.asarray(imread(figure))[..., :3], 0, dataformats="HWC")
        self.writer.flush()

    def end(self, status: str, reason: str) -> None:
        """See :meth:`Tracker.end`."""
        self.writer.add_text("status", f"{status}: {reason}" if reason else status)
        self.writer.close()

    def delete(self) -> None:
        """See :meth:`Tracker.delete`."""
        self.writer.close()
        _take_away(self.place)


def _take_away(place: Path) -> None:
    """Remove the event files of a run, and their folder if it is empty then."""
    with suppress(OSError):
        for events in place.glob("events.out.tfevents.*"):
            events.unlink()
        place.rmdir()


@cache
def _leave_failures_to_calls() -> None:
    """Have TensorBoard's writing threads print no traceback: what stopped one is raised by the next call of it."""
    otherwise = threading.excepthook

    def hook(raised: threading.ExceptHookArgs) -> None:
        if not type(raised.thread).__module__.startswith("tensorboard."):
            otherwise(raised)

    threading.excepthook = hook


def _grouped(name: str) -> str:
    """``loss_physics`` as ``loss/physics``: one panel for all losses, one for all weights."""
    kind, _, rest = name.partition("_")
    return f"{kind}/{rest}" if rest else name
