"""What lies in a directory comes in by one door: regular files, of a possible size, of the right types."""

import json
import os
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal, TypedDict

import numpy as np
import pytest

from pinn_cli.runs import reading
from pinn_cli.runs.histories import read_histories
from pinn_cli.runs.reading import (
    MOST_BYTES,
    DamagedError,
    checked,
    printable,
    read_arrays,
    read_json,
    read_table,
    small_text,
    undamaged,
)  # fmt: skip
from pinn_cli.settings.errors import InputError


@dataclass(frozen=True)
class Named:
    name: str
    size: float
    whole: bool = True


class Open(TypedDict, total=False):
    word: Literal["sound", "failed"]
    seconds: dict[str, float | None]
    pair: tuple[str, float | None]
    reasons: list[str]
    one: Named


@pytest.mark.parametrize(
    ("content", "reason"),
    [
        ({"name": 5, "size": 1.0}, "name is a whole number, not text"),
        ({"name": "a", "size": "1"}, "size is text, not a number"),
        ({"name": "a", "size": True}, "size is true or false, not a number"),
        ({"name": "a", "size": 10**400}, "size is beyond any number"),
        ({"name": "a", "size": float("nan")}, "size is beyond any number"),
        ({"name": "a", "size": 1, "whole": 1}, "whole is a whole number, not true or false"),
        ({"name": "a"}, "size is missing"),
        ([], "its content is a list, not settings"),
        (None, "its content is null, not settings"),
    ],
)
def test_a_dataclass_is_read_or_says_what_is_wrong(tmp_path: Path, content: Any, reason: str) -> None:
    file = tmp_path / "named.json"
    file.write_text(json.dumps({"name": "a", "size": 2, "other": [None]}))
    assert read_json(file, Named) == Named("a", 2.0)
    file.write_text(json.dumps(content))
    with pytest.raises(DamagedError, match=f"^named.json cannot be read: {reason}$"):
        read_json(file, Named)


@pytest.mark.parametrize(
    ("content", "place"),
    [
        ({"word": "fine"}, "word"),
        ({"word": ["sound"]}, "word"),
        ({"seconds": {"total": []}}, "seconds.total"),
        ({"seconds": [1.0]}, "seconds"),
        ({"pair": ["a"]}, "pair"),
        ({"pair": ["a", "b"]}, r"pair\[1\]"),
        ({"reasons": ["a", None]}, r"reasons\[1\]"),
        ({"one": {"name": "a"}}, "one.size"),
    ],
)
def test_a_place_within_is_named(content: Any, place: str) -> None:
    right = {"word": "sound", "seconds": {"total": None}, "pair": ["a", 1], "reasons": [], "more": [{"x": 1}]}
    assert checked(right, Open) == right
    with pytest.raises(ValueError, match=f"^{place} "):
        checked(content, Open)


def test_texts_come_in_as_they_can_be_printed(tmp_path: Path) -> None:
    escape = "\x1b[2J\u202e"
    read = checked({"reasons": [escape], "more": {escape: [escape]}}, Open)
    assert read == {"reasons": ["\\x1b[2J\\u202e"], "more": {"\\x1b[2J\\u202e": ["\\x1b[2J\\u202e"]}}
    assert printable("a\tb\nä") == "a\tb\nä"
    file = tmp_path / "x.json"
    file.write_text(escape)
    with pytest.raises(DamagedError) as refused:
        read_json(file, Open)
    assert str(refused.value).isprintable()


@pytest.mark.parametrize("text", ["[" * 100_000, '{"a":' * 100_000, "{", "", "NaN", "\x00"])
def test_json_that_is_none_of_ours(tmp_path: Path, text: str) -> None:
    (tmp_path / "x.json").write_text(text)
    with pytest.raises(DamagedError, match=r"^x\.json cannot be read: "):
        read_json(tmp_path / "x.json", Open)


def test_only_regular_files_of_a_possible_size_are_opened(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe")
    (tmp_path / "zero").symlink_to("/dev/zero")
    (tmp_path / "folder").mkdir()
    with (tmp_path / "huge").open("wb") as file:
        file.truncate(MOST_BYTES + 1)
    for name in ("pipe", "zero", "folder", "huge"):
        with pytest.raises(OSError, match=f"^{name} is no (regular|small) file$"):
            small_text(tmp_path / name)
        with pytest.raises(DamagedError):
            read_json(tmp_path / name, Open)
    for name in ("pipe", "zero", "folder"):
        for read in (read_table, read_histories):
            with pytest.raises(DamagedError):
                read(tmp_path / name)
    for read in (small_text, read_table, lambda file: read_json(file, Open)):
        with pytest.raises(FileNotFoundError):
            read(tmp_path / "nowhere")


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        ("a,b\n1,x\n", "column b holds other things than numbers"),
        ("a\n1\n", "it has no column b"),
        ("", "No columns to parse"),
        ('"', "Error tokenizing"),
        ("," * 200_000, "more than 100000 columns"),
    ],
)
def test_a_table_has_its_columns_of_numbers(tmp_path: Path, text: str, reason: str) -> None:
    file = tmp_path / "x.csv"
    file.write_text("a,b\nx,\ny,1.5\n")
    assert read_table(file, ["b"], ["a"])["b"].sum() == 1.5
    file.write_text(text)
    with pytest.raises(DamagedError, match=reason):
        read_table(file, ["b"], ["a"])


def test_arrays_are_numbers_and_no_more_than_any_of_ours(tmp_path: Path, monkeypatch) -> None:
    file = tmp_path / "x.npz"
    np.savez_compressed(file, zeros=np.zeros(10**5), word=np.array("a"))
    assert read_arrays(file)["zeros"].shape == (10**5,)
    monkeypatch.setattr(reading, "MOST_UNFOLDED", 10**5)
    with pytest.raises(DamagedError, match="larger than any of ours"):
        read_arrays(file)
    np.savez(file, things=np.array([object()]))
    with pytest.raises(DamagedError, match="allow_pickle"):
        read_arrays(file)


def test_what_does_not_fit_together_is_told_as_input() -> None:
    with (
        pytest.raises(InputError, match=r"^model=run: must be .*KeyError: 'training'$"),
        undamaged("model", Path("run")),
    ):
        raise KeyError("training")
    with pytest.raises(InputError, match="^seed=1"), undamaged("model", Path("run")):
        raise InputError("seed", 1, "0")
