"""MAT files of versions 5 to 7. SciPy's reader ends the process by a segmentation fault where some bytes are wrong.

The layout is that of "MAT-File Format", The MathWorks, 2019: after a header of 128 bytes, elements of a type, a size in
bytes and data that fill eights of bytes. An array is an element of elements: flags, sides, name, and what it holds.
"""

from __future__ import annotations

import math
import struct
import zlib
from collections.abc import Container, Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from pinn_cli.record.files.arrays import Variable, as_float
from pinn_cli.record.files.on_disk import check_size

HEADER = 128
# How deep structures may lie in structures, and sides of an array.
_DEEPEST, _MOST_SIDES = 20, 32
# Of a packed variable, bytes that hold its name.
_START = 4096
# Types of elements, and of numbers as numpy writes them.
_MATRIX, _PACKED = 14, 15
_NUMBERS = {1: "i1", 2: "u1", 3: "i2", 4: "u2", 5: "i4", 6: "u4", 7: "f4", 9: "f8", 12: "i8", 13: "u8"}
# Classes of arrays.
_STRUCTURE, _OBJECT, _OPAQUE, _NUMERIC = 2, 3, 17, range(6, 16)
_OTHERS = {1: "cells", _OBJECT: "an object", 4: "text", 5: "a sparse matrix", 16: "a function", _OPAQUE: "an object"}
_COMPLEX = 0x0800


@dataclass(frozen=True)
class _Element:
    kind: int
    data: memoryview


@dataclass(frozen=True)
class _Array:
    """An array's head, and the elements after it."""

    kind: int
    is_complex: bool
    shape: tuple[int, ...]
    name: str
    content: Iterator[_Element]


def variables_of(path: Path, content: bytes, wanted: Container[str] | None) -> dict[str, Variable]:
    """Every variable, and every field of those that are structures, by name.

    Args:
        path: Of the file, for errors.
        content: All of it.
        wanted: Names of the variables that are unpacked; None: all.

    Raises:
        InputError: It unpacks to more than memory holds.
        ValueError: It is damaged or cut off.
    """
    order = "<" if content[126:128] == b"IM" else ">"
    found: dict[str, Variable] = {}
    for element in _elements(memoryview(content)[HEADER:], order):
        head = _array(_started(element, order), order)
        # One without a name belongs to MATLAB's objects.
        if head is not None and head.name and (wanted is None or head.name in wanted):
            array = _array(_unpacked(path, element, order), order)
            assert array is not None
            found.update(_flattened(array.name, array, order, 0))
    return found


def names_of(content: bytes) -> list[str]:
    """Of every variable.

    Raises:
        ValueError: The file is damaged or cut off.
    """
    order = "<" if content[126:128] == b"IM" else ">"
    heads = (_array(_started(element, order), order) for element in _elements(memoryview(content)[HEADER:], order))
    return [head.name for head in heads if head is not None and head.name]


def _elements(data: memoryview, order: str) -> Iterator[_Element]:
    """One after the other."""
    place = 0
    while place + 8 <= len(data):
        kind, size = struct.unpack_from(f"{order}II", data, place)
        if kind >> 16:  # a small one: its size and data stand in the same eight bytes
            kind, size, start, end = kind & 0xFFFF, kind >> 16, place + 4, place + 8
            if size > 4:
                raise ValueError(f"a small element of {size} bytes")
        else:
            start = place + 8
            end = start + (size if kind == _PACKED else 8 * math.ceil(size / 8))
        if start + size > len(data):
            raise ValueError("an element ends beyond the file")
        yield _Element(kind, data[start : start + size])
        place = end
    if any(data[place:]):
        raise ValueError("bytes are left at the end")


def _started(element: _Element, order: str) -> _Element:
    """The beginning of an element that may be packed, with its name."""
    if element.kind != _PACKED:
        return element
    try:
        start = zlib.decompressobj().decompress(element.data, _START)
    except zlib.error as error:
        raise ValueError(str(error)) from None
    return _within(start, order)


def _unpacked(path: Path, element: _Element, order: str) -> _Element:
    if element.kind != _PACKED:
        return element
    try:
        unpacking = zlib.decompressobj()
        start = unpacking.decompress(element.data, 8)
        size = 8 + int(struct.unpack(f"{order}II", start)[1])
        check_size(path, size)
        whole = start + unpacking.decompress(unpacking.unconsumed_tail, size)
        unpacking.decompress(unpacking.unconsumed_tail, 8)  # the checksum
    except (zlib.error, struct.error) as error:
        raise ValueError(str(error)) from None
    if len(whole) != size or not unpacking.eof:
        raise ValueError("a packed variable is cut off")
    return _within(whole, order)


def _within(packed: bytes, order: str) -> _Element:
    if len(packed) < 8:
        raise ValueError("a packed variable without content")
    return _Element(struct.unpack_from(f"{order}I", packed)[0], memoryview(packed)[8:])


def _array(element: _Element, order: str) -> _Array | None:
    """Head of an array; None of another element."""
    if element.kind != _MATRIX:
        return None
    if not element.data:
        return _Array(6, False, (0, 0), "", iter(()))
    parts = _elements(element.data, order)
    flags = _integers(next(parts), order)
    if not len(flags):
        raise ValueError("an array without flags")
    kind = int(flags[0]) & 0xFF
    shape = () if kind == _OPAQUE else tuple(map(int, _integers(next(parts), order)))
    if len(shape) > _MOST_SIDES or any(side < 0 for side in shape):
        raise ValueError("an array of impossible sides")
    name = bytes(next(parts).data).decode("utf-8", "replace")
    return _Array(kind, bool(int(flags[0]) & _COMPLEX), shape, name, parts)


def _flattened(name: str, array: _Array, order: str, depth: int) -> Iterator[tuple[str, Variable]]:
    """A variable, or the fields of a structure; what holds no numbers stays, so that an error can say what it is."""
    if array.kind == _STRUCTURE and depth <= _DEEPEST:
        yield from _fields(name, array, order, depth)
        return
    content = _OTHERS.get(array.kind, "" if array.kind in _NUMERIC else "structures")
    if content or array.is_complex:
        yield name, Variable(array.shape, lambda: np.empty(0), content or "complex numbers")
        return
    yield name, _numeric(array, next(array.content, None), order)


def _numeric(array: _Array, element: _Element | None, order: str) -> Variable:
    if math.prod(array.shape) == 0:
        return Variable(array.shape, lambda: np.empty(array.shape))
    if element is None:
        return Variable(array.shape, lambda: np.empty(0), "what was not read")
    numbers = _integers(element, order)
    if len(numbers) != math.prod(array.shape):
        raise ValueError(f"{len(numbers)} numbers for an array of {math.prod(array.shape)}")
    return Variable(array.shape, lambda: as_float(numbers).reshape(array.shape, order="F"))


def _fields(name: str, array: _Array, order: str, depth: int) -> Iterator[tuple[str, Variable]]:
    length = _integers(next(array.content), order)
    names = bytes(next(array.content).data)
    if not len(length) or length[0] <= 0:
        raise ValueError("a structure without names of fields")
    step = int(length[0])
    fields = [
        names[i : i + step].split(b"\0")[0].decode("utf-8", "replace") for i in range(0, len(names), step)
    ]  # fmt: skip
    count = math.prod(array.shape)
    for number in range(1, count + 1):
        prefix = name if count == 1 else f"{name}.{number}"
        for field in fields:
            value = _array(next(array.content), order)
            if value is None:
                raise ValueError("a field that is no array")
            yield from _flattened(f"{prefix}.{field}", value, order, depth + 1)


def _integers(element: _Element, order: str) -> np.ndarray:
    """The numbers of an element of numbers."""
    if element.kind not in _NUMBERS:
        raise ValueError(f"an element of type {element.kind} where numbers belong")
    dtype = np.dtype(f"{order}{_NUMBERS[element.kind]}")
    if len(element.data) % dtype.itemsize:
        raise ValueError("an element that ends within a number")
    return np.frombuffer(element.data, dtype)
