"""The text of a file of numbers: what is no text is refused before anyone looks for numbers in it."""

from __future__ import annotations

import codecs
import gzip
import zlib
from io import BytesIO
from pathlib import Path

from pinn_cli.record.files.on_disk import BEGINNINGS, check_size, read_bytes
from pinn_cli.settings.errors import InputError

_MARKS = {codecs.BOM_UTF8: "utf-8-sig", codecs.BOM_UTF16_LE: "utf-16", codecs.BOM_UTF16_BE: "utf-16"}
# Of text that is no UTF-8: what Windows writes in Western Europe and America. The numbers are the same in any of them.
FALLBACK = "cp1252"
_SAVE_AS = "save it as text with separated values, in UTF-8"
_CHUNK = 2**20


def read_text(path: Path, setting: str = "data.path", encoding: str | None = None) -> str:
    """The text of a file, without a byte order mark; one that is packed by gzip is unpacked.

    Args:
        path: Of the file.
        setting: That named it, for errors.
        encoding: As Python calls it; None: by the byte order mark, else UTF-8, else `FALLBACK`.

    Raises:
        InputError: It is missing, is no regular file, cannot be read or held, or is no text.
    """
    content = read_bytes(path, setting)
    if content.startswith(b"\x1f\x8b"):
        content = _unpacked(path, content, setting)
    kind = next((kind for start, kind in BEGINNINGS.items() if content.startswith(start)), "")
    if kind and kind != BEGINNINGS[b"    -1"]:
        raise InputError(setting, path, "a text file", f"it is {kind}: unpack it, or {_SAVE_AS}")
    if path.suffix.lower() in (".zip", ".bz2", ".xz", ".zst"):
        raise InputError(setting, path, "a text file", f"unpack it, and {_SAVE_AS}")
    given = encoding or next((name for mark, name in _MARKS.items() if content.startswith(mark)), None)
    if given is None and (place := content.find(b"\0")) >= 0:
        hint = f"it is a binary file, or UTF-16 without a mark: {_SAVE_AS}"
        raise InputError(_line(path, content, place), "byte 0x00", "text", hint)
    try:
        return content.decode(given or "utf-8")
    except (UnicodeError, LookupError, ValueError) as error:
        if given is None:
            return read_text(path, setting, FALLBACK)
        start = error.start if isinstance(error, UnicodeDecodeError) else 0
        hint = f"the file is in another encoding, or no text: give data.format.encoding, or {_SAVE_AS}"
        byte = f"byte 0x{content[start]:02x}" if content else "nothing"
        raise InputError(_line(path, content, start), byte, f"text in {given}", hint) from None


def check_encoding(setting: str, encoding: str | None) -> None:
    """Refuse the name of an encoding that there is not.

    Raises:
        InputError: Naming the setting.
    """
    try:
        known = encoding is None or "\0" not in b"0".decode(encoding)
    except (LookupError, TypeError, UnicodeError, ValueError):
        known = encoding in ("utf-16", "utf-32")  # one byte is too few for them
    if not known:
        raise InputError(setting, encoding, "null or an encoding of text, such as utf-8, cp1252 or utf-16")


def _line(path: Path, content: bytes, place: int) -> str:
    number = content.count(b"\n", 0, place) + 1
    return f"{path.name}, line {number}"


def _unpacked(path: Path, content: bytes, setting: str) -> bytes:
    """What gzip has packed, which may be no more than any file."""
    parts, size = [], 0
    try:
        with gzip.GzipFile(fileobj=BytesIO(content)) as packed:
            while part := packed.read(_CHUNK):
                parts.append(part)
                check_size(path, size := size + len(part), setting)
    except (EOFError, zlib.error, gzip.BadGzipFile) as error:
        raise InputError(setting, path, "a gzip file that is whole", f"damaged or cut off? {error}") from None
    return b"".join(parts)
