"""What became of a trial: the command in a forked child of this process, which has everything imported, is judged."""

import contextlib
import hashlib
import importlib
import os
import pkgutil
import re
import resource
import select
import shutil
import signal
import subprocess
import sys
import tempfile
import time
import traceback
from dataclasses import dataclass
from pathlib import Path

from calls import ALIVE, limit_files
from fuzz.trial import Starts, Trial

DONE, REFUSED, DIVERGED, NOT_SOUND = 0, 2, 3, 4
LONGEST_LINE = 1500
# Of memory; a machine that runs out of it takes others along.
MOST_MEMORY = 12 * 2**30
# A run that is over says one of these; a sweep, its tables; or what was asked about settings.
SAID = re.compile(
    r"^verdict: (sound|questionable|failed)|\"verdict\": \"|^finished before|^\d+ (samples from|peaks? with)|"
    r"\bjobs?\b.*\b(done|failed|finished)|^== ",
    re.M,
)
QUESTIONS = ("--help", "--cfg", "--info", "--version", "--hydra-help", "-h", "-c", "-i", "--shell-completion")
# What a sweep ends with, some of whose jobs may have been refused; and how far it is.
_SWEPT = re.compile(r"^\d+ jobs: ", re.M)
_SWEEP = re.compile(r"\d+ of \d+ ")
# What a terminal obeys or hides, but for tabs and the ends of lines.
_CONTROL = re.compile(r"[\x00-\x08\x0b-\x1f\x7f-\x9f\u200b-\u200f\u202a-\u202e\u2066-\u2069]")
_TRACEBACK = re.compile(r"Traceback \(most recent call last\)|^\s+File \"", re.M)


@dataclass(frozen=True)
class Outcome:
    """What became of a trial.

    Attributes:
        status: Exit status; negative: the signal that ended it; None: it was still running after the time limit.
        out, err: What it printed.
        seconds: That it took.
        changes: Files of its folder that are new, gone or changed.
        executed: Whether code of the input was executed, or anything was written beside its folder.
    """

    status: int | None
    out: str
    err: str
    seconds: float
    changes: tuple[str, ...]
    executed: bool

    def fault(self, trial: Trial) -> str:
        """What is wrong with it; empty where nothing is."""
        lines = [line for line in self.err.splitlines() if line.strip()]
        if self.executed:
            return "code of the input was executed, or something was written outside of its folder"
        if self.status is None:
            return f"still running after {self.seconds:.0f} s"
        if shown := _CONTROL.search(self.out + self.err):
            return f"a control character reaches the terminal: {shown[0]!r}"
        if _TRACEBACK.search(self.err) or _TRACEBACK.search(self.out):
            return "traceback"
        if self.status not in (DONE, REFUSED, DIVERGED, NOT_SOUND):
            return f"exit status {self.status}"
        asked = any(argument.partition("=")[0] in QUESTIONS for argument in trial.arguments)
        foreign = [line for line in lines if not line.startswith("pinn-run: ") and not _SWEEP.match(line)]
        if foreign and not asked:
            return f"not a line of pinn-run's: {foreign[0][:200]}"
        if any(len(line) > LONGEST_LINE for line in lines):
            return f"a line of {max(map(len, lines))} characters"
        refused = self.status == REFUSED and not _SWEPT.search(self.out)
        told = [line for line in lines if not (_SWEEP.match(line) or line.startswith(ALIVE))]
        if refused and len(told) != 1:
            return f"{len(told)} lines instead of one"
        if refused and self.changes:
            return f"refused, but changed {', '.join(self.changes[:4])}"
        if self.status == DONE and not SAID.search(self.out) and not asked:
            return "done, but no verdict"
        return ""


class Judge:
    """Tries inputs, each in a folder of its own.

    Args:
        starts: What may lie in the folder.
        limit_s: Seconds that a trial may take.
    """

    def __init__(self, starts: Starts, limit_s: float = 240.0) -> None:
        self.starts, self.limit_s = starts, limit_s

    def outcome(self, trial: Trial, executable: bool = False) -> Outcome:
        """Of a trial.

        Args:
            trial: To be tried.
            executable: Whether by the real `pinn-run`, in a process of its own from the first instruction on.
        """
        with tempfile.TemporaryDirectory(prefix="fuzz-") as above:
            folder, marker = Path(above, "here"), Path(above, "executed")
            self.starts.lay(trial.start, folder)
            trial.prepare(folder, marker)
            before = contents(folder)
            begun = time.monotonic()
            status, out, err = self._called(trial, folder, executable)
            seconds = time.monotonic() - begun
            after = contents(folder)
            changes = sorted(name for name in before.keys() | after.keys() if before.get(name) != after.get(name))
            beside = [entry.name for entry in Path(above).iterdir() if entry.name not in ("here", "home")]
            return Outcome(status, out, err, seconds, tuple(changes), bool(beside))

    def _called(self, trial: Trial, folder: Path, executable: bool) -> tuple[int | None, str, str]:
        """Exit status of the command, None where it was killed for taking too long, and what it printed."""
        pipes = [os.pipe() for _ in range(2)]
        process = os.fork()
        if process == 0:
            try:
                _child(trial, folder, executable, [write for _, write in pipes])
            finally:
                os._exit(70)
        for _, write in pipes:
            os.close(write)
        printed = {read: b"" for read, _ in pipes}
        end, status, ended = time.monotonic() + self.limit_s, 0, 0
        while not ended and time.monotonic() < end:
            ended, status = os.waitpid(process, os.WNOHANG)
            self._read(printed, 0.01 if not ended else 0.0)
        with contextlib.suppress(ProcessLookupError):
            os.killpg(process, signal.SIGKILL)  # or what it left running
        if not ended:
            os.waitpid(process, 0)
        self._read(printed, 0.0)
        out, err = (printed[read].decode("utf-8", "replace") for read, _ in pipes)
        for read, _ in pipes:
            os.close(read)
        return os.waitstatus_to_exitcode(status) if ended else None, out, err

    @staticmethod
    def _read(printed: dict[int, bytes], wait_s: float) -> None:
        """Add what the pipes hold."""
        while ready := select.select(list(printed), [], [], wait_s)[0]:
            pieces = {read: os.read(read, 65536) for read in ready}
            printed.update({read: printed[read] + piece for read, piece in pieces.items()})
            if not all(pieces.values()):  # closed
                time.sleep(wait_s)
                return


def contents(folder: Path) -> dict[str, str]:
    """Every file below a folder, by its path, to what tells it from another one."""
    return {str(entry.relative_to(folder)): _digest(entry) for entry in sorted(folder.rglob("*"))}


def _digest(entry: Path) -> str:
    if entry.is_symlink():
        return f"link to {os.readlink(entry)}"
    if not entry.is_file():
        return "folder" if entry.is_dir() else "other"
    return hashlib.sha256(entry.read_bytes()).hexdigest()


def _child(trial: Trial, folder: Path, executable: bool, pipes: list[int]) -> None:
    os.setsid()
    os.chdir(folder)
    for number, pipe in enumerate(pipes, start=1):
        os.dup2(pipe, number)
    os.dup2(os.open(os.devnull, os.O_RDONLY), 0)
    (folder.parent / "home").mkdir(exist_ok=True)
    os.environ["HOME"] = str(folder.parent / "home")
    os.environ.pop("HYDRA_FULL_ERROR", None)
    resource.setrlimit(resource.RLIMIT_AS, (MOST_MEMORY, MOST_MEMORY))
    if trial.largest_file is not None:
        signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
        limit_files(trial.largest_file)
    if executable and trial.arguments[0] != "load":
        command = shutil.which("pinn-run", path=os.path.dirname(sys.executable)) or "pinn-run"
        os._exit(subprocess.run([command, *trial.arguments], check=False).returncode)
    sys.argv = ["pinn-run", *trial.arguments]
    sys.stdout = open(1, "w", closefd=False)  # noqa: SIM115
    sys.stderr = open(2, "w", closefd=False, buffering=1)  # noqa: SIM115
    status = 1
    try:
        if trial.arguments[0] == "load":
            status = _load(Path(trial.arguments[1]))
        else:
            from pinn_cli.cli.command_line import execute
            from pinn_cli.main import TASKS, run

            status = execute(run, TASKS)
    except SystemExit as end:
        status = end.code if isinstance(end.code, int) else int(end.code is not None)
    except BaseException:
        traceback.print_exc()
    with contextlib.suppress(OSError):
        sys.stdout.flush()
        sys.stderr.flush()
    os._exit(status & 0xFF)


def _load(directory: Path) -> int:
    """Ask the interface in Python for all that it has of a directory, and tell as the command does how that ends."""
    import pinn_cli

    told: list[str] = []
    try:
        found = pinn_cli.load(directory)
        print(f"verdict: sound\n{found!r}")  # one is printed: it opened
    except pinn_cli.InputError as error:
        print(f"pinn-run: {error}", file=sys.stderr)
        return REFUSED
    for each in (found, *found) if isinstance(found, pinn_cli.SweepResult) else (found,):
        for name in [name for name in dir(each) if not name.startswith("_")] + ["_repr_html_"]:
            try:
                value = getattr(each, name)
                value = value() if name == "_repr_html_" else value
                told.append("" if name in ("fitness", "parameters", "table") else repr(value)[:200])
            except pinn_cli.InputError:
                continue
        with contextlib.suppress(pinn_cli.InputError):
            each.plot.names if isinstance(each, pinn_cli.Result) else ()
    print("\n".join(told))
    return DONE


def import_everything() -> None:
    """Import what a run imports, once, so that children need not."""
    import pinn_cli

    for module in pkgutil.walk_packages(pinn_cli.__path__, "pinn_cli."):
        if not module.name.endswith("__main__"):
            with contextlib.suppress(ImportError):
                importlib.import_module(module.name)
    for name in ("scipy.signal", "scipy.optimize", "scipy.interpolate", "h5netcdf", "pandas", "torch.optim"):
        importlib.import_module(name)
