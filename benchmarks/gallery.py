"""The figures of docs/gallery/ and of docs/measured-record.md drawn anew by the pages' commands: ``make gallery``.

A figure ``figures/<page>-<figure>.png`` is ``figures/<figure>.png`` of the run of the page's last command. What pages
quote of a run's output is written by hand; tests/docs/test_gallery.py compares it.
"""

from __future__ import annotations

import argparse
import re
import shlex
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

from PIL import Image

DOCS = Path(__file__).parents[1] / "docs"
GALLERY = DOCS / "gallery"
RECORDS = DOCS / "records"
# Enough for lines and bands, and a third of the bytes.
COLOURS, WIDEST = 128, 1600


def pages() -> list[Path]:
    """Every example, by name; index.md lists them."""
    return [page for page in sorted(GALLERY.glob("*.md")) if page.stem != "index"]


def all_pages() -> list[Path]:
    """The examples, and the tutorial that is made in the same way."""
    return [*pages(), DOCS / "measured-record.md"]


def commands(page: Path) -> list[list[str]]:
    """The commands of a page, as the shell would give them, without ``pinn-run``."""
    blocks = re.findall(r"^```\n(pinn-run .*?)^```", page.read_text(encoding="utf-8"), re.MULTILINE | re.DOTALL)
    return [shlex.split(block.replace("\\\n", " "))[1:] for block in blocks]


def quoted_output(page: Path) -> list[str]:
    """The lines that a page quotes of what its command prints."""
    blocks = re.findall(r"^```text\n(.*?)^```", page.read_text(encoding="utf-8"), re.MULTILINE | re.DOTALL)
    return [line for block in blocks for line in block.splitlines() if line.strip()]


def figures(page: Path) -> dict[Path, str]:
    """The page's figures: file, and what a run calls it."""
    names = re.findall(r"\]\((?:gallery/)?(figures/[\w-]+\.png)\)", page.read_text(encoding="utf-8"))
    return {GALLERY / name: name.removeprefix(f"figures/{page.stem}-") for name in names}


def performed(page: Path, place: Path) -> tuple[str, Path]:
    """What the page's commands print in a folder with the records, and the directory of the last one's run.

    Raises:
        subprocess.CalledProcessError: A command failed.
    """
    for record in RECORDS.glob("*.csv"):
        shutil.copy(record, place)
    printed = ""
    for command in commands(page):
        called = [sys.executable, "-c", "from pinn_cli.main import main; main()", *command]
        printed += subprocess.run(called, cwd=place, stdout=subprocess.PIPE, text=True, check=True).stdout
    return printed, place / printed.splitlines()[-1]


def copied(drawn: Path, file: Path) -> None:
    """A figure of a run, in few colours and no wider than a page shows."""
    image = Image.open(drawn).convert("RGB")
    if image.width > WIDEST:
        image = image.resize((WIDEST, round(image.height * WIDEST / image.width)), Image.Resampling.LANCZOS)
    file.parent.mkdir(exist_ok=True)
    image.quantize(COLOURS, dither=Image.Dither.NONE).save(file, optimize=True)


def main() -> None:
    """Run the pages that are named, or all."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("names", nargs="*", help="pages, such as earthquake; default: all")
    names = parser.parse_args().names
    for page in all_pages():
        if not names or page.stem in names:
            with tempfile.TemporaryDirectory() as place:
                printed, directory = performed(page, Path(place))
                for file, drawn in figures(page).items():
                    copied(directory / "figures" / drawn, file)
            print(f"{page.stem}\n{printed}", flush=True)


if __name__ == "__main__":
    main()
