"""A table on tensors of PyTorch: ``autograd`` and ``torch.func`` work on what it returns."""

from __future__ import annotations

import importlib
from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..errors import InvalidArgument, MissingPackage
from .evaluator import Answers, Evaluator

try:
    torch: Any = importlib.import_module("torch")  # not `import`: as in jax.py
except ModuleNotFoundError as error:
    raise MissingPackage(
        "tables on tensors of PyTorch need the package 'torch', which is not installed: "
        "pip install 'wrenchbook[torch]'",
        name="torch",
    ) from error

__all__ = ["Answers", "Evaluator", "evaluator"]


def evaluator(
    table: Any,
    method: str | None = None,
    dtype: Any = None,
    tolerance: Any = None,
    device: Any = None,
) -> Evaluator:
    """Return a function of wrenches (k, n), SI, which answers as the table does.

    Parameters
    ----------
    table : Table
        A downloaded or opened one.
    method : {"kriging", "griddata", "additive", "linear"}, optional
        The table's own without.
    dtype : torch.dtype or str, optional
        ``torch.float32`` or ``torch.float64``; PyTorch's default without.
    tolerance
        As in `Table.answer`.
    device : torch.device or str, optional
        Where the table lies, and the wrenches must lie; PyTorch's default without.

    Raises
    ------
    InvalidArgument
        If the table has not the method, or there is no such type; a ValueError.
    """
    found = torch.get_default_dtype() if dtype is None else dtype
    found = getattr(torch, found, found) if isinstance(found, str) else found
    if found not in (torch.float32, torch.float64):
        raise InvalidArgument(f"dtype must be float32 or float64, not {found}")
    return Evaluator(Backend(found, device), table, method, tolerance)


class Backend:
    """What differs from JAX."""

    xp = torch

    def __init__(self, dtype: Any, device: Any) -> None:
        self.dtype, self.rounding = dtype, float(torch.finfo(dtype).eps)
        self.device = torch.get_default_device() if device is None else torch.device(device)

    def put(self, array: NDArray[Any]) -> Any:
        """Return an array of the table; its unit and shape stay."""
        types = {"f": self.dtype, "b": torch.bool}
        dtype = types.get(array.dtype.kind, torch.int64)
        return torch.tensor(np.ascontiguousarray(array), dtype=dtype, device=self.device)

    def of(self, wrenches: Any) -> Any:
        """Return the caller's array in the evaluator's type."""
        return torch.as_tensor(wrenches, dtype=self.dtype, device=self.device)

    def stop(self, array: Any) -> Any:
        """Return an array without derivatives."""
        return array.detach()

    def along(self, array: Any, places: Any, axis: int) -> Any:
        """Return what lies at places along an axis."""
        return torch.take_along_dim(array, places, dim=axis)

    def whole(self, truth: Any) -> Any:
        """Return 0 and 1."""
        return truth.to(torch.int64)

    def arange(self, count: int) -> Any:
        """Return 0 to count - 1."""
        return torch.arange(count, device=self.device)

    def largest(self, array: Any, axis: int) -> Any:
        """Return the largest along an axis."""
        return torch.amax(array, dim=axis)

    def chunks(self, function: Callable[..., Any], size: int, *arrays: Any) -> Any:
        """Return a function's arrays, of so many lines of its arguments at once."""
        parts = zip(*(one.split(size) for one in arrays), strict=True)
        found = [function(*part) for part in parts]
        if len(found) == 1:
            return found[0]
        return tuple(torch.cat(each) for each in zip(*found, strict=True))

    def differentiable(self, value: Callable[..., Any], slopes: Callable[..., Any]) -> Any:
        """Return a function (k, n) -> (k, m) whose derivative is (k, m, n)."""

        class Differentiable(torch.autograd.Function):
            generate_vmap_rule = True

            @staticmethod
            def forward(w: Any) -> Any:
                return value(w)

            @staticmethod
            def setup_context(ctx: Any, inputs: Any, output: Any) -> None:
                ctx.save_for_backward(inputs[0])
                ctx.save_for_forward(inputs[0])

            @staticmethod
            def backward(ctx: Any, *grads: Any) -> Any:
                return torch.einsum("kqn,kq->kn", slopes(ctx.saved_tensors[0]), grads[0])

            @staticmethod
            def jvp(ctx: Any, *steps: Any) -> Any:
                return torch.einsum("kqn,kn->kq", slopes(ctx.saved_tensors[0]), steps[0])

        return Differentiable.apply

    def batched(self, function: Callable[..., Any]) -> Callable[..., Any]:
        """Return a function of arrays (k, ...)."""
        return function
