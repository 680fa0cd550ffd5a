"""The task as Hydra calls it, once per job, and what became of the jobs."""

from __future__ import annotations

import logging
import traceback
from collections.abc import Callable, Sequence
from contextlib import suppress
from pathlib import Path

from hydra.core.hydra_config import HydraConfig
from hydra.types import RunMode
from omegaconf import DictConfig, ListConfig, OmegaConf

from pinn_cli.cli.terminal import Terminal
from pinn_cli.runs.claim import Claim, entered
from pinn_cli.runs.interruption import stop_if_asked
from pinn_cli.runs.machine import is_out_of_memory, of_this_machine
from pinn_cli.runs.reading import stamp
from pinn_cli.runs.resume import FORMAT, StoredRun, going_on, how_to_go_on
from pinn_cli.runs.writing import WriteError, refused_by_disk
from pinn_cli.settings.errors import DivergenceError, InputError, NotSoundError
from pinn_cli.sweep import failure
from pinn_cli.sweep.jobs import note_failure

log = logging.getLogger(__name__)

Task = Callable[[DictConfig], float | None]

# Errors that a user can mend, or must know of: one line each.
Reported = InputError | DivergenceError | WriteError | NotSoundError
REPORTED = (InputError, DivergenceError, WriteError, NotSoundError)


class Jobs:
    """See the module.

    An error of a run that the user can mend is kept in `error` and does not reach Hydra, which would print a line of
    its own. A job of a sweep, in this process or in a launcher's worker, leaves any error in its directory and takes
    no other job along; what collects the sweep reports it.

    Args:
        task: Called with the composed configuration, without its `hydra` node; once per job of a sweep.
        terminal: Who is told.
        full_error: Whether tracebacks are printed too.
        of_hydra: Overrides of Hydra's own settings, put after those of the user.

    Attributes:
        error: Of the run, one that its user can mend; None where there is none.
        hint: What to do about it.
        reasons: Why every job of a sweep was refused.
        directory: Of the last run, or of the sweep that has ended.
        goes_on_by: What goes on with an interrupted run; "": `pinn-run resume=...`.
    """

    def __init__(self, task: Task, terminal: Terminal, full_error: bool = False, of_hydra: Sequence[str] = ()) -> None:
        self.task, self.terminal, self.full_error, self.of_hydra = task, terminal, full_error, of_hydra
        self.started = False
        self.status = 0
        self.error: Reported | None = None
        self.hint = ""
        self.reasons: list[str] = []
        self.refused = False
        self.stored: StoredRun | None = None
        self.directory: Path | None = None
        self.begun = False
        self.goes_on_by = ""

    def __call__(self, config: DictConfig) -> float | None:
        """Run one job; what it returns reaches Hydra's sweeper: a score, or None where there is none."""
        self.started = True
        self.directory = Path(HydraConfig.get().runtime.output_dir)
        in_sweep = HydraConfig.get().mode == RunMode.MULTIRUN
        setting = "hydra.sweep.dir" if in_sweep else "hydra.run.dir"
        claim = Claim(self.directory, setting, {} if self.stored else _settings(config))
        with entered(claim):
            try:
                if not in_sweep and not HydraConfig.get().run.dir:
                    raise InputError(setting, HydraConfig.get().run.dir, "a directory")
                return self._run(config, claim, in_sweep)
            except Exception as raised:
                stop_if_asked()
                error = _explained(raised)
                _conclude(claim, error)
                if in_sweep and claim.locked:  # else it is no directory of ours to write into
                    overrides = HydraConfig.get().overrides.task
                    note_failure(self.directory, overrides, failure.Failure.of(error))
                elif isinstance(error, Reported) and not in_sweep:
                    self.error = error
                    self.hint = how_to_go_on(self.directory, self.goes_on_by) if isinstance(error, WriteError) else ""
                    self.refused = isinstance(error, InputError)
                elif error is raised:
                    raise
                else:
                    raise error from raised
                return None
            finally:
                self.begun = claim.taken

    def _run(self, config: DictConfig, claim: Claim, in_sweep: bool) -> float | None:
        if in_sweep:
            claim.lock()  # from here on it is seen to have begun, should it be killed
            score = self.task(going_on(config))
        else:
            score = self.task(config if self.stored is None else self.stored.configuration(config))
        claim.take()
        if in_sweep:
            failure.clear(claim.directory)
        return score


def _settings(config: DictConfig) -> dict[str, DictConfig | ListConfig]:
    """What `.hydra/` holds, by file: as Hydra itself would have written it, but for when."""
    hydra = HydraConfig.get()
    return {
        "hydra.yaml": OmegaConf.create({**stamp(FORMAT), "hydra": hydra}),
        "config.yaml": config,
        "overrides.yaml": OmegaConf.create(hydra.overrides.task),
    }


def _conclude(claim: Claim, error: Exception) -> None:
    """A refused run leaves nothing; one that failed in another way leaves its settings and a log that says so."""
    if isinstance(error, InputError):
        claim.refuse()
        return
    log.info("%s", error if isinstance(error, Reported) else "".join(traceback.format_exception(error)))
    with suppress(InputError):
        claim.take()


def _explained(error: Exception) -> Exception:
    """The same error, or where memory or the disk ran out one that says so in a user's words."""
    if not is_out_of_memory(error):
        full = refused_by_disk(error)
        return error if full is None else full.with_traceback(error.__traceback__)
    given = " ".join(HydraConfig.get().overrides.task) or "(none)"
    allowed = f"such that the run fits into memory; this machine has {of_this_machine() / 2**30:.3g} GiB"
    return InputError("overrides", given, allowed, str(error).partition("\n")[0]).with_traceback(error.__traceback__)
