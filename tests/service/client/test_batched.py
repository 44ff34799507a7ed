"""Tables on arrays of JAX and PyTorch answer as the kernel does."""

from __future__ import annotations

import importlib
import sys
from functools import cache
from typing import Any

import numpy as np
import pytest

from tests.acceptance.test_simulators import script
from tests.surrogate import test_space
from tests.surrogate.kernel.kinds import (
    KINDS,
    SAME,
    SIGMA,
    asked_of,
    packed_of,
    rounding_of,
    size_of,
    table_of,
)
from wrenchbook.service.client import InvalidArgument, MissingPackage, Table
from wrenchbook.surrogate.build import build
from wrenchbook.surrogate.kernel.packing import packed_of as pack
from wrenchbook.surrogate.table.rows import Tolerance

HOME = "wrenchbook.service.client.batched"
MISSING = "the extra {!r} is not installed"
METHODS = ["kriging", "griddata", "linear"]
BENT = [
    *("second derivatives", "second derivatives of some"),
    *("own length scales", "own length scales, second derivatives"),
]


class OnJax:
    """Answers and derivatives by JAX, compiled."""

    def __init__(self) -> None:
        self.jax = pytest.importorskip("jax", reason=MISSING.format("jax"))
        self.evaluator = importlib.import_module(f"{HOME}.jax").evaluator

    def answers(self, own: Any, asked: np.ndarray) -> list[np.ndarray]:
        return [np.asarray(one) for one in self.jax.jit(own)(asked)]

    def jacobians(self, own: Any, asked: np.ndarray) -> np.ndarray:
        return np.asarray(self.jax.jit(self.jax.vmap(self.jax.jacfwd(own.displacement)))(asked))


class OnTorch:
    """Answers and derivatives by PyTorch."""

    def __init__(self) -> None:
        self.torch = pytest.importorskip("torch", reason=MISSING.format("torch"))
        self.evaluator = importlib.import_module(f"{HOME}.torch").evaluator

    def answers(self, own: Any, asked: np.ndarray) -> list[np.ndarray]:
        return [one.numpy() for one in own(asked)]

    def jacobians(self, own: Any, asked: np.ndarray) -> np.ndarray:
        func = self.torch.func
        return func.vmap(func.jacrev(own.displacement))(self.torch.tensor(asked)).numpy()


@pytest.fixture(params=[OnJax, OnTorch])
def on(request):
    found = request.param()
    if request.param is OnTorch:
        yield found
        return
    before = found.jax.config.jax_enable_x64
    found.jax.config.update("jax_enable_x64", True)
    yield found
    found.jax.config.update("jax_enable_x64", before)


@cache
def downloaded(kind: str) -> Table:
    return Table(packed_of(kind), kind)


def assert_same(on: Any, kind: str, method: str | None, dtype: str = "float64") -> None:
    """Compare all numbers with the kernel's; what a kriging's sums lose is in `rounding_of`."""
    table = downloaded(kind)
    asked = np.concatenate((asked_of(table_of(kind), 120), asked_of(table_of(kind), 40, 3, 3.0)))
    expected = table.packed.batch(asked, None, method)
    moved, error, coverage = on.answers(on.evaluator(table, method, dtype), asked)
    size = np.maximum(size_of(table_of(kind)), np.abs(np.nan_to_num(expected.outputs)))
    near = SAME * size + rounding_of(table_of(kind))
    np.testing.assert_array_equal(coverage, expected.coverage)
    np.testing.assert_array_equal(np.isnan(moved), np.isnan(expected.outputs))
    np.testing.assert_array_equal(np.isnan(error), np.isnan(expected.errors))
    assert (np.nan_to_num(np.abs(moved - expected.outputs)) <= near).all()
    loose = near + SIGMA * np.nan_to_num(expected.errors)
    assert (np.nan_to_num(np.abs(error - expected.errors)) <= loose).all()


@pytest.mark.parametrize("method", METHODS)
def test_answers_error_bars_and_coverage_are_the_kernels(on, method):
    assert_same(on, "solved", method)


@pytest.mark.parametrize("kind", sorted(KINDS))
def test_every_kind_of_table_answers_in_batches_as_the_kernel_does(kind):
    assert_same(OnTorch(), kind, "griddata" if "few with" in kind else None)


@pytest.mark.parametrize("kind", BENT)
def test_tables_of_second_derivatives_answer_as_the_kernel_does(on, kind):
    assert_same(on, kind, None)


@pytest.mark.parametrize("kind", ["planar", "partial", "softening"])
def test_flat_and_partial_tables_and_meshes_that_err_answer_compiled_as_the_kernel_does(kind):
    on = OnJax()
    with on.jax.enable_x64(True):
        assert_same(on, kind, None)


@pytest.mark.parametrize(
    ("kind", "method"), [*(("solved", method) for method in METHODS), *((k, None) for k in BENT)]
)
def test_the_framework_differentiates_to_the_kernels_derivative(on, kind, method):
    table, asked = downloaded(kind), asked_of(table_of(kind), 40, 5, 0.9)
    own = on.evaluator(table, method, "float64")
    expected = table.packed.derivatives(asked, None, method)
    unit = table_of(kind).load_range.scale / size_of(table_of(kind))[:, None]
    assert (np.abs(on.jacobians(own, asked) - expected) * unit).max() < 1e-11
    np.testing.assert_allclose(
        np.asarray(own.derivative(asked)) * unit, expected * unit, atol=1e-11
    )


@pytest.mark.parametrize("method", METHODS)
def test_derivatives_are_those_of_differences(on, method):
    """Off the hull griddata has the slope at the hull's nearest point, which then stays."""
    table, found = downloaded("solved"), table_of("solved")
    asked = asked_of(found, 60, 6, 0.3)
    asked = asked[table.packed.batch(asked, None, method).coverage < 2][:8]
    assert len(asked) > 4
    own, steps = on.evaluator(table, method, "float64"), 1e-5 * np.diag(found.load_range.scale)
    ends = [(asked[:, None] + sign * steps).reshape(-1, 6) for sign in (1, -1)]
    high, low = (on.answers(own, one)[0].reshape(-1, 6, 6) for one in ends)
    by_differences = (high - low).transpose(0, 2, 1) / 2e-5
    slopes = on.jacobians(own, asked) * found.load_range.scale
    assert (np.abs(slopes - by_differences) / size_of(found)[:, None]).max() < 1e-5


@pytest.mark.parametrize("method", METHODS)
def test_float32_loses_what_its_digits_and_the_sums_of_a_kriging_lose(on, method):
    """Sums of a kriging lose `rounding_of` in float64: in float32 more by the ratio of the two."""
    table, found = downloaded("solved"), table_of("solved")
    asked = asked_of(found, 200, 4, 0.9)
    expected = table.packed.batch(asked, None, method)
    moved, error, coverage = on.answers(on.evaluator(table, method, "float32"), asked)
    assert moved.dtype == error.dtype == np.float32
    lost = np.abs(moved - expected.outputs).max(axis=0)
    print(f"float32, {method}: {(lost / size_of(found)).max():.1e} of the range")
    sums = rounding_of(found) * 2.0**29 if method == "kriging" else 0.0
    assert (lost <= 1e-5 * size_of(found) + sums).all()
    assert (coverage >= expected.coverage).mean() > 0.98
    assert (np.abs(moved - expected.outputs) <= error)[np.isfinite(error)].all()


@pytest.mark.parametrize(
    ("solved", "size"), [(test_space.solved, 1.0), (test_space.solved_with_second, 1e-9)]
)
@pytest.mark.parametrize("space", test_space.SPACES.values(), ids=test_space.SPACES)
def test_tables_of_several_interfaces_and_further_inputs_answer_as_the_kernel_does(
    on, space, solved, size
):
    load_range = test_space.range_of(space)
    rows = solved(space, test_space.spread_wrenches(load_range, 30))
    tolerance = Tolerance(0.003 * size, 0.003 * size)
    packed = pack(build(rows, load_range, tolerance=tolerance))
    asked = np.random.default_rng(3).uniform(-1.1, 1.1, (90, len(space.inputs)))
    expected = packed.batch(asked, None, "kriging")
    own = on.evaluator(Table(packed, "link"), "kriging", "float64")
    moved, error, coverage = on.answers(own, asked)
    np.testing.assert_allclose(moved, expected.outputs, rtol=0, atol=1e-12 * size)
    np.testing.assert_allclose(error, expected.errors, rtol=1e-8, atol=1e-12 * size)
    np.testing.assert_array_equal(coverage, expected.coverage)
    slopes = packed.derivatives(asked, None, "kriging")
    np.testing.assert_allclose(np.asarray(own.derivative(asked)), slopes, atol=1e-11 * size)
    with pytest.raises(InvalidArgument, match="griddata exists for one wrench at one interface"):
        on.evaluator(Table(packed, "link"), "griddata")


def test_vmap_and_a_single_wrench_have_the_numbers_of_a_batch():
    on = OnJax()
    with on.jax.enable_x64(True):
        asked = asked_of(table_of("solved"), 50, 8, 1.1)
        own = on.evaluator(downloaded("solved"), "kriging", "float64")
        whole, mapped = on.answers(own, asked), on.answers(on.jax.vmap(own), asked)
        for one, other, first in zip(whole, mapped, own(asked[0]), strict=True):
            np.testing.assert_allclose(other, one, rtol=1e-7, atol=1e-15)
            np.testing.assert_allclose(first, one[0], rtol=1e-7, atol=1e-15)


def test_a_tolerance_decides_the_coverage_as_in_the_table(on):
    table, asked = downloaded("solved"), asked_of(table_of("solved"), 80, 9, 1.0)
    tolerance = {"translation": 2e-6, "rotation": 2e-5}
    own = on.evaluator(table, "kriging", "float64", tolerance)
    names = np.array(["covered", "thin", "outside"])[on.answers(own, asked)[2]]
    expected = table.batch(asked, tolerance, "kriging").coverage
    assert 0 < (expected == "thin").mean() < 1
    np.testing.assert_array_equal(names, expected)


def test_a_wrench_that_is_not_finite_is_outside(on):
    own = on.evaluator(downloaded("solved"), "kriging", "float64")
    asked = np.array([[np.nan, 0, 0, 0, 0, 0], [0, 0, np.inf, 0, 0, 0]])
    moved, error, coverage = on.answers(own, asked)
    assert np.isnan(moved).all()
    assert np.isnan(error).all()
    assert coverage.tolist() == [2, 2]


def test_a_method_that_does_not_answer_in_batches_is_named_with_those_that_do(on):
    with pytest.raises(InvalidArgument, match=r"'tangent' does not .*: kriging, linear, griddata"):
        on.evaluator(downloaded("solved"), "tangent")
    with pytest.raises(InvalidArgument, match="has no kriging"):
        on.evaluator(downloaded("linear"), "kriging")


def test_wrenches_of_another_length_are_refused(on):
    own = on.evaluator(downloaded("solved"), "linear", "float64")
    with pytest.raises(InvalidArgument, match=r"shape \(6,\) or \(k, 6\), not \(3, 5\)"):
        own(np.zeros((3, 5)))


@pytest.mark.parametrize("package", ["jax", "torch"])
def test_a_missing_package_is_named_with_its_extra(monkeypatch, package):
    monkeypatch.setitem(sys.modules, package, None)
    monkeypatch.delitem(sys.modules, f"{HOME}.{package}", raising=False)
    with pytest.raises(MissingPackage, match=rf"pip install 'wrenchbook\[{package}\]'"):
        importlib.import_module(f"{HOME}.{package}")


@pytest.mark.slow
def test_masses_that_drop_onto_a_plate_come_to_rest_where_its_table_says(capsys):
    on = OnJax()
    with on.jax.enable_x64(True):
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
