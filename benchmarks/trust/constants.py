"""What a named number of the estimator does: cases are run again with it halved and doubled.

A run is a forked process whose modules are read anew, the changed number in its place. So default arguments and what
else is worked out on import follow it. Which numbers a case has to do with is found by its calls: a number that no
called function names moves nothing.
"""

from __future__ import annotations

import ast
import dis
import importlib
import importlib.util
import os
import resource
import signal
import sys
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, replace
from functools import cache
from importlib.abc import MetaPathFinder
from importlib.machinery import ModuleSpec, SourceFileLoader
from multiprocessing import get_context
from operator import call
from pathlib import Path
from tempfile import TemporaryDirectory
from types import CodeType, FrameType, ModuleType
from typing import TypeVar

import pandas as pd

from benchmarks.trust.case import Case
from benchmarks.trust.families import drawn
from benchmarks.trust.programs import HERE
from benchmarks.trust.score import Row, Scored, scored
from benchmarks.trust.table import A_MOVE, Judged, moves

FACTORS = (0.5, 2.0)
ROOMS = ("scheme", "training", "verdict")  # whose numbers decide results
# What takes long to import and is no part of the program.
ELSEWHERE = ("torch", "scipy.optimize", "scipy.signal", "scipy.sparse.linalg", "scipy.interpolate", "xarray", "hydra")
PATIENCE = 10.0  # times the seconds that a case usually takes, after which it is ended
R = TypeVar("R")
READ = "read"  # file that a run without a change leaves beside its directory


@dataclass(frozen=True)
class Constant:
    """A named number at the top of a module: `path` relative to `pinn_cli`, `value` as it is written."""

    path: str
    name: str
    value: str

    @property
    def label(self) -> str:
        """How it is asked for: `training/beginning.TIE`."""
        return f"{self.path.removesuffix('.py')}.{self.name}"

    @property
    def module(self) -> str:
        """By its full name."""
        return "pinn_cli." + self.path.removesuffix(".py").replace("/", ".")


@dataclass(frozen=True)
class Change:
    """A constant times a factor; a whole number stays one."""

    constant: Constant
    factor: float

    def applied(self, text: str) -> ast.Module:
        """The module with this text, the number changed."""
        tree = ast.parse(text)
        for target, value in named_values(tree):
            if target.id == self.constant.name:
                changed = f"(lambda x: type(x)(x * {self.factor!r}))({ast.unparse(value)})"
                return ast.fix_missing_locations(_Replaced(value, ast.parse(changed, mode="eval").body).visit(tree))
        raise ValueError(f"{self.constant.path} has no number {self.constant.name}")


class _Replaced(ast.NodeTransformer):
    def __init__(self, old: ast.expr, new: ast.expr) -> None:
        self.old, self.new = old, new

    def visit(self, node: ast.AST) -> ast.AST:
        if node is self.old:
            return ast.copy_location(self.new, node)
        found: ast.AST = self.generic_visit(node)
        return found


def constants() -> list[Constant]:
    """Every named number of the rooms, of assignments like `A = 1e-3` and `A, B = 3, 0.5`."""
    found = []
    for room in ROOMS:
        for path in sorted((HERE / "pinn_cli" / room).rglob("*.py")):
            own = named_values(ast.parse(path.read_text(encoding="utf-8")))
            relative = path.relative_to(HERE / "pinn_cli").as_posix()
            found += [Constant(relative, target.id, ast.unparse(value)) for target, value in own]
    return found


def named_values(tree: ast.Module) -> Iterator[tuple[ast.Name, ast.expr]]:
    """Names in capitals at the top of a module, and the arithmetic of numbers that each is."""
    return ((name, value) for name, value in capitals(tree) if _is_number(value))


def capitals(tree: ast.Module) -> Iterator[tuple[ast.Name, ast.expr]]:
    """Names in capitals at the top of a module, and what each is."""
    for statement in tree.body:
        if not isinstance(statement, ast.Assign | ast.AnnAssign) or statement.value is None:
            continue
        value = statement.value
        for target in statement.targets if isinstance(statement, ast.Assign) else [statement.target]:
            pairs = [(target, value)]
            if isinstance(target, ast.Tuple) and isinstance(value, ast.Tuple):
                pairs = list(zip(target.elts, value.elts, strict=True))
            yield from ((name, one) for name, one in pairs if isinstance(name, ast.Name) and name.id.isupper())


def _is_number(value: ast.expr) -> bool:
    allowed = (ast.BinOp, ast.UnaryOp, ast.Constant, ast.operator, ast.unaryop)
    if not all(isinstance(node, allowed) for node in ast.walk(value)):
        return False
    numbers = [node.value for node in ast.walk(value) if isinstance(node, ast.Constant)]
    return all(isinstance(number, int | float) and not isinstance(number, bool) for number in numbers)


class Changed(MetaPathFinder):
    """Reads the module of a change from its source, with the change applied."""

    def __init__(self, change: Change) -> None:
        self.change = change

    def find_spec(self, fullname: str, path: object = None, target: ModuleType | None = None) -> ModuleSpec | None:
        """Of that module alone."""
        if fullname != self.change.constant.module:
            return None
        file = str(HERE / "pinn_cli" / self.change.constant.path)
        return importlib.util.spec_from_file_location(fullname, file, loader=_Loader(fullname, file, self.change))


class _Loader(SourceFileLoader):
    def __init__(self, fullname: str, path: str, change: Change) -> None:
        super().__init__(fullname, path)
        self.change = change

    def get_code(self, fullname: str) -> CodeType:
        text = Path(self.path).read_text(encoding="utf-8")
        return compile(self.change.applied(text), self.path, "exec")


class Calls:
    """Which numbers the functions that are called name, their modules' own and imported ones."""

    def __init__(self, every: Sequence[Constant]) -> None:
        self.known = {(one.module, one.name): one.label for one in every}
        self.seen: set[CodeType] = set()

    def __call__(self, frame: FrameType, event: str, argument: object) -> None:
        """As `sys.setprofile` has it."""
        if event == "call":
            self.seen.add(frame.f_code)

    def read(self) -> set[str]:
        """Labels. A module's own statements are a call of it."""
        found: set[str] = set()
        own = {module.__file__: module.__name__ for module in list(sys.modules.values())
               if getattr(module, "__file__", None) and module.__name__.startswith("pinn_cli")}  # fmt: skip
        names: dict[str, dict[str, str]] = {}
        for code in self.seen:
            module = own.get(code.co_filename)
            if module is None:
                continue
            if module not in names:
                names[module] = self._names(module, code.co_filename)
            loaded = {step.argval for step in dis.get_instructions(code) if step.opname in ("LOAD_GLOBAL", "LOAD_NAME")}
            found |= {names[module][name] for name in loaded if name in names[module]}
        return found

    def _names(self, module: str, file: str) -> dict[str, str]:
        """Local name to label."""
        found = {name: label for (of, name), label in self.known.items() if of == module}
        for node in ast.walk(ast.parse(Path(file).read_text(encoding="utf-8"))):
            if isinstance(node, ast.ImportFrom):
                for alias in node.names:
                    label = self.known.get((node.module or "", alias.name))
                    if label:
                        found[alias.asname or alias.name] = label
        return found


@dataclass(frozen=True)
class Found:
    """What a run is worth and, of one without a change, the labels of the numbers that it has to do with."""

    scored: Scored
    read: frozenset[str]


@dataclass(frozen=True)
class Trial:
    """A case that is run with a change or without one; `seconds` is what it usually takes."""

    family: str
    seed: int
    seconds: float
    change: Change | None = None

    def __call__(self) -> Found:
        """Run it, and before it the run that it begins from, if any."""
        case, read = _drawn(self.family, self.seed), set[str]()
        with TemporaryDirectory() as place:
            folder = Path(place)
            case.write(folder)
            for name in [case.name] if case.before is None else [f"{case.name}_before", case.name]:
                directory = folder / ("runs" if name == case.name else "before") / case.name
                reason = self._run(folder, name, directory)
                told = directory.parent / READ
                read |= set(told.read_text(encoding="utf-8").split()) if told.is_file() else set()
            return Found(scored(case, directory, reason), frozenset(read))

    def _run(self, folder: Path, name: str, directory: Path) -> str:
        """The command, in a process of its own: why it failed, where it did."""
        directory.parent.mkdir(parents=True, exist_ok=True)
        child = os.fork()
        if not child:
            self._command(folder, name, directory)
        _, status = os.waitpid(child, 0)
        return "" if status == 0 else f"ended with {os.waitstatus_to_exitcode(status)}"

    def _command(self, folder: Path, name: str, directory: Path) -> None:
        """Never returns."""
        status = 1
        try:
            nothing = os.open(os.devnull, os.O_RDWR)
            for stream in (0, 1, 2):
                os.dup2(nothing, stream)
            signal.signal(signal.SIGXCPU, signal.SIG_DFL)
            most = int(10 + PATIENCE * self.seconds)
            resource.setrlimit(resource.RLIMIT_CPU, (most, most + 5))
            os.chdir(folder)
            if self.change is not None:
                sys.meta_path.insert(0, Changed(self.change))
            sys.argv = ["pinn-run", "--config-dir", str(folder), f"experiment={name}", f"hydra.run.dir={directory}",
                        "figures=false"]  # fmt: skip
            calls = Calls(constants()) if self.change is None else None
            sys.setprofile(calls)
            try:
                importlib.import_module("pinn_cli.main").main()
                status = 0
            except SystemExit as ended:
                status = ended.code if isinstance(ended.code, int) else 1
            finally:
                sys.setprofile(None)
            if calls is not None:
                (directory.parent / READ).write_text("\n".join(calls.read()), encoding="utf-8")
        finally:
            os._exit(status)


def varied(chosen: Sequence[Constant], cases: Sequence[Trial], most: int) -> Iterator[pd.DataFrame]:
    """Two rows for each constant, of it halved and doubled.

    Columns: constant, value, factor, in how many of the cases functions name it, on how many of these it was tried, how
    many gave anything else, moved a parameter by `A_MOVE` deviations or more or were judged differently, and the most
    that a parameter moved.

    Args:
        chosen: Constants.
        cases: Without a change.
        most: On how many of the cases that have to do with it a constant is tried, until both changes give anything
            else.
    """
    before = dict(zip(cases, _side_by_side(cases), strict=True))
    named = {one: [case for case in cases if one.label in before[case].read] for one in chosen}
    studies = [Study(one, tuple((case, before[case]) for case in few(named[one], most))) for one in chosen]
    for study, rows in zip(studies, _side_by_side(studies), strict=True):
        counts = {"constant": study.constant.label, "value": study.constant.value}
        yield pd.DataFrame([counts | {"factor": f, "named in": len(named[study.constant])} | row for f, row in rows])


@dataclass(frozen=True)
class Study:
    """A constant, and the cases on which it is tried, one after the other, with what they are without a change."""

    constant: Constant
    cases: tuple[tuple[Trial, Found], ...]

    def __call__(self) -> list[tuple[float, Row]]:
        """What each factor does."""
        found: dict[float, list[Found]] = {factor: [] for factor in FACTORS}
        for trial, _ in self.cases:
            for factor in FACTORS:
                found[factor].append(replace(trial, change=Change(self.constant, factor))())
            if all(self._moves(found[factor])["differs"].any() for factor in FACTORS):
                break
        return [(factor, self._row(found[factor])) for factor in FACTORS]

    def _moves(self, found: Sequence[Found]) -> pd.DataFrame:
        return moves(_judged([before for _, before in self.cases[: len(found)]]), _judged(found))

    def _row(self, found: Sequence[Found]) -> Row:
        row: Row = {"tried on": len(found)} | dict.fromkeys(("differ", "moved", "judged differently", "most"), 0)
        if found:
            moved = self._moves(found)
            row |= {"differ": moved["differs"].sum(), "moved": (moved["moved"] > A_MOVE).sum()}
            row |= {"judged differently": moved["judged"].sum(), "most": round(float(moved["moved"].max()), 4)}
        return row


def few(cases: Sequence[Trial], number: int) -> list[Trial]:
    """So many of them: the first one of each family, then the second ones."""
    rank = {case: sum(one.family == case.family for one in cases[:i]) for i, case in enumerate(cases)}
    return sorted(cases, key=rank.__getitem__)[:number]


def _judged(every: Sequence[Found]) -> Judged:
    scores = [one.scored for one in every]
    parameters = [one.parameters.assign(case=one.row["case"]) for one in scores]
    return Judged(pd.DataFrame([one.row for one in scores]), pd.concat(parameters, ignore_index=True))


def _side_by_side(tasks: Sequence[Callable[[], R]]) -> Iterator[R]:
    """What they find, in their order."""
    with ProcessPoolExecutor(os.cpu_count(), mp_context=get_context("spawn"), initializer=_prepared) as pool:
        yield from pool.map(call, tasks)


@cache
def _drawn(family: str, seed: int) -> Case:
    return drawn(family, seed)


def _prepared() -> None:
    """Import what takes long, and nothing of the program: each run has numbers of its own."""
    for name in ELSEWHERE:
        importlib.import_module(name)
    assert not any(name == "pinn_cli" or name.startswith("pinn_cli.") for name in sys.modules)
