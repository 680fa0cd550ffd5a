"""The rooms of the house: imports point downwards, and no two files import each other."""

import ast
from collections import defaultdict
from functools import cache
from pathlib import Path

from benchmarks.trust.constants import capitals

PACKAGE = Path(__file__).parents[1] / "pinn_cli"
# From the ground up. A room may import those before it, and itself. Three pages that lie in no room stand among them.
ROOMS = (
    "settings", "runs", "system", "record", "model", "network", "scheme", "physics", "training", "baseline",
    "posterior", "validation", "verdict", "report", "inspection", "sweep", "cli", "paper", "main", "__main__", "api",
)  # fmt: skip


def module_name(file):
    return ".".join((PACKAGE.name, *file.relative_to(PACKAGE).with_suffix("").parts)).removesuffix(".__init__")


FILES = {module_name(file): file for file in PACKAGE.rglob("*.py")}


@cache
def tree(module):
    return ast.parse(FILES[module].read_text(encoding="utf-8"))


@cache
def imports(module):
    """Modules of the package that a module imports, those for its annotations and those within functions included."""
    modules = set()
    for node in ast.walk(tree(module)):
        if isinstance(node, ast.Import):
            found = [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom) and node.module:
            found = [f"{node.module}.{alias.name}" for alias in node.names]
        else:
            continue
        for name in found:
            for known in (name, name.rpartition(".")[0]):
                if known in FILES:
                    modules.add(known)
                    break
    return modules


def room(module):
    return module.split(".")[1] if "." in module else None


def test_every_file_lies_in_a_room():
    assert {room(module) for module in FILES} - {None} == set(ROOMS)


def test_imports_point_downwards():
    upwards = [
        f"{module} -> {other}"
        for module in FILES
        for other in imports(module)
        if room(module) and room(other) and ROOMS.index(room(other)) > ROOMS.index(room(module))
    ]
    assert upwards == []


def test_nothing_imports_the_paper():
    assert [module for module in FILES for other in imports(module) if room(other) == "paper" != room(module)] == []


def test_no_files_import_each_other_in_a_circle():
    # A package's page that lists what is in it is no part of a circle.
    arrows = {m: {o for o in imports(m) if FILES[o].name != "__init__.py"} for m in FILES}
    while leaves := [module for module, others in arrows.items() if not others & arrows.keys()]:
        for leaf in leaves:
            del arrows[leaf]
    assert sorted(arrows) == []


def test_a_name_in_capitals_has_one_value():
    values = defaultdict(set)
    for module in FILES:
        for name, value in capitals(tree(module)):
            if "TypeVar" not in ast.unparse(value):
                values[name.id].add(ast.unparse(value))
    assert {name for name, own in values.items() if len(own) > 1} == set()
