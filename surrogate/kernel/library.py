"""The compiled kernel, loaded by ctypes once a process."""

from __future__ import annotations

import ctypes
import struct
from collections.abc import Sequence
from functools import cache
from typing import NamedTuple

from .build import ready_library
from .replies import REPLY_SIZE, method_code


class Kernel(NamedTuple):
    """The library: calls keep the interpreter lock by `with_gil`, release it by `without_gil`."""

    with_gil: ctypes.PyDLL
    without_gil: ctypes.CDLL


@cache
def kernel() -> Kernel:
    """Return the library, compiled first where it is not that of its sources.

    Raises
    ------
    KernelBuildError
        If it is not there and cannot be compiled.
    """
    path = str(ready_library())
    found = Kernel(ctypes.PyDLL(path), ctypes.CDLL(path))
    address, size, whole = ctypes.c_void_p, ctypes.c_size_t, ctypes.c_int
    real = ctypes.c_double
    forms = {
        "wb_open_checked": (address, [address, size, address, size]),
        "wb_close": (None, [address]),
        "wb_inputs": (whole, [address]),
        "wb_outputs": (whole, [address]),
        "wb_scratch": (size, [address]),
        "wb_answer": (whole, [address] * 5),
        "wb_answer_many": (whole, [address, address, size, *[address] * 4, whole]),
        "wb_derivative_many": (whole, [address, address, size, address, address, whole]),
        "wb_inverse": (whole, [address] * 6),
        "wb_joint_rate": (whole, [whole, address, address, real, real, address]),
        "wb_axis": (whole, [address, address, whole, whole, address, address]),
    }
    for library in found:
        for name, (result, arguments) in forms.items():
            function = getattr(library, name)
            function.restype, function.argtypes = result, arguments
    return found


class _Options(ctypes.Structure):
    _fields_ = (
        ("method", ctypes.c_int),
        ("tolerance", ctypes.c_void_p),
        ("without_rows", ctypes.c_int),
    )


class Work:
    """The buffers of one answer: inputs, options, reply and scratch.

    Attributes
    ----------
    at : tuple of int
        Addresses of inputs, reply and scratch.
    """

    def __init__(self, inputs: int, outputs: int, scratch: int) -> None:
        self.inputs = (ctypes.c_double * inputs)()
        self.tolerance = (ctypes.c_double * outputs)()
        self.reply = ctypes.create_string_buffer(REPLY_SIZE)
        self.scratch = (ctypes.c_double * (scratch // 8 + 1))()
        self._options = _Options(-1, None, 0)
        self._pack = struct.Struct(f"={inputs}d").pack_into
        self.at = tuple(map(ctypes.addressof, (self.inputs, self.reply, self.scratch)))

    def fill(self, wrench: Sequence[float]) -> None:
        """Take the n loads of a wrench, N and N·m.

        Raises
        ------
        ValueError
            If they are not n numbers.
        """
        try:
            self._pack(self.inputs, 0, *wrench)
        except struct.error as error:
            raise ValueError(f"a wrench of {len(self.inputs)} numbers: {error}") from error

    def options(
        self,
        tolerance: Sequence[float] | None,
        method: str | None,
        without_rows: bool = False,
    ) -> int | None:
        """Take the options of a request and return their address, None for the component's own.

        The tolerance has m numbers, m and rad; with `without_rows` the method alone answers.

        Raises
        ------
        UnknownMethodError
            If there is no such method.
        ValueError
            If the tolerance has not m numbers.
        """
        if tolerance is None and method is None and not without_rows:
            return None
        self._options.method, self._options.tolerance = method_code(method), None
        self._options.without_rows = without_rows
        if tolerance is not None:
            self.tolerance[:] = tuple(map(float, tolerance))
            self._options.tolerance = ctypes.addressof(self.tolerance)
        return ctypes.addressof(self._options)
