"""Which program is judged: this checkout, another revision of it, or this one with a constant changed."""

from __future__ import annotations

import ast
import hashlib
import shutil
import subprocess
from dataclasses import dataclass
from pathlib import Path

HERE = Path(__file__).parents[2]
JUDGED = ("pinn_cli", "conf", "hydra_plugins")  # what a run consists of
ROOMS = ("scheme", "training", "verdict")  # whose constants are varied


@dataclass(frozen=True)
class Constant:
    """A named number at the top of a module: `path` relative to `pinn_cli`, as it is written."""

    path: str
    name: str
    value: str

    @property
    def label(self) -> str:
        """How it is asked for: `training/band/beginning.TIE`."""
        return f"{self.path.removesuffix('.py')}.{self.name}"


def revision() -> str:
    """Of this checkout, `-dirty` if files differ from it."""
    done = subprocess.run(
        ["git", "describe", "--always", "--dirty", "--exclude=*"], cwd=HERE, capture_output=True, text=True, check=False
    )
    return done.stdout.strip() or "unknown"


def digest(source: Path) -> str:
    """Of everything that decides a row: the program that is judged, and the cases."""
    found = hashlib.sha256()
    paths = [path for name in JUDGED for path in (source / name).rglob("*") if path.suffix in (".py", ".yaml")]
    for path in sorted(paths) + sorted((HERE / "benchmarks" / "trust").rglob("*.py")):
        found.update(
            str(path.relative_to(source if path.is_relative_to(source) else HERE)).encode() + path.read_bytes()
        )
    return found.hexdigest()[:12]


def of_revision(name: str, trees: Path) -> Path:
    """A revision's files, below `trees`."""
    commit = subprocess.run(
        ["git", "rev-parse", "--verify", f"{name}^{{commit}}"], cwd=HERE, capture_output=True, text=True, check=True
    ).stdout.strip()
    tree = trees / commit[:12]
    if not tree.is_dir():
        beside = trees / f".{commit[:12]}"
        shutil.rmtree(beside, ignore_errors=True)
        beside.mkdir(parents=True)
        archive = subprocess.run(["git", "archive", commit], cwd=HERE, capture_output=True, check=True).stdout
        subprocess.run(["tar", "-x", "-C", str(beside)], input=archive, check=True)
        _link_conf(beside)
        beside.rename(tree)
    return tree


def of_constant(constant: Constant, factor: float, trees: Path) -> Path:
    """This checkout with a constant multiplied, below `trees`."""
    tree = trees / f"{constant.label.replace('/', '-')}_{factor:g}"
    shutil.rmtree(tree, ignore_errors=True)
    for name in JUDGED:
        if (HERE / name).is_dir():
            shutil.copytree(HERE / name, tree / name, symlinks=True, ignore=shutil.ignore_patterns("__pycache__"))
    _link_conf(tree)
    path = tree / "pinn_cli" / constant.path
    text = path.read_text(encoding="utf-8")
    changed = f"type({constant.value})(({constant.value}) * {factor:g})"
    path.write_text(_assigned(text, constant.name, changed), encoding="utf-8")
    return tree


def _link_conf(tree: Path) -> None:
    link = tree / "pinn_cli" / "conf"
    if not link.exists() and not link.is_symlink():
        link.symlink_to("../conf")


def constants() -> list[Constant]:
    """Every named number of the rooms whose thresholds decide results."""
    found = []
    for room in ROOMS:
        for path in sorted((HERE / "pinn_cli" / room).rglob("*.py")):
            for statement in ast.parse(path.read_text(encoding="utf-8")).body:
                named = _named_number(statement)
                if named:
                    found.append(Constant(str(path.relative_to(HERE / "pinn_cli")), *named))
    return found


def _named_number(statement: ast.stmt) -> tuple[str, str] | None:
    """Name and expression of `NAME = 3 * 1e-4`, numbers and arithmetic alone; None for everything else."""
    if isinstance(statement, ast.Assign) and len(statement.targets) == 1:
        target, value = statement.targets[0], statement.value
    elif isinstance(statement, ast.AnnAssign) and statement.value is not None:
        target, value = statement.target, statement.value
    else:
        return None
    if not isinstance(target, ast.Name) or (not target.id.isupper() and not target.id.lstrip("_").isupper()):
        return None
    allowed = (ast.BinOp, ast.UnaryOp, ast.Constant, ast.operator, ast.unaryop)
    if not all(isinstance(node, allowed) for node in ast.walk(value)):
        return None
    numbers = [node.value for node in ast.walk(value) if isinstance(node, ast.Constant)]
    if not all(isinstance(number, int | float) and not isinstance(number, bool) for number in numbers):
        return None
    return target.id, ast.unparse(value)


def _assigned(text: str, name: str, value: str) -> str:
    """A module's text with another value of a constant."""
    lines = text.splitlines(keepends=True)
    for statement in ast.parse(text).body:
        named = _named_number(statement)
        if named and named[0] == name:
            assert statement.end_lineno is not None
            lines[statement.lineno - 1 : statement.end_lineno] = [f"{name} = {value}\n"]
            return "".join(lines)
    raise ValueError(f"there is no number {name}")
