"""Tables on arrays of JAX and PyTorch, and joints on arrays of JAX, for many environments.

The kernel answers on the host, for arrays of any device, with the numbers of `Table.batch`.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable, Mapping
from functools import partial
from typing import TYPE_CHECKING, Any, NamedTuple, TypeAlias

import numpy as np
from numpy.typing import NDArray

from wrenchbook.surrogate.answer import OUTSIDE

from .errors import InvalidArgument, required
from .joint.joint import DAMPING, Joint, shape_of
from .joint.joints import status_of
from .table import Table
from .wrenches import Tolerance, floats_of

if TYPE_CHECKING:
    from types import ModuleType

Floats = NDArray[np.float64]
Array: TypeAlias = Any  # an array of JAX or PyTorch, neither of which need be installed
Shapes = list[tuple[tuple[int, ...], Array]]  # shape and type of each result
# Fields of a joint's reply and buffers of its inputs, in the order of `JointAnswers` and of a step.
_REPLIES = "wrench", "displacement", "wrench_error", "force", "rate", "coverage"
_BUFFERS = "memory", "poses", "velocities", "inverse_masses"


class Answers(NamedTuple):
    """The answers to wrenches, shape (..., n).

    Attributes
    ----------
    displacement, error : array
        Shape (..., m), m and rad; NaN where unknown. Only displacements have derivatives.
    coverage : array of int32
        Shape (...): 0 is covered, 1 thin, 2 outside.
    """

    displacement: Array
    error: Array
    coverage: Array


class Host:
    """The kernel's batches on numpy arrays of any leading shape, of a table's present version."""

    def __init__(self, table: Table, method: str | None, tolerance: Tolerance | None) -> None:
        table.batch(np.zeros((1, table.packed.inputs)), tolerance, method)  # refuses wrong options
        self.name = table.name
        self.packed = table.packed
        self.options = table.allowed_errors(tolerance), method
        self.threads = os.cpu_count() or 1

    def answers(self, wrenches: Array) -> tuple[Floats, Floats, NDArray[np.int32]]:
        """Return displacements and errors (..., m), m and rad, and coverage (...)."""
        rows, not_finite, shape = self._rows(wrenches)
        moved, error, coverage = self.packed.batch(rows, *self.options, self.threads)
        moved[not_finite] = error[not_finite] = np.nan
        coverage[not_finite] = OUTSIDE
        block = (*shape, self.packed.outputs)  # not -1, which an empty batch leaves open
        return moved.reshape(block), error.reshape(block), coverage.astype(np.int32).reshape(shape)

    def slopes(self, wrenches: Array) -> Floats:
        """Return du/dw (..., m, n), SI."""
        rows, not_finite, shape = self._rows(wrenches)
        slopes = self.packed.derivatives(rows, *self.options, self.threads)
        slopes[not_finite] = np.nan
        return slopes.reshape(*shape, *slopes.shape[1:])

    def inverse(self, moved: Array, start: Array) -> tuple[Floats, Floats]:
        """Return wrenches (..., n), SI, and stiffness (..., n, m), row by row; NaN without one."""
        shape = moved.shape[:-1]
        n, m = self.packed.inputs, self.packed.outputs
        targets = np.asarray(moved, dtype=float).reshape(-1, m)
        starts = np.broadcast_to(np.asarray(start, dtype=float), (*shape, n)).reshape(-1, n)
        wrenches = np.full((len(targets), n), np.nan)
        stiffness = np.full((len(targets), n, m), np.nan)
        for row, (target, begin) in enumerate(zip(targets, starts, strict=True)):
            try:
                inverse = self.packed.inverse(target, begin, self.options[1])
            except (ArithmeticError, ValueError):  # no such wrench, or no finite number
                continue
            wrenches[row], stiffness[row] = inverse
        return wrenches.reshape(*shape, n), stiffness.reshape(*shape, n, m)

    def _rows(self, wrenches: Array) -> tuple[Floats, NDArray[np.intp], tuple[int, ...]]:
        """Return wrenches as rows (k, n), zero if not finite, the indices of these, and (...)."""
        array = np.asarray(wrenches, dtype=float)
        rows = array.reshape(-1, self.packed.inputs) + 0.0  # no negative zeros; a copy
        not_finite = np.flatnonzero(~np.isfinite(rows).all(axis=1))
        rows[not_finite] = 0.0
        return rows, not_finite, array.shape[:-1]


class Framework(NamedTuple):
    """Functions on arrays of JAX or PyTorch, which the package differentiates and vectorises."""

    xp: ModuleType
    array: Callable[[Array], Array]  # values as an array of the package, float32 or float64
    answers: Callable[[Array], tuple[Array, Array, Array]]  # see `Host.answers`
    slopes: Callable[[Array], Array]  # see `Host.slopes`
    inverse: Callable[[Array, Array], Array]  # the wrenches of `Host.inverse`


class Evaluator:
    """A table's function of wrenches (..., n), SI, in the order of ``table.space.inputs``.

    `jax` and `torch` make one, with the table's version at that time. Results have the wrenches'
    type; the kernel computes in float64. Wrenches that are not finite are outside, with NaN.
    """

    def __init__(self, host: Host, framework: Framework) -> None:
        self._host = host
        self._framework = framework

    def __call__(self, wrenches: Array) -> Answers:
        """Return displacements, error bars and coverage."""
        return Answers(*self._framework.answers(self._checked(wrenches, self._host.packed.inputs)))

    def displacement(self, wrenches: Array) -> Array:
        """Return the displacements alone, shape (..., m), m and rad, for differentiation."""
        return self(wrenches).displacement

    def derivative(self, wrenches: Array) -> Array:
        """Return du/dw, shape (..., m, n), SI, in one call; it has no derivative itself."""
        return self._framework.slopes(self._checked(wrenches, self._host.packed.inputs))

    def inverse(self, displacements: Array, start: Array = None) -> Array:
        """Return the wrenches (..., n), SI, of displacements (..., m), m and rad, as joints do.

        The derivative by the displacements is the stiffness. NaN where no wrench is found. Beyond
        the load range several wrenches may have one displacement: `start` decides which is found.

        Parameters
        ----------
        displacements : array
            Shape (..., m), m and rad.
        start : array, optional
            Shape (..., n), SI: where Newton's method starts, and the further inputs; zero if not
            given. It has no derivative.
        """
        n, m = self._host.packed.inputs, self._host.packed.outputs
        moved = self._checked(displacements, m, "displacements")
        begin = self._checked(np.zeros(n) if start is None else start, n)
        lead = np.broadcast_shapes(moved.shape[:-1], begin.shape[:-1])
        broadcast = self._framework.xp.broadcast_to
        return self._framework.inverse(broadcast(moved, (*lead, m)), broadcast(begin, (*lead, n)))

    def _checked(self, values: Array, count: int, name: str = "wrenches") -> Array:
        """Return the package's array of values, whose last dimension must be `count`."""
        array = self._framework.array(values)
        if not array.shape or array.shape[-1] != count:
            raise InvalidArgument(
                f"{name} must have the shape ({count},) or (k, {count}) for {self._host.name}, "
                f"with columns in the order of table.space, not {tuple(array.shape)}"
            )
        return array


def jax(table: Table, method: str | None = None, tolerance: Tolerance | None = None) -> Evaluator:
    """Return a function on arrays of JAX: ``jit``, ``vmap``, ``grad`` and ``jacfwd`` work on it.

    Without JAX's ``jax_enable_x64`` wrenches and results are rounded to float32, 7 digits.

    Parameters
    ----------
    table : Table
        A downloaded or opened table.
    method : str, optional
        How the table answers; its default without.
    tolerance : mapping or pair, optional
        As in `Table.answer`.

    Raises
    ------
    InvalidArgument
        If the table does not answer by the method, or the tolerance is none.
    MissingPackage
        If JAX is not installed.
    """
    package = required("jax", "arrays.jax", "'wrenchbook[jax]'")
    jnp = required("jax.numpy", "arrays.jax", "'wrenchbook[jax]'")
    host = Host(table, method, tolerance)
    on_host = partial(_jax_on_host, package)
    n, m = host.packed.inputs, host.packed.outputs

    def array(values: Array) -> Array:
        dtype = jnp.asarray(values).dtype
        return jnp.asarray(values, dtype=dtype if dtype in (np.float32, np.float64) else float)

    def slopes(w: Array) -> Array:
        return on_host(lambda rows: [host.slopes(rows)], [((*w.shape[:-1], m, n), w.dtype)], w)[0]

    @package.custom_jvp
    def answers(w: Array) -> tuple[Array, Array, Array]:
        outputs = (*w.shape[:-1], m), w.dtype
        return tuple(on_host(host.answers, [outputs, outputs, (w.shape[:-1], np.int32)], w))

    @answers.defjvp
    def answers_jvp(primals: tuple[Array, ...], tangents: tuple[Array, ...]) -> tuple[Array, Array]:
        moved, error, coverage = answers(*primals)
        change = jnp.einsum("...qn,...n->...q", slopes(*primals), tangents[0])
        of_integers = np.zeros(coverage.shape, package.dtypes.float0)  # JAX's type for no tangent
        return (moved, error, coverage), (change, jnp.zeros_like(error), of_integers)

    def wrench_and_stiffness(u: Array, start: Array) -> tuple[Array, Array]:
        lead = u.shape[:-1]
        return on_host(host.inverse, [((*lead, n), u.dtype), ((*lead, n, m), u.dtype)], u, start)

    @package.custom_jvp
    def inverse(u: Array, start: Array) -> Array:
        return wrench_and_stiffness(u, start)[0]

    @inverse.defjvp
    def inverse_jvp(primals: tuple[Array, ...], tangents: tuple[Array, ...]) -> tuple[Array, Array]:
        wrench, stiffness = wrench_and_stiffness(*primals)
        return wrench, jnp.einsum("...nq,...q->...n", stiffness, tangents[0])

    return Evaluator(
        host, Framework(xp=jnp, array=array, answers=answers, slopes=slopes, inverse=inverse)
    )


def _jax_on_host(
    package: ModuleType, function: Callable[..., Iterable[Array]], shapes: Shapes, *arrays: Array
) -> Array:
    """Call a function of numpy arrays; `vmap` calls it once, with all rows."""

    def call(*values: Array) -> list[Array]:
        pairs = zip(function(*values), shapes, strict=True)
        return [array.astype(dtype, copy=False) for array, (_, dtype) in pairs]

    results = [package.ShapeDtypeStruct(shape, dtype) for shape, dtype in shapes]
    return package.pure_callback(call, results, *arrays, vmap_method="broadcast_all")


class JointAnswers(NamedTuple):
    """One step of joints by `jax_joint`: wrench, displacement and error (..., 6) as of `Joints`.

    With velocities v after the step, in the axes of the angular velocity, the wrench is force (...,
    6) + rate (..., 6, 6) v. Coverage: 0 covered, 1 thin, 2 outside. Status: 0 ok; otherwise wrench
    and force are NaN: -1 beyond twice the range, or a code of ``wrenchbook.h``. Memory is for the
    next step.
    """

    wrench: Array
    displacement: Array
    error: Array
    force: Array
    rate: Array
    coverage: Array
    status: Array
    memory: Array


def jax_joint(
    table: Table,
    dt: float,
    damping: float = DAMPING,
    *,
    axes: Array = None,
    interface: str | None = None,
    method: str | None = None,
    inputs: Mapping[str, float] | None = None,
) -> tuple[Callable[[Array, Array, Array, Array], JointAnswers], int]:
    """Return a step of joints on arrays of JAX, and s, the size of a joint's memory.

    ``step(memory, poses, velocities, inverse_masses)`` takes a memory (..., s), zeros at the start,
    and the shapes of `Joints.step`. `jit`, `vmap` (one call of the kernel) and `lax.scan` work on
    it; it has no derivative. The memory has the poses' type: float32 rounds it in each step.

    Parameters
    ----------
    table, damping, interface, method, inputs
        As of `Joint`.
    dt : float
        The step, s.
    axes : array_like, optional
        Shape (3, 3), of k interfaces (k, 3, 3): the interface frame's axes, as columns, in the
        tip's own axes. Needed if quaternions, angular velocities and moments refer to the tip's
        axes, as MuJoCo's ball does.

    Raises
    ------
    InvalidArgument
        As of `Joint`, or if `dt` is not above 0 or a shape is wrong; of ``step`` too.
    MissingPackage
        If JAX is not installed.
    """
    package = required("jax", "arrays.jax_joint", "'wrenchbook[jax]'")
    joint = Joint(table, damping, interface=interface, method=method, inputs=inputs)
    first = joint.new_steps(1, None)
    square = shape_of(first.interfaces, 3, 3)
    turned = None if axes is None else floats_of("axes", axes, square)
    if not 0.0 < dt < np.inf:
        raise InvalidArgument(f"dt must be a finite number above 0 s, not {dt}")

    size = first.memory.shape[1]
    shapes = {name: first.replies[name].shape[1:] for name in _REPLIES}
    entered = [getattr(first, name).shape[1:] for name in _BUFFERS]

    def on_host(*arrays: Array) -> list[Array]:
        """Run a step of the kernel on numpy arrays."""
        lead = arrays[0].shape[:-1]
        steps = joint.new_steps(int(np.prod(lead)), turned)
        for name, array in zip(_BUFFERS, arrays, strict=True):
            buffer = getattr(steps, name)
            buffer[:] = np.asarray(array).reshape(buffer.shape)
        steps.step(dt, damping, os.cpu_count() or 1)

        codes = status_of(joint, steps)
        coverage = steps.replies["coverage"]
        floats = [steps.replies[name] for name in _REPLIES[:-1]]
        results = *floats, np.where(coverage < 0, OUTSIDE, coverage), codes, steps.memory
        return [array.reshape((*lead, *array.shape[1:])) for array in results]

    def step(memory: Array, poses: Array, velocities: Array, inverse_masses: Array) -> JointAnswers:
        arrays = [package.numpy.asarray(a) for a in (memory, poses, velocities, inverse_masses)]
        lead = arrays[0].shape[:-1]
        kind = arrays[1].dtype
        expected = [(*lead, *shape) for shape in entered]
        if [array.shape for array in arrays] != expected:
            raise InvalidArgument(
                f"memory, poses, velocities and inverse_masses must have the shapes {expected}, "
                f"in this order, not {[array.shape for array in arrays]}"
            )

        results = [((*lead, *shapes[name]), kind) for name in _REPLIES[:-1]]
        results += [((*lead, *shapes["coverage"]), np.int32), (lead, np.int32)]
        results += [((*lead, size), kind)]
        return JointAnswers(*_jax_on_host(package, on_host, results, *arrays))

    return step, size


def torch(table: Table, method: str | None = None, tolerance: Tolerance | None = None) -> Evaluator:
    """Return a function on tensors of PyTorch: ``autograd`` and ``torch.func`` work on it.

    Results are on the wrenches' device. Parameters and errors are those of `jax`.

    Raises
    ------
    InvalidArgument
        As of `jax`.
    MissingPackage
        If PyTorch is not installed.
    """
    package = required("torch", "arrays.torch", "'wrenchbook[torch]'")
    host = Host(table, method, tolerance)
    slopes = _torch_function(package, lambda w: (host.slopes(w),))
    answers = _torch_function(package, host.answers, lambda w, *_: slopes(w)[0])
    inverse = _torch_function(package, host.inverse, lambda *tensors: tensors[-1])

    def array(values: Array) -> Array:
        tensor = package.as_tensor(values)
        floats = tensor.dtype in (package.float32, package.float64)
        return tensor if floats else tensor.to(package.get_default_dtype())

    framework = Framework(
        xp=package,
        array=array,
        answers=answers,
        slopes=lambda w: slopes(w)[0],
        inverse=lambda u, start: inverse(u, start.to(u))[0],
    )
    return Evaluator(host, framework)


def _torch_function(
    package: ModuleType,
    on_host: Callable[..., tuple[Array, ...]],
    jacobian: Callable[..., Array] | None = None,
) -> Callable[..., tuple[Array, ...]]:
    """Return a function of tensors by a function of numpy arrays (..., k).

    The first tensor of its results is differentiable by the first argument, with a `jacobian` of
    arguments and results; without it none is. `vmap` calls it once, with all rows.
    """

    def chained(sums: str, ctx: Array, change: Array) -> Array:
        """Return the product of the jacobian at a call and a change of arguments or results."""
        if jacobian is None:
            raise InvalidArgument("a derivative has no derivative; differentiate displacement once")
        return package.einsum(sums, jacobian(*ctx.saved_tensors), change)

    class Function(package.autograd.Function):
        @staticmethod
        def forward(*tensors: Array) -> tuple[Array, ...]:
            like = tensors[0]
            blocks = on_host(*(tensor.detach().cpu().numpy() for tensor in tensors))
            kinds = {"f": like.dtype, "i": package.int32}
            return tuple(
                package.tensor(block, dtype=kinds[block.dtype.kind], device=like.device)
                for block in blocks
            )

        @staticmethod
        def setup_context(ctx: Array, inputs: tuple[Array, ...], output: tuple[Array, ...]) -> None:
            ctx.counts = len(inputs), len(output)
            ctx.save_for_backward(*inputs, *output)
            ctx.save_for_forward(*inputs, *output)
            ctx.mark_non_differentiable(*output[0 if jacobian is None else 1 :])

        @staticmethod
        def backward(ctx: Array, *grads: Array) -> tuple[Array, ...]:
            change = chained("...qn,...q->...n", ctx, grads[0])
            return change, *[None] * (ctx.counts[0] - 1)

        @staticmethod
        def jvp(ctx: Array, *steps: Array) -> tuple[Array, ...]:
            change = chained("...qn,...n->...q", ctx, steps[0])
            return change, *[None] * (ctx.counts[1] - 1)

        @staticmethod
        def vmap(info: Any, dims: tuple[int | None, ...], *tensors: Array) -> tuple[Array, Array]:
            lines = [
                tensor.expand(info.batch_size, *tensor.shape)
                if dim is None
                else tensor.movedim(dim, 0)
                for tensor, dim in zip(tensors, dims, strict=True)
            ]
            results = Function.apply(*lines)
            return results, (0,) * len(results)

    return Function.apply
