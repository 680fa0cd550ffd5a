"""Tracking with TensorBoard: an event file in the run's directory, written while the run goes on."""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING

from pinn_cli.settings.errors import InputError
from pinn_cli.settings.legal_values import located
from pinn_cli.sweep.tracking.tracking import Outcome, TrackedRun, Tracker, Tracking, require

if TYPE_CHECKING:
    from torch.utils.tensorboard.writer import SummaryWriter

BOARDS_FOLDER = "tensorboard"
# Seconds from one batch of rows on the disk to the next.
BATCH_S = 5


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

    def open(self, run: TrackedRun, key: str, before: str) -> TensorboardTracker:
        """See :meth:`Tracking.open`."""
        place = run.directory / BOARDS_FOLDER if self.directory is None else self.directory / run.name
        tracker = TensorboardTracker(place, run, key)
        try:
            place.mkdir(parents=True, exist_ok=True)
            if key != before:
                tracker.begin()
                _take_away(place, before)
        except (OSError, ValueError) as error:  # a null character is a ValueError
            tracker.delete()
            hint = f"{place}: {getattr(error, 'strerror', None) or error}"
            raise InputError("tracking.directory", self.directory, "a folder that can be written to", hint) from error
        return tracker


class TensorboardTracker(Tracker):
    """The event files of one run in a folder; their names end in its key: those of others may lie there, and stay."""

    def __init__(self, place: Path, run: TrackedRun, key: str) -> None:
        self.place, self.run, self.key = place, run, key
        self.writer: SummaryWriter | None = None

    def begin(self) -> SummaryWriter:
        """Write anew from the settings on: what an earlier process wrote of this run is told once more."""
        from torch.utils.tensorboard import SummaryWriter

        _take_away(self.place, self.key)
        # Who looks on while the run goes on forgets what it has read of the earlier file.
        self.writer = SummaryWriter(str(self.place), purge_step=0, flush_secs=BATCH_S, filename_suffix=f".{self.key}")
        table = ["| setting | value |", "| --- | --- |", *(f"| {n} | {v} |" for n, v in self.run.settings.items())]
        self.writer.add_text("settings", "\n".join(table))
        self.writer.flush()
        return self.writer

    def row(self, row: Mapping[str, float]) -> None:
        """See :meth:`Tracker.row`: the step is the iteration."""
        writer = self.writer or self.begin()
        for name, value in row.items():
            if name != "iteration":  # `loss_physics` as `loss/physics`: a panel for all losses, one for all weights
                writer.add_scalar(name.replace("_", "/", 1), value, int(row["iteration"]))

    def end(self, status: str, reason: str, outcome: Outcome | None) -> None:
        """See :meth:`Tracker.end`."""
        if self.writer is None:  # nothing was told: what an earlier process told is still there
            return
        self.writer.add_text("status", f"{status}: {reason}" if reason else status)
        if outcome is not None:
            self._results(self.writer, outcome)
        self.writer.close()

    def _results(self, writer: SummaryWriter, outcome: Outcome) -> None:
        import numpy as np
        from matplotlib.image import imread
        from torch.utils.tensorboard import FileWriter
        from torch.utils.tensorboard.summary import hparams

        metrics = {f"results/{name}": value for name, value in outcome.metrics.items()}
        for name, value in metrics.items():
            writer.add_scalar(name, value, 0)
        for figure in outcome.figures:
            writer.add_image(figure.stem, np.asarray(imread(figure))[..., :3], 0, dataformats="HWC")
        writer.flush()
        # SummaryWriter.add_hparams would make a file without the key. A reader never comes back from a later file.
        results_writer = FileWriter(str(self.place), filename_suffix=f".{self.key}")
        for summary in hparams(dict(self.run.settings), metrics):
            results_writer.add_summary(summary)
        results_writer.close()

    def delete(self) -> None:
        """See :meth:`Tracker.delete`."""
        if self.writer is not None:
            with suppress(OSError):  # a disk that is full
                self.writer.close()
        _take_away(self.place, self.key)
        with suppress(OSError):  # it is no folder, or holds something
            self.place.rmdir()


def _take_away(place: Path, key: str) -> None:
    """Remove the event files of the run with that key."""
    for events in place.glob(f"events.out.tfevents.*.{key}") if key else ():
        events.unlink()
