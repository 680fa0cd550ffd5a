"""A file read in a process of its own, with limits on memory and time: what the file does there, it does there alone.

The process is a new Python, no fork of this one, which may have threads. It is asked in JSON, and answers with arrays
in NumPy's own form, without pickles: nothing that comes back is executed.
"""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import astuple
from importlib import import_module
from io import BytesIO
from pathlib import Path
from typing import ClassVar, Protocol
from zipfile import BadZipFile

import numpy as np

from pinn_cli.record.files.on_disk import damaged
from pinn_cli.record.files.table import SensorHint, Table
from pinn_cli.runs.machine import of_this_machine
from pinn_cli.settings.errors import InputError

# Bytes that libraries map before they read anything, three times those of pyarrow; and of the memory, the part that a
# file may take beyond them: its content, its numbers as stored, as float64 and on their way, a sixteenth each at most.
_LIBRARIES, _PART_OF_MEMORY = 2**30, 4
# Seconds of a processor that any file may take, and bytes that are read in each further one: pyuff, the slowest, reads
# 18 million; and how much longer it may take where others keep the processor busy.
_SECONDS, _BYTES_A_SECOND, _BUSY = 10.0, 2**19, 6


class Reader(Protocol):
    """What a format tells and does here: see :class:`pinn_cli.record.files.base.ArrayFormat`."""

    expected: ClassVar[str]

    def tables(self, path: Path, wanted: Mapping[str, str] | None) -> list[Table]:
        """The columns, in one table for each clock."""


def read_apart(own: Reader, path: Path, wanted: Mapping[str, str] | None) -> list[Table]:
    """What a format's ``tables`` reads in the other process.

    Args:
        own: The file's format.
        path: Of the file.
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
    try:
        done = subprocess.run(
            command, input=json.dumps(question).encode(), stdout=subprocess.PIPE, stderr=subprocess.DEVNULL,
            env=environment, timeout=_BUSY * limit_s, check=True, start_new_session=True,  # Ctrl-C is the asking one's
        )  # fmt: skip
        answered = np.load(BytesIO(done.stdout))
        refused, layout = json.loads(str(answered["arr_0"]))
    except subprocess.TimeoutExpired:
        raise damaged(path, own.expected, f"it takes more than {limit_s} s to read") from None
    except (subprocess.CalledProcessError, BadZipFile, EOFError, ValueError) as error:
        busy = getattr(error, "returncode", 0) == -signal.SIGXCPU
        reason = f"it takes more than {limit_s} s to read" if busy else "its reader crashes"
        raise damaged(path, own.expected, reason) from None
    if refused:
        raise InputError.read(refused)
    arrays = (answered[name] for name in answered.files[1:])
    tables = []
    for names, hints, timed in layout:
        columns = {name: next(arrays) for name in names}
        told = {name: SensorHint(*texts) for name, texts in hints.items()}
        tables.append(Table(path, columns, {}, told, next(arrays) if timed else None))
    return tables


def answer(memory: int, limit_s: int) -> None:
    """What the other process does: read a question and answer it, within so many bytes of memory and seconds."""
    with suppress(ImportError, ValueError, OSError):  # systems without such limits, or with lower ones
        import resource

        resource.setrlimit(resource.RLIMIT_CPU, (limit_s, limit_s + 1))  # the one that asks may be gone by then
        resource.setrlimit(resource.RLIMIT_AS, (memory, memory))
    out = os.fdopen(os.dup(1), "wb")
    os.dup2(2, 1)  # what libraries print is no answer
    module, name, settings, path, wanted = json.load(sys.stdin)
    tables: list[Table] = []
    refused = ""
    try:
        own = object.__new__(getattr(import_module(module), name))
        vars(own).update(settings)
        tables = own.tables(Path(path), wanted)
    except InputError as error:
        refused = str(error)
    layout = [
        (list(table.columns), {name: astuple(hint) for name, hint in table.hints.items()}, table.time is not None)
        for table in tables
    ]
    arrays = [values for t in tables for values in (*t.columns.values(), *(() if t.time is None else (t.time,)))]
    np.savez(out, np.array(json.dumps([refused, layout])), *arrays)
    out.close()
    os._exit(0)  # what a damaged file left behind in a library is not cleaned up
