"""The paper's Tables 1 to 6 and the runs that they need; and what is made once and kept until something changes."""

from __future__ import annotations

import hashlib
import json
import subprocess
import sys
import time
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import cache
from importlib import resources
from pathlib import Path
from typing import Any, Literal, Protocol, TypeVar

import pandas as pd
from omegaconf import OmegaConf

from pinn_cli.cli.composing import compose_config
from pinn_cli.report.fitness import published
from pinn_cli.report.run_record import package_versions
from pinn_cli.runs.writing import write_json
from pinn_cli.settings.errors import InputError
from pinn_cli.settings.override_syntax import quoted

# Read what runs have left, and are no part of one: a better caption is no reason to run everything again.
READERS = ("paper/",)


@dataclass(frozen=True)
class Variant:
    """One way to run every case of a table: a word for files, what a table calls it, and settings of `pinn-run`."""

    name: str
    title: str
    overrides: tuple[str, ...] = ()

    @property
    def source(self) -> str:
        """What the row of a table says: whose estimate it is."""
        return self.title if self.name == SMOOTHER.name else f"ours, {self.title}"


SMOOTHER = Variant("kalman_smoother", "Kalman smoother")
# The first variant of every table has the smoother beside it, which solves the same problem.
WITH_SMOOTHER = ("baseline=kalman_smoother",)
UNCERTAIN = Variant("uncertain", "uncertain parameters", WITH_SMOOTHER)
FIXED = Variant("fixed", "fixed parameters", ("scheme.parameter_uncertainty=0",))
MARGINAL = Variant("marginal", "marginal posterior, states uncertain", WITH_SMOOTHER)
CONDITIONAL = Variant(
    "conditional", "conditional posterior, states held fixed as in the paper", ("posterior=conditional",)
)
LAPLACE = Variant("laplace", "Laplace's approximation of the marginal posterior, no sampling", ("posterior=laplace",))


@dataclass(frozen=True)
class CaseTable:
    """A published table whose cases are each run with every variant, of which the first is the product's own choice.

    ``kind`` is what it compares, ``published`` its name in the column ``table`` of the published values.
    """

    name: str
    title: str
    kind: Literal["fitness", "parameters", "perturbed_parameters"]
    published: str
    variants: tuple[Variant, ...] = (UNCERTAIN, FIXED)

    @property
    def values(self) -> pd.DataFrame:
        """The published rows."""
        values: pd.DataFrame = published(self.kind)
        return values[values["table"] == self.published]

    @property
    def cases(self) -> list[str]:
        """In the paper's order."""
        return list(dict.fromkeys(self.values["case"]))

    @property
    def sources(self) -> tuple[Variant, ...]:
        """Whose estimates stand in it."""
        return (*self.variants, SMOOTHER)


TABLES = (
    CaseTable(
        "table1", "Table 1: prescribed, true and estimated parameters of the chain with wrong values",
        "perturbed_parameters", "sr-valerr-duf-prescr", (UNCERTAIN,),
    ),
    CaseTable("table2", "Table 2: sparse recovery", "fitness", "sr-summary"),
    CaseTable(
        "table3", "Table 3: state-parameter estimation, parameters of the Duffing chain by noise", "parameters",
        "spe-nonerr-duf",
    ),
    CaseTable(
        "table4", "Table 4: state-parameter estimation, parameters of the Van der Pol chain and with wrong models",
        "parameters", "spe-vdp-err",
    ),
    CaseTable("table5", "Table 5: state-parameter estimation, states", "fitness", "spe-summary"),
    CaseTable(
        "table6", "Table 6: Bayesian parameter estimation, 2-DOF chains", "parameters", "mcmc-results",
        (MARGINAL, CONDITIONAL, LAPLACE),
    ),
)  # fmt: skip


@dataclass(frozen=True)
class PlannedRun:
    """One run of the paper: a case of ``conf/experiment/paper``, and how it is run."""

    case: str
    variant: Variant

    @property
    def name(self) -> str:
        """Of its directory."""
        return f"{self.case}_{self.variant.name}"

    @property
    def overrides(self) -> tuple[str, ...]:
        """As `pinn-run` takes them."""
        return (f"experiment=paper/{self.case}", *self.variant.overrides)

    @property
    def digest(self) -> str:
        """See `run_digest`."""
        return run_digest(self.overrides)


def planned_runs(tables: Sequence[CaseTable] = TABLES) -> list[PlannedRun]:
    """The runs of some tables, in their order; a case that stands in two tables is run once."""
    runs = [PlannedRun(case, variant) for table in tables for case in table.cases for variant in table.variants]
    return list(dict.fromkeys(runs))


Runner = Callable[[PlannedRun, Path], float]


class CaseFailedError(RuntimeError):
    """A run that did not end well: the command and the end of what it wrote."""


def run_case(run: PlannedRun, directory: Path) -> float:
    """Run ``pinn-run experiment=paper/<case>`` in ``directory``; the seconds of the whole process.

    Raises:
        CaseFailedError: If the process ends with another status than 0, or leaves no results.
    """
    results = directory / "run.json"
    results.unlink(missing_ok=True)  # of an earlier run: it must not pass for this one's
    place, start = f"hydra.run.dir={quoted(str(directory.resolve()))}", time.perf_counter()
    command = [sys.executable, "-m", "pinn_cli.main", *run.overrides, place]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    if done.returncode != 0 or not results.exists():
        tail = "\n".join((done.stderr or done.stdout).splitlines()[-10:])
        raise CaseFailedError(f"exit status {done.returncode}\n{tail}")
    return time.perf_counter() - start


@dataclass(frozen=True, eq=False)
class FinishedRun:
    """A run whose files are there and up to date: its ``run.json``, and the seconds of the whole process."""

    planned: PlannedRun
    directory: Path
    record: dict[str, Any]
    process_seconds: float

    def table(self, name: str) -> pd.DataFrame:
        """Its ``fitness`` or ``parameters``, the smoother's rows as a variant of its own where it found something.

        In front stand ``case``, ``variant``, ``seconds`` (total of ``run.json``) and ``process_seconds`` (imports and
        figures included); of the smoother both are those of its solution alone.
        """
        rows, seconds = pd.read_csv(self.directory / f"{name}.csv"), self.record["seconds"]
        ours, alone = rows["estimator"] != SMOOTHER.name, float(seconds.get("baseline", 0.0))
        columns = {
            "case": self.planned.case,
            "variant": ours.map({True: self.planned.variant.name, False: SMOOTHER.name}),
            "seconds": ours.map({True: float(seconds["total"]), False: alone}),
            "process_seconds": ours.map({True: self.process_seconds, False: alone}),
        }
        return pd.DataFrame(columns, index=rows.index).join(rows.drop(columns=["case", "seconds"], errors="ignore"))


def make_runs(
    planned: Sequence[PlannedRun], directory: Path, runner: Runner = run_case, at_once: int = 1
) -> tuple[list[FinishedRun], list[str]]:
    """Make what is missing or out of date in ``<directory>/<case>_<variant>``: all runs, and what went wrong."""
    failures = make_missing(
        planned, directory, lambda run: {"process_seconds": runner(run, directory / run.name)}, at_once
    )
    return read_runs(planned, directory), failures


def read_runs(planned: Sequence[PlannedRun], directory: Path) -> list[FinishedRun]:
    """Those that are there and up to date; nothing is run."""
    runs = []
    for run in planned:
        if (content := kept(run, directory)) is not None:
            record = json.loads((directory / run.name / "run.json").read_text(encoding="utf-8"))
            runs.append(FinishedRun(run, directory / run.name, record, content["process_seconds"]))
    return runs


class Planned(Protocol):
    """Something that is made and kept under its name, until the digest of what it depends on is another."""

    @property
    def name(self) -> str:
        """Of its file, ``<name>.json``."""

    @property
    def digest(self) -> str:
        """Of configuration, code and versions."""


P = TypeVar("P", bound=Planned)


def make_missing(
    planned: Sequence[P], directory: Path, make: Callable[[P], Mapping[str, object]], at_once: int = 1
) -> list[str]:
    """Make what is missing or out of date, and keep each as it comes; what went wrong with the others, a text each.

    The files are ``<name>.json``. ``make`` makes the content of one; it raises `CaseFailedError` or `InputError` where
    that fails.
    """
    # Here: Hydra composes in one thread alone.
    tasks = [(number, item, item.digest) for number, item in enumerate(planned, start=1)]

    def make_one(task: tuple[int, P, str]) -> str:
        number, item, digest = task
        progress, file = f"[{number}/{len(planned)}] {item.name}", directory / f"{item.name}.json"
        if kept(item, directory, digest) is not None:
            print(f"{progress}: up to date", flush=True)
            return ""
        start = time.perf_counter()
        file.unlink(missing_ok=True)  # while it is made, nothing may say that it is there
        try:
            write_json({"digest": digest, **make(item)}, file)
        except (CaseFailedError, InputError) as error:
            print(f"failed: {item.name}: {error}", file=sys.stderr, flush=True)
            return f"{item.name}: {error}"
        print(f"{progress}: {time.perf_counter() - start:.1f} s", flush=True)
        return ""

    with ThreadPoolExecutor(at_once) as pool:
        # Ctrl-C reaches what is made in this thread at once, and cancels what waits for one of the others.
        failures = pool.map(make_one, tasks) if at_once > 1 else map(make_one, tasks)
        return [failure for failure in failures if failure]


def kept(item: Planned, directory: Path, digest: str | None = None) -> dict[str, Any] | None:
    """What `make_missing` has kept; None where it is to be made (again)."""
    try:
        content = json.loads((directory / f"{item.name}.json").read_text(encoding="utf-8"))
        return content if content.pop("digest") == (digest or item.digest) else None
    except (OSError, ValueError, KeyError, TypeError, AttributeError):
        return None


def run_digest(overrides: Sequence[str]) -> str:
    """SHA-256 of the composed configuration, the code and the versions that a run with these overrides depends on.

    Raises:
        hydra.errors.HydraException: The overrides do not compose.
    """
    parts = (_composed(tuple(overrides)), source_digest(), json.dumps(package_versions(), sort_keys=True))
    return digest_of("\0".join(parts))


@cache  # composing takes a tenth of a second
def _composed(overrides: tuple[str, ...]) -> str:
    return OmegaConf.to_yaml(compose_config(overrides))


@cache
def source_digest() -> str:
    """Of the package's modules and configs, without `READERS`."""
    package, conf = (Path(str(resources.files(name))) for name in ("pinn_cli", "pinn_cli.conf"))
    return tree_digest(package, "*.py", READERS) + tree_digest(conf, "*.yaml")


def tree_digest(root: Path, pattern: str, left_out: tuple[str, ...] = ()) -> str:
    """SHA-256 of the names and contents of files below a folder, without those whose paths begin as ``left_out``."""
    names = {file.relative_to(root).as_posix(): file for file in sorted(root.rglob(pattern))}
    # The digest of each file, not its bytes: no content can pass for a name.
    lines = [f"{name}\0{digest_of(names[name].read_bytes())}\n" for name in names if not name.startswith(left_out)]
    return digest_of("".join(lines))


def digest_of(content: str | bytes) -> str:
    """SHA-256 of a text or a file's content."""
    return hashlib.sha256(content.encode() if isinstance(content, str) else content).hexdigest()
