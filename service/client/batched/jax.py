"""A table on arrays of JAX: ``jit``, ``vmap``, ``grad`` and ``jacfwd`` work on what it returns."""

from __future__ import annotations

import importlib
from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..errors import InvalidArgument, MissingPackage
from .evaluator import Answers, Evaluator

try:
    jax: Any = importlib.import_module("jax")  # not `import`: checkers find this file by that name
    jnp: Any = importlib.import_module("jax.numpy")
except ModuleNotFoundError as error:
    raise MissingPackage(
        "tables on arrays of JAX need the package 'jax', which is not installed: "
        "pip install 'wrenchbook[jax]'",
        name="jax",
    ) from error

__all__ = ["Answers", "Evaluator", "evaluator"]


def evaluator(
    table: Any, method: str | None = None, dtype: Any = None, tolerance: Any = None
) -> Evaluator:
    """Return a function of wrenches (k, n), SI, which answers as the table does.

    Parameters
    ----------
    table : Table
        A downloaded or opened one.
    method : {"kriging", "griddata", "additive", "linear"}, optional
        The table's own without.
    dtype : {"float32", "float64"}, optional
        JAX's own without: float32, unless ``jax_enable_x64`` is set.
    tolerance
        As in `Table.answer`.

    Raises
    ------
    InvalidArgument
        If the table has not the method, or JAX not the type; a ValueError.
    """
    found = np.dtype(jnp.zeros(0).dtype if dtype is None else dtype)
    if found not in (np.float32, np.float64):
        raise InvalidArgument(f"dtype must be float32 or float64, not {found}")
    if found != jnp.zeros(0, found).dtype:
        raise InvalidArgument(
            "JAX has no float64 now: jax.config.update('jax_enable_x64', True) before it is used"
        )
    return Evaluator(Backend(found), table, method, tolerance)


class Backend:
    """What differs from PyTorch."""

    xp, stop = jnp, staticmethod(jax.lax.stop_gradient)

    def __init__(self, dtype: np.dtype) -> None:
        self.dtype, self.rounding = dtype, float(np.finfo(dtype).eps)

    def put(self, array: NDArray[Any]) -> Any:
        """Return an array of the table; its unit and shape stay."""
        return jnp.asarray(array, dtype=self.dtype if array.dtype == np.float64 else None)

    def of(self, wrenches: Any) -> Any:
        """Return the caller's array in the evaluator's type."""
        return jnp.asarray(wrenches, dtype=self.dtype)

    def along(self, array: Any, places: Any, axis: int) -> Any:
        """Return what lies at places along an axis."""
        return jnp.take_along_axis(array, places, axis=axis)

    def whole(self, truth: Any) -> Any:
        """Return 0 and 1."""
        return truth.astype(jnp.int32)

    def arange(self, count: int) -> Any:
        """Return 0 to count - 1."""
        return jnp.arange(count)

    def largest(self, array: Any, axis: int) -> Any:
        """Return the largest along an axis."""
        return jnp.max(array, axis=axis)

    def chunks(self, function: Callable[..., Any], size: int, *arrays: Any) -> Any:
        """Return a function's arrays, of so many lines of its arguments at once."""
        count = arrays[0].shape[0]
        if count <= size:
            return function(*arrays)
        main = count // size * size
        heads = tuple(one[:main].reshape(-1, size, *one.shape[1:]) for one in arrays)
        found = jax.lax.map(lambda part: function(*part), heads)
        found = tuple(one.reshape(main, *one.shape[2:]) for one in found)
        if main == count:
            return found
        rest = function(*(one[main:] for one in arrays))
        return tuple(jnp.concatenate(both) for both in zip(found, rest, strict=True))

    def differentiable(self, value: Callable[..., Any], slopes: Callable[..., Any]) -> Any:
        """Return a function (k, n) -> (k, m) whose derivative is (k, m, n)."""
        function = jax.custom_jvp(value)

        def rule(primals: Any, tangents: Any) -> Any:
            (w,), (step,) = primals, tangents
            return function(w), jnp.einsum("kqn,kn->kq", slopes(w), step)

        function.defjvp(rule)
        return function

    def batched(self, function: Callable[..., Any]) -> Callable[..., Any]:
        """Return a function of arrays (k, ...) that `vmap` calls once, with all lines."""
        whole = jax.custom_batching.custom_vmap(function)

        def rule(size: int, batched: Any, *arrays: Any) -> Any:
            lines = [
                one if own else jnp.broadcast_to(one, (size, *one.shape))
                for one, own in zip(arrays, batched, strict=True)
            ]
            found = whole(*(one.reshape(-1, *one.shape[2:]) for one in lines))
            found = tuple(one.reshape(size, -1, *one.shape[1:]) for one in found)
            return found, (True,) * len(found)

        whole.def_vmap(rule)
        return whole
