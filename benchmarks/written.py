"""Measured tables of README.md and docs/: each stands between two comments, with the command that makes it.

    <!-- measured: seeds; make seeds; revision e016f52; 2026-10-03; digest 0123456789ab -->
    ...
    <!-- end of seeds -->

The revision is the last one that changed the program. A `+` after it: there were changes beside it. `no command` stands
where no target of the Makefile makes the table. The digest is of all else: `checked` sees what was edited by hand.
A new table begins with `<!-- measured: NAME -->` and `<!-- end of NAME -->`, and nothing between them.
"""

from __future__ import annotations

import datetime
import hashlib
import re
import subprocess
from dataclasses import dataclass
from pathlib import Path

import pandas as pd

ROOT = Path(__file__).parents[1]
PROGRAM = ("pinn_cli", "conf", "hydra_plugins")  # what a table is measured on
BLOCK = re.compile(
    r"^<!-- measured: (?P<name>[\w-]+)(?:; (?P<command>[^;\n]+); revision (?P<revision>\w+\+?); (?P<date>[\d-]+);"
    r" digest (?P<digest>\w+))? -->\n(?P<text>.*?)^<!-- end of (?P=name) -->$",
    re.MULTILINE | re.DOTALL,
)
TABLE = re.compile(r"^\|.*\n\|[ :|-]+\|\n((?:\|.*\n)+)", re.MULTILINE)
NUMBER = re.compile(r"[-−+±<~]? ?\d")


@dataclass(frozen=True)
class Block:
    """A measured table: of which name, made by which command on which revision, when; its text and its digest."""

    name: str
    command: str
    revision: str
    date: str
    text: str
    digest: str = ""

    @property
    def true_digest(self) -> str:
        """Of all but the digest."""
        whole = "\n".join((self.name, self.command, self.revision, self.date, self.text.strip()))
        return hashlib.sha256(whole.encode()).hexdigest()[:12]

    def __str__(self) -> str:
        """With its two comments."""
        head = f"{self.name}; {self.command}; revision {self.revision}; {self.date}; digest {self.true_digest}"
        return f"<!-- measured: {head} -->\n{self.text.strip()}\n\n<!-- end of {self.name} -->"


def blocks(page: Path) -> list[Block]:
    """Those of a page, in order; what a comment does not say is empty."""
    found = BLOCK.finditer(page.read_text(encoding="utf-8"))
    return [Block(**{name: of or "" for name, of in each.groupdict().items()}) for each in found]


def checked(page: Path) -> list[str]:
    """Names of the blocks of a page whose digest does not fit: somebody edited them."""
    return [block.name for block in blocks(page) if block.digest != block.true_digest]


def outside(page: Path) -> list[str]:
    """Tables of a page with numbers in more than half of their cells that lie in no block: their first rows."""
    return [
        table[1].partition("\n")[0]
        for table in TABLE.finditer(BLOCK.sub("", page.read_text(encoding="utf-8")))
        if 2 * sum(bool(NUMBER.match(cell)) for cell in _cells(table[1])) > len(_cells(table[1]))
    ]


def _cells(rows: str) -> list[str]:
    return [cell.strip(" *`") for row in rows.splitlines() for cell in row.strip("|").split("|")]


def write(page: Path, name: str, text: str, command: str) -> None:
    """Replace a block of a page.

    Args:
        page: Of README.md and docs/.
        name: Of the block, which the page must have.
        text: Markdown, what stands between the comments.
        command: That made it: `make bench`.

    Raises:
        LookupError: The page has no such block, or two.
    """
    old, today = page.read_text(encoding="utf-8"), datetime.datetime.now(datetime.UTC).date().isoformat()
    places = [each.span() for each in BLOCK.finditer(old) if each["name"] == name]
    if len(places) != 1:
        message = f"{page} has {len(places)} blocks {name!r}, not one: write <!-- measured: {name} -->"
        raise LookupError(f"{message} and <!-- end of {name} --> where it belongs")
    (first, last), new = places[0], Block(name, command, program_revision(), today, text)
    page.write_text(f"{old[:first]}{new}{old[last:]}", encoding="utf-8")
    print(f"{page}: {name}")


def program_revision() -> str:
    """The last revision that changed the program, with `+` where files of it differ; `unknown` without git."""

    def git(*arguments: str) -> str:
        called = ["git", "-C", str(ROOT), *arguments, "--", *PROGRAM]
        return subprocess.run(called, capture_output=True, text=True, check=False).stdout.strip()

    return (git("log", "-1", "--abbrev=7", "--format=%h") or "unknown") + ("+" if git("status", "--porcelain") else "")


def markdown(table: pd.DataFrame) -> str:
    """A table as Markdown has it; columns are texts as they shall be read."""
    rows = [list(table.columns), ["---"] * len(table.columns), *table.to_numpy().tolist()]
    return "\n".join(f"| {' | '.join(str(cell) for cell in row)} |" for row in rows)
