"""A built table as one file that any number of processes map: they hold one copy of its arrays.

What answers is pickled with its arrays beside it, as they lie in memory (protocol 5, PEP 574), so
whoever maps them has the same bytes in the same layout, and answers the same digits. The pages are
mapped privately: they are the file's, shared by all, for as long as nobody writes into them, and
nobody does.

A file is checked before anything in it is used: a sum over all of it, who wrote it, and of which
kinds its objects are. It is no archive: another version of anything builds the table anew.
"""

from __future__ import annotations

import io
import json
import mmap
import os
import pickle
import platform
import zlib
from collections.abc import Callable, Iterable, Iterator
from functools import cache
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from surrogate.build import AnyTable

_MAGIC = b"wrenchbook table\n"
_ALIGNED = 64  # bytes: a line of the processor's cache, and what its widest loads like
_BLOCK = 64 * 1024  # bytes summed up at once
_SMALL = 1024  # bytes: an array of less is copied, the page it would take is larger
# Whose objects a file may hold: a pickle can name anything there is.
_ROOMS = ("surrogate.", "numpy", "scipy.spatial")
_BUILTINS = frozenset(
    {"builtins.getattr", "builtins.slice", "functools.partial", "collections.OrderedDict"}
)


class ImageError(Exception):
    """A file that is no table's image, a damaged one, or another version's."""


def write_image(surrogate: AnyTable, path: Path) -> None:
    """Write a built table to a file, which is there whole or not at all.

    It need not outlive the machine's power: it can be built again.

    Raises
    ------
    OSError
        If it cannot be written; a file that was there is as it was.
    """
    buffers: list[memoryview] = []
    stream = io.BytesIO()
    _Pickler(stream, buffers).dump(surrogate)
    parts = [memoryview(stream.getvalue()), *buffers]
    sizes = [part.nbytes for part in parts]
    head = json.dumps({"made_by": _made_by(), "sizes": sizes, "check": _sum(parts)}).encode()
    partial = path.with_name(f".{path.name}.{os.getpid()}")
    try:
        with partial.open("wb") as file:
            file.write(_MAGIC + len(head).to_bytes(8, "little") + head)
            for start, part in zip(_places(file.tell(), sizes), parts, strict=True):
                file.seek(start)
                file.write(part)
            file.truncate(max(file.tell(), 1))
        partial.replace(path)
    finally:
        partial.unlink(missing_ok=True)


def read_image(path: Path, *, checked: bool = False) -> AnyTable:
    """Return the table of a file; its arrays stay in the file, mapped.

    Parameters
    ----------
    path : path
    checked : bool
        Whether the caller knows that the file is whole, having just written it.

    Raises
    ------
    ImageError
        If it is damaged or of another version of anything.
    OSError
        If there is none, or it cannot be read.
    """
    try:
        with path.open("rb") as file:
            # A private copy in name: whoever wrote into a page would get a page of their own.
            mapped = memoryview(mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_COPY))
        first, *buffers = _parts(mapped, checked)
        return _Unpickler(io.BytesIO(first), buffers=buffers).load()
    except (ValueError, KeyError, TypeError, EOFError, AttributeError, ImportError) as error:
        raise ImageError(f"{path} is no table's image: {error}") from error
    except pickle.UnpicklingError as error:
        raise ImageError(f"{path}: {error}") from error


def _parts(mapped: memoryview, checked: bool) -> list[memoryview]:
    """Return the pickle and the arrays of a mapped file, once they are known to be whole."""
    start = len(_MAGIC) + 8
    if bytes(mapped[: len(_MAGIC)]) != _MAGIC:
        raise ValueError("it begins otherwise")
    end = start + int.from_bytes(mapped[len(_MAGIC) : start], "little")
    head = json.loads(bytes(mapped[start:end]))
    if head["made_by"] != _made_by():
        raise ValueError(f"it was made by {head['made_by']}, this is {_made_by()}")
    places = zip(_places(end, head["sizes"]), head["sizes"], strict=True)
    parts = [mapped[place : place + size] for place, size in places]
    whole = [part.nbytes for part in parts] == head["sizes"]
    if not whole or not (checked or _sum(parts) == head["check"]):
        raise ValueError("its sum is another than when it was written")
    return parts


def _sum(parts: Iterable[memoryview]) -> int:
    """Return a sum that damage changes; other threads go on meanwhile.

    Of blocks of words by numpy, and of these sums and what is over by CRC-32: a tenth of the time
    of CRC-32 over all, which each process would take for each version.
    """
    check = 0
    for part in parts:
        blocks = part.nbytes // _BLOCK
        words = np.frombuffer(part[: blocks * _BLOCK], dtype=np.uint64)
        sums = words.reshape(blocks, _BLOCK // 8).sum(axis=1, dtype=np.uint64)
        check = zlib.crc32(part[blocks * _BLOCK :], zlib.crc32(sums.tobytes(), check))
    return check


def _places(start: int, sizes: list[int]) -> Iterator[int]:
    """Yield where each part begins, the first one after `start` bytes."""
    for size in sizes:
        start = -(-start // _ALIGNED) * _ALIGNED
        yield start
        start += size


@cache  # reading what is installed takes as long as mapping a table of 30,000 rows
def _made_by() -> str:
    """Return the versions of all that says how a table lies in memory."""
    versions = {name: version(name) for name in ("wrenchbook", "numpy", "scipy")}
    words = [f"{name} {number}" for name, number in versions.items()]
    return " ".join([*words, f"Python {platform.python_version()}", platform.machine()])


class _Pickler(pickle.Pickler):
    """Pickles arrays by their memory: views as views, so that nothing is in the file twice."""

    def __init__(self, file: io.BytesIO, buffers: list[memoryview]) -> None:
        def beside(buffer: pickle.PickleBuffer) -> bool:
            raw = buffer.raw()
            if raw.nbytes < _SMALL:
                return True  # within the pickle
            buffers.append(raw)
            return False

        super().__init__(file, protocol=5, buffer_callback=beside)

    def reducer_override(self, obj: Any) -> Any:
        """Return how an array is made anew from its memory; all else as it is."""
        if type(obj) is not np.ndarray or obj.dtype.hasobject or not obj.size:
            return NotImplemented
        flags = obj.flags.writeable
        if not any(obj.strides):  # one number, said to be everywhere
            return _everywhere, (obj[(0,) * obj.ndim], obj.shape, flags)
        owner = obj
        while isinstance(owner.base, np.ndarray):
            owner = owner.base
        if owner is not obj and type(owner) is np.ndarray and _is_dense(owner):
            start = obj.__array_interface__["data"][0] - owner.__array_interface__["data"][0]
            return _view, (owner, obj.dtype, obj.shape, start, obj.strides, flags)
        if not _is_dense(obj):
            return NotImplemented
        order = np.argsort([-stride for stride in obj.strides], kind="stable")
        memory = pickle.PickleBuffer(obj.transpose(order))  # pyright: ignore[reportArgumentType]
        return _array, (memory, obj.dtype, obj.shape, obj.strides, flags)


def _is_dense(array: NDArray[Any]) -> bool:
    """Tell whether an array's numbers lie side by side, in whatever order of its axes."""
    order = np.argsort([-stride for stride in array.strides], kind="stable")
    return array.transpose(order).flags.c_contiguous


def _array(
    memory: Any, dtype: np.dtype[Any], shape: Any, strides: Any, writeable: bool
) -> NDArray[Any]:
    made = np.ndarray(shape, dtype, buffer=memory, strides=strides)
    if made.flags.writeable and not writeable:
        made.flags.writeable = False
    return made


def _view(
    owner: NDArray[Any], dtype: Any, shape: Any, start: int, strides: Any, writeable: bool
) -> NDArray[Any]:
    order = np.argsort([-stride for stride in owner.strides], kind="stable")
    memory = owner.transpose(order)
    made = np.ndarray(shape, dtype, memory, start, strides)
    if made.flags.writeable and not writeable:
        made.flags.writeable = False
    return made


def _everywhere(value: Any, shape: tuple[int, ...], writeable: bool) -> NDArray[Any]:
    return np.full(shape, value) if writeable else np.broadcast_to(value, shape)


_OWN: dict[str, Callable[..., Any]] = {
    f"{__name__}.{one.__name__}": one for one in (_array, _view, _everywhere)
}


class _Unpickler(pickle.Unpickler):
    """Reads what a table is made of, and nothing else."""

    def find_class(self, module_name: str, global_name: str, /) -> Any:
        """Return a class or function by its name, if tables have any of it."""
        name = f"{module_name}.{global_name}"
        if name in _OWN:
            return _OWN[name]
        if name in _BUILTINS or name.startswith(_ROOMS):
            return super().find_class(module_name, global_name)
        raise pickle.UnpicklingError(f"a table holds nothing of the kind {name}")
