"""Files that a library reads in a process of its own, with limits on memory and time.

What a file does in that process, it does there alone. The process is a new Python, no fork of this one, which may have
threads. It is asked in JSON, and answers with JSON and the bytes of arrays of numbers and texts: nothing that comes
back is executed. One process reads as many files as it is asked for, and answers one after the other.
"""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
from collections.abc import Callable, Generator, Iterable, Iterator, Sequence
from contextlib import suppress
from importlib import import_module
from pathlib import Path
from threading import Timer
from typing import IO, Any

import numpy as np

from pinn_cli.settings.errors import InputError

# What comes of one file: plain values, as JSON has them, and arrays.
Answer = tuple[Any, Sequence[np.ndarray]]
# Bytes that libraries map before they read anything, three times those of pyarrow.
_LIBRARIES = 2**30
# Seconds of a processor that any question may take, and bytes that are read in each further one: pyuff, the slowest,
# reads 18 million; and how much longer it may take where others keep the processor busy.
_SECONDS, _BYTES_A_SECOND, _BUSY = 10.0, 2**19, 6
# Kinds of arrays that are their bytes.
_KINDS = "biufcSU"


class UnreadableError(ValueError):
    """What a file does to the library that reads it, or what the library says of it."""


def read_apart(
    read: Callable[..., Iterable[Answer]], question: Sequence[Any], files: Iterable[Path], memory: float
) -> Generator[Answer, None, None]:
    """What a function makes of files, in a process of its own.

    Args:
        read: At the top of a module. It is called in the other process; what it yields comes here.
        question: Its arguments, as JSON has them.
        files: That it reads.
        memory: Bytes that it may take beside its libraries.

    Raises:
        InputError: It says so.
        UnreadableError: It raises anything else, ends the process, or takes more memory or time than it may.
    """
    limit_s = int(_SECONDS + sum(file.stat().st_size for file in files if file.is_file()) / _BYTES_A_SECOND)
    # One thread is what a reader needs; each further one of a library for linear algebra maps memory.
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(map(str, sys.path)), "OPENBLAS_NUM_THREADS": "1"}
    call = f"from {__name__} import answer; answer({_LIBRARIES + int(memory)}, {limit_s})"
    with subprocess.Popen(
        [sys.executable, "-P", "-c", call], stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL,
        env=environment, start_new_session=True,  # Ctrl-C is the asking one's
    ) as process:  # fmt: skip
        late = Timer(_BUSY * limit_s, process.kill)
        late.daemon = True
        late.start()
        try:
            yield from _answers(process, [read.__module__, read.__qualname__, list(question)])
        except (EOFError, OSError):
            busy = process.wait() == -signal.SIGXCPU or not late.is_alive()
            raise UnreadableError(f"it takes more than {limit_s} s to read" if busy else "its reader crashes") from None
        finally:
            late.cancel()
            process.kill()


def _answers(process: subprocess.Popen[bytes], question: Sequence[Any]) -> Iterator[Answer]:
    """What a process answers, until it says that this was all; EOFError: it ended before."""
    assert process.stdin is not None
    assert process.stdout is not None
    process.stdin.write(json.dumps(question).encode())
    process.stdin.close()
    while (line := process.stdout.readline()).endswith(b"\n"):
        word, content, layouts = json.loads(line)
        match word:
            case "refused":
                raise InputError.read(content)
            case "unreadable":
                raise UnreadableError(content)
            case "end":
                return
        yield content, [_array(process.stdout, *layout) for layout in layouts]
    raise EOFError


def _array(stream: IO[bytes], kind: str, shape: Sequence[int]) -> np.ndarray:
    """The next array of a stream."""
    array = np.empty(shape, kind)
    if array.nbytes and stream.readinto(array.reshape(-1).view(np.uint8)) < array.nbytes:  # type: ignore[attr-defined]
        raise EOFError
    return array


def answer(memory: int, limit_s: int) -> None:
    """What the other process does: read a question and answer it, within so many bytes of memory and seconds."""
    with suppress(ImportError, ValueError, OSError):  # systems without such limits, or with lower ones
        import resource

        resource.setrlimit(resource.RLIMIT_CPU, (limit_s, limit_s + 1))  # the one that asks may be gone by then
        resource.setrlimit(resource.RLIMIT_AS, (memory, memory))
    out = os.fdopen(os.dup(1), "wb")
    os.dup2(2, 1)  # what libraries print is no answer
    module, name, question = json.load(sys.stdin)
    last = "end", ""
    try:
        for plain, arrays in getattr(import_module(module), name)(*question):
            _write(out, "read", plain, [np.asarray(array, order="C") for array in arrays])
    except InputError as error:
        last = "refused", str(error)
    except Exception as error:  # libraries raise dozens of kinds
        last = "unreadable", str(error).strip().partition("\n")[0] or type(error).__name__
    _write(out, *last, [])
    os._exit(0)  # what a damaged file left behind in a library is not cleaned up


def _write(out: IO[bytes], word: str, plain: Any, arrays: Sequence[np.ndarray]) -> None:
    if odd := [array.dtype for array in arrays if array.dtype.kind not in _KINDS]:
        raise ValueError(f"it holds {odd[0]}, which is neither numbers nor texts")
    out.write(json.dumps([word, plain, [(array.dtype.str, array.shape) for array in arrays]]).encode() + b"\n")
    for array in arrays:
        if array.nbytes:
            out.write(array.reshape(-1).view(np.uint8).data)
    out.flush()
