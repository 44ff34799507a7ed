"""Tables on arrays of JAX and PyTorch answer with the kernel's bits."""

from __future__ import annotations

import sys
from functools import cache, partial, partialmethod
from typing import Any

import numpy as np
import pytest

from tests.acceptance.test_simulators import script
from tests.surrogate import test_space
from tests.surrogate.kernel.kinds import asked_of, packed_of, table_of
from wrenchbook.service.client import InvalidArgument, MissingPackage, Table, arrays
from wrenchbook.service.client.mount import Mount
from wrenchbook.surrogate.build import build
from wrenchbook.surrogate.packed.writer import packed_of as pack
from wrenchbook.surrogate.table.rows import Tolerance

MISSING = "the extra {!r} is not installed"
METHODS = ["kriging", "griddata", "linear"]
BENT = [
    *("second derivatives", "second derivatives of some"),
]


class OnJax:
    """Answers and derivatives by JAX, compiled."""

    def __init__(self) -> None:
        self.jax = pytest.importorskip("jax", reason=MISSING.format("jax"))
        self.evaluator = arrays.jax

    def answers(self, own: Any, asked: np.ndarray) -> list[np.ndarray]:
        return [np.asarray(item) for item in self.jax.jit(own)(asked)]

    def jacobians(self, function: Any, *asked: np.ndarray) -> np.ndarray:
        return np.asarray(self.jax.jit(self.jax.vmap(self.jax.jacfwd(function)))(*asked))

    def gradients(self, function: Any, *asked: np.ndarray) -> np.ndarray:
        total = self.jax.jit(self.jax.vmap(self.jax.grad(lambda *w: function(*w).sum())))
        return np.asarray(total(*asked))


class OnTorch:
    """Answers and derivatives by PyTorch."""

    def __init__(self) -> None:
        self.torch = pytest.importorskip("torch", reason=MISSING.format("torch"))
        self.evaluator = arrays.torch

    def answers(self, own: Any, asked: np.ndarray) -> list[np.ndarray]:
        return [item.numpy() for item in own(self.torch.tensor(asked))]

    def jacobians(self, function: Any, *asked: np.ndarray) -> np.ndarray:
        func = self.torch.func
        return func.vmap(func.jacrev(function))(*map(self.torch.tensor, asked)).numpy()

    def gradients(self, function: Any, *asked: np.ndarray) -> np.ndarray:
        first, *others = map(self.torch.tensor, asked)
        first.requires_grad_()
        function(first, *others).sum().backward()
        assert first.grad is not None
        return first.grad.numpy()


@pytest.fixture(params=[OnJax, OnTorch])
def on(request):
    result = request.param()
    if request.param is OnTorch:
        yield result
        return
    before = result.jax.config.jax_enable_x64
    result.jax.config.update("jax_enable_x64", True)
    yield result
    result.jax.config.update("jax_enable_x64", before)


@cache
def downloaded(kind: str) -> Table:
    return Table(packed_of(kind), kind)


@pytest.mark.parametrize(
    ("kind", "method"), [*(("solved", method) for method in METHODS), *((k, None) for k in BENT)]
)
def test_the_framework_differentiates_to_the_kernels_derivative(on, kind, method):
    table, asked = downloaded(kind), asked_of(table_of(kind), 40, 5, 0.9)
    own = on.evaluator(table, method)
    expected = table.packed.derivatives(asked, None, method)
    np.testing.assert_array_equal(on.jacobians(own.displacement, asked), expected)
    by_sums = on.gradients(own.displacement, asked)
    np.testing.assert_allclose(by_sums, expected.sum(axis=1), rtol=1e-12, atol=1e-18)


@pytest.mark.parametrize("method", METHODS)
def test_float32_is_the_kernels_float64_rounded(on, method):
    table, asked = downloaded("solved"), asked_of(table_of("solved"), 200, 4, 0.9)
    single = asked.astype(np.float32)
    expected = table.packed.batch(single, None, method)
    moved, error, coverage = on.answers(on.evaluator(table, method), single)
    assert moved.dtype == error.dtype == np.float32
    np.testing.assert_array_equal(moved, expected.outputs.astype(np.float32))
    np.testing.assert_array_equal(error, expected.errors.astype(np.float32))
    np.testing.assert_array_equal(coverage, expected.coverage)


def each_of(on: Any, own: Any) -> Any:
    """What answers each wrench of a batch by itself, as the framework writes it."""
    return on.jax.vmap(own) if isinstance(on, OnJax) else on.torch.func.vmap(own)


def test_vmap_a_single_wrench_and_further_dimensions_have_the_numbers_of_a_batch(on):
    asked = asked_of(table_of("solved"), 50, 8, 1.1)
    own = on.evaluator(downloaded("solved"), "kriging")
    each = each_of(on, own)
    whole, mapped = on.answers(own, asked), on.answers(each, asked)
    blocks = on.answers(own, asked.reshape(5, 10, 6))
    twice = on.answers(each, asked.reshape(5, 10, 6))
    first = on.answers(own, asked[0])
    for one, *others in zip(whole, mapped, blocks, twice, strict=True):
        for other in others:
            np.testing.assert_array_equal(other.reshape(one.shape), one)
    for one, other in zip(whole, first, strict=True):
        np.testing.assert_array_equal(other, one[0])


def test_a_batch_is_one_call_of_the_kernel_under_vmap(on, monkeypatch):
    table, asked = downloaded("solved"), asked_of(table_of("solved"), 30, 2, 0.9)
    own = on.evaluator(table, "kriging")
    calls, kernel = [], type(table.packed)
    batch, derivatives = kernel.batch, kernel.derivatives

    def counted(name: str, function: Any, packed: Any, wrenches: np.ndarray, *options: Any) -> Any:
        calls.append((name, len(wrenches)))
        return function(packed, wrenches, *options)

    monkeypatch.setattr(kernel, "batch", partialmethod(partial(counted, "values", batch)))
    monkeypatch.setattr(kernel, "derivatives", partialmethod(partial(counted, "", derivatives)))
    on.answers(each_of(on, own), asked)
    assert calls == [("values", 30)]
    on.jacobians(own.displacement, asked)
    assert [call for call in calls[1:] if not call[0]] == [("", 30)]


def test_the_inverse_is_the_kernels_with_the_stiffness_as_its_derivative(on):
    table, asked = downloaded("solved"), asked_of(table_of("solved"), 12, 7, 0.5)
    own, moved = on.evaluator(table, "kriging"), table.packed.batch(asked, None, "kriging").outputs
    expected = [table.packed.inverse(item, None, "kriging") for item in moved]
    np.testing.assert_allclose([item[0] for item in expected], asked, rtol=1e-6, atol=1e-6)
    starts = np.zeros_like(asked)
    stiffness = on.jacobians(own.inverse, moved, starts)
    np.testing.assert_array_equal(stiffness, [item[1] for item in expected])
    gradients = on.gradients(own.inverse, moved, starts)
    np.testing.assert_allclose(gradients, stiffness.sum(axis=1), rtol=1e-9)
    moved[3], moved[4] = np.nan, 1e3
    result = np.asarray(own.inverse(moved))
    known = np.arange(12)[~np.isin(np.arange(12), (3, 4))]
    np.testing.assert_array_equal(result[known], [expected[k][0] for k in known])
    assert np.isnan(result[3:5]).all()


def test_the_inverse_from_many_starts_of_one_displacement_is_that_of_a_batch_under_vmap(on):
    table, starts = downloaded("solved"), asked_of(table_of("solved"), 5, 9, 0.3)
    own, moved = on.evaluator(table, "kriging"), table.packed.batch(starts).outputs
    if isinstance(on, OnTorch):
        starts, moved = on.torch.tensor(starts), on.torch.tensor(moved)
    by_start = each_of(on, lambda start: own.inverse(moved[0], start))(starts)
    by_moved = each_of(on, lambda target: own.inverse(target, starts[0]))(moved)
    np.testing.assert_array_equal(by_start, own.inverse(moved[0], starts))
    np.testing.assert_array_equal(by_moved, own.inverse(moved, starts[0]))


def test_beyond_the_range_the_start_decides_between_wrenches_of_one_displacement(on):
    table, source = downloaded("clean and full"), table_of("clean and full")
    asked = asked_of(source, 150, 3, 2.5)
    moved = table.packed.batch(asked).outputs
    own, scale = on.evaluator(table), source.load_range.scale
    result = np.asarray(own.inverse(moved))
    known = np.isfinite(result).all(axis=1)
    back = table.packed.batch(result[known]).outputs
    np.testing.assert_allclose(back, moved[known], rtol=1e-6, atol=1e-12)
    another = known & (np.abs(result - asked) > 0.1 * scale).any(axis=1)
    assert another.any()
    assert (np.abs(asked[another]) > source.load_range.high).any(axis=1).all()
    near = np.asarray(own.inverse(moved[another], 0.999 * asked[another]))
    np.testing.assert_allclose(near, asked[another], atol=1e-6 * scale.max())


def test_without_float64_jax_rounds_wrenches_and_answers_to_float32():
    jax = pytest.importorskip("jax", reason=MISSING.format("jax"))
    table, asked = downloaded("solved"), asked_of(table_of("solved"), 50, 4, 0.9)
    before = jax.config.jax_enable_x64
    jax.config.update("jax_enable_x64", False)
    try:
        moved, error, coverage = jax.jit(arrays.jax(table, "kriging"))(asked)
    finally:
        jax.config.update("jax_enable_x64", before)
    expected = table.packed.batch(asked.astype(np.float32), None, "kriging")
    np.testing.assert_array_equal(moved, expected.outputs.astype(np.float32))
    np.testing.assert_array_equal(error, expected.errors.astype(np.float32))
    np.testing.assert_array_equal(coverage, expected.coverage)


def test_the_inverse_of_a_table_with_further_inputs_keeps_those_of_its_start(on):
    space = test_space.SPACES["temperature"]
    load_range = test_space.range_of(space)
    rows = test_space.solved(space, test_space.spread_wrenches(load_range, 30))
    packed = pack(build(rows, load_range, tolerance=Tolerance(0.003, 0.003)))
    with pytest.raises(InvalidArgument, match="needs one wrench at one interface"):
        on.evaluator(Table(packed, "link"), "griddata")
    with pytest.raises(
        InvalidArgument, match="a mount takes components with one interface and no further inputs"
    ):
        Mount(Table(packed, "link"), "link", np.eye(3), np.zeros(3))
    asked = np.random.default_rng(3).uniform(-0.5, 0.5, (6, len(space.inputs)))
    moved = packed.batch(asked, None, "kriging").outputs
    start = np.where(np.arange(len(space.inputs)) < 6, 0.0, asked)
    own = on.evaluator(Table(packed, "link"), "kriging")
    expected = [packed.inverse(*pair, "kriging")[0] for pair in zip(moved, start, strict=True)]
    np.testing.assert_array_equal(np.asarray(own.inverse(moved, start)), expected)
    np.testing.assert_allclose(expected, asked, atol=1e-6)


def test_a_wrench_that_is_not_finite_is_outside(on):
    own = on.evaluator(downloaded("solved"), "kriging")
    asked = np.array([[np.nan, 0, 0, 0, 0, 0], [0, 0, np.inf, 0, 0, 0]])
    moved, error, coverage = on.answers(own, asked)
    assert np.isnan(moved).all()
    assert np.isnan(error).all()
    assert coverage.tolist() == [2, 2]
    assert np.isnan(np.asarray(own.derivative(asked))).all()


@pytest.mark.parametrize("shape", [(0, 6), (3, 0, 6)])
def test_an_empty_batch_has_empty_answers(on, shape):
    own = on.evaluator(downloaded("solved"), "kriging")
    moved, error, coverage = on.answers(own, np.zeros(shape))
    assert (moved.shape, error.shape, coverage.shape) == (shape, shape, shape[:-1])
    assert own.derivative(np.zeros(shape)).shape == (*shape, 6)
    assert own.inverse(np.zeros(shape)).shape == shape


def test_the_host_answers_an_empty_batch():
    moved, error, coverage = arrays.Host(downloaded("solved"), None, None).answers(np.zeros((0, 6)))
    assert (moved.shape, error.shape, coverage.shape) == ((0, 6), (0, 6), (0,))


def test_another_method_and_wrenches_of_another_length_are_refused(on):
    with pytest.raises(InvalidArgument, match="unknown method 'guess'"):
        on.evaluator(downloaded("solved"), "guess")
    own = on.evaluator(downloaded("solved"), "linear")
    with pytest.raises(InvalidArgument, match=r"shape \(6,\) or \(k, 6\).*, not \(3, 5\)"):
        own(np.zeros((3, 5)))
    with pytest.raises(InvalidArgument, match=r"displacements .* not \(\)"):
        own.inverse(np.float64(0.0))


@pytest.mark.parametrize("package", ["jax", "torch"])
def test_a_missing_package_is_named_with_its_extra(monkeypatch, package):
    monkeypatch.setitem(sys.modules, package, None)
    with pytest.raises(MissingPackage, match=rf"pip install 'wrenchbook\[{package}\]'"):
        getattr(arrays, package)(downloaded("solved"))


@pytest.mark.slow
@pytest.mark.parametrize("on", [OnJax], indirect=True)
def test_masses_that_drop_onto_a_plate_come_to_rest_where_its_table_says(on, capsys):
    masses, moved, slope = script("jax_masses").main(downloaded("solved"), 16, 3000)
    feet = np.random.default_rng(1)
    feet.uniform(5, 40, 16)
    x, y = feet.uniform(-0.02, 0.02, (16, 2)).T
    push = 9.81 * np.asarray(masses)
    rest = np.zeros((16, 6))
    rest[:, 2], rest[:, 3], rest[:, 4] = -push, -y * push, x * push
    expected = downloaded("solved").batch(rest).displacements
    np.testing.assert_allclose(moved, expected, atol=1e-9)
    more = downloaded("solved").batch(rest * (1 + 0.01 / np.asarray(masses))[:, None])
    by_differences = (more.displacements - expected)[:, 2] / 0.01
    np.testing.assert_allclose(slope, by_differences, rtol=1e-2)
    assert "16 masses" in capsys.readouterr().out
