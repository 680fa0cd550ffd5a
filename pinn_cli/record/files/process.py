"""A file read in a process of its own, with limits on memory and time: what the file does there, it does there alone.

The process is a new Python, no fork of this one, which may have threads. It is asked in JSON, and answers with a line
of JSON and the numbers' bytes: nothing that comes back is executed.
"""

from __future__ import annotations

import json
import math
import os
import subprocess
import sys
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import astuple
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np

from pinn_cli.record.files.on_disk import check_size, damaged
from pinn_cli.record.files.table import SensorHint, Table
from pinn_cli.record.files.variables import tables_of
from pinn_cli.runs.memory import of_this_machine
from pinn_cli.settings.errors import InputError

# Bytes that libraries map before they read anything, three times those of pyarrow; and of the memory, the part that a
# file may take beyond them: its content, its numbers as stored, as float64 and on their way, a sixteenth each at most.
_LIBRARIES, _PART_OF_MEMORY = 2**30, 4
# Seconds that any file may take, and bytes that are read in each further one: pyuff, the slowest, reads 18 million.
_SECONDS, _BYTES_A_SECOND = 60.0, 2**19


def read_apart(own: object, path: Path, expected: str, wanted: Mapping[str, str] | None) -> list[Table]:
    """The tables of a file, one for each clock.

    Args:
        own: The file's format, whose ``variables`` is called in the other process.
        path: Of the file.
        expected: What the file should be, for errors.
        wanted: Setting to name of a column; None: all.

    Raises:
        InputError: The file is damaged, lacks a column, or takes more memory or time than a file may.
    """
    kind, memory = type(own), _LIBRARIES + of_this_machine() // _PART_OF_MEMORY
    question = [kind.__module__, kind.__qualname__, vars(own), str(path), wanted if wanted is None else dict(wanted)]
    # One thread is what a reader needs; each further one of a library for linear algebra maps memory.
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(map(str, sys.path)), "OPENBLAS_NUM_THREADS": "1"}
    limit_s = int(_SECONDS + path.stat().st_size / _BYTES_A_SECOND)
    command = [sys.executable, "-P", "-c", f"from {__name__} import answer; answer({memory}, {limit_s})"]
    head: Any
    try:
        done = subprocess.run(
            command, input=json.dumps(question).encode(), stdout=subprocess.PIPE, stderr=subprocess.DEVNULL,
            env=environment, timeout=limit_s, check=True, start_new_session=True,  # Ctrl-C is for the one that asks
        )  # fmt: skip
        length = done.stdout.index(b"\n") + 1
        head = json.loads(done.stdout[:length])
    except subprocess.TimeoutExpired:
        head = {"damaged": f"it takes more than {limit_s} s to read"}
    except (subprocess.CalledProcessError, ValueError):
        head = {"damaged": "its reader crashes"}
    if "refused" in head:
        raise InputError.read(head["refused"])
    if "memory" in head:
        check_size(path, math.inf)
    if "damaged" in head:
        raise damaged(path, expected, head["damaged"])
    return _tables(path, head["tables"], memoryview(done.stdout)[length:])


def answer(memory: int, limit_s: int) -> None:
    """What the other process does: read a question and answer it, within so many bytes of memory and seconds."""
    with suppress(ImportError, ValueError, OSError):  # systems without such limits, or with lower ones
        import resource

        resource.setrlimit(resource.RLIMIT_CPU, (limit_s, limit_s))  # the one that asks may be gone by then
        resource.setrlimit(resource.RLIMIT_AS, (memory, memory))
    out = os.fdopen(os.dup(1), "wb")
    os.dup2(2, 1)  # what libraries print is no answer
    module, name, settings, path, wanted = json.load(sys.stdin)
    head: Any
    tables: list[Table] = []
    try:
        own = object.__new__(getattr(import_module(module), name))
        vars(own).update(settings)
        variables = own.variables(Path(path), None if wanted is None else wanted.values())
        tables = tables_of(Path(path), variables, wanted)
        head = {"tables": [(len(t), t.time is not None, list(t.columns), _plain(t.hints)) for t in tables]}
    except MemoryError as error:
        head = {"memory": str(error)}
    except InputError as error:
        head = {"refused": str(error)}
    except ImportError as error:
        head = {"refused": str(InputError("data.format", name, "a format whose package works", str(error)))}
    except Exception as error:  # libraries raise dozens of kinds
        head = {"damaged": str(error).strip().partition("\n")[0] or type(error).__name__}
    out.write(json.dumps(head).encode() + b"\n")
    for table in tables:
        for values in [*table.columns.values(), *([] if table.time is None else [table.time])]:
            out.write(values.data)
    out.close()
    os._exit(0)  # what a damaged file left behind in a library is not cleaned up


def _plain(hints: Mapping[str, SensorHint]) -> dict[str, Any]:
    return {name: astuple(hint) for name, hint in hints.items()}


def _tables(path: Path, heads: Sequence[Any], content: memoryview) -> list[Table]:
    check_size(path, len(content))
    numbers, tables, start = np.frombuffer(content).copy(), [], 0
    for samples, timed, names, hints in heads:
        end = start + samples * (len(names) + timed)
        rows = list(numbers[start:end].reshape(len(names) + timed, samples))
        told, start = {name: SensorHint(*texts) for name, texts in hints.items()}, end
        tables.append(Table(path, dict(zip(names, rows, strict=False)), {}, told, rows[-1] if timed else None))
    return tables
