"""What replies of any kind of table say, beside the golden answers."""

import math
import re

import numpy as np
import pytest

from tests.service.live import moved
from tests.slow import slow_but
from tests.surrogate import responses
from tests.surrogate.kernel.kinds import (
    KINDS,
    OF_SPACES,
    QUICK,
    RANGE,
    SAME,
    asked_of,
    clean,
    packed_of,
    rounding_of,
    size_of,
    special_of,
    table_of,
)
from tests.surrogate.kriging.responses import RESPONSES, solved
from tests.surrogate.law import build
from tests.surrogate.responses import full_wrenches
from wrenchbook.surrogate.answer import (
    BY_AXES,
    METHODS,
    UnknownMethodError,
    allowed_by,
    within_tolerance_many,
)
from wrenchbook.surrogate.packed.writer import packed_of as pack
from wrenchbook.surrogate.table.rows import Rows, Tolerance
from wrenchbook.surrogate.table.space import OUTPUTS

ROOT = 1e-5  # of the process deviation: sigma near a row is the root of a difference


@pytest.mark.parametrize(
    "kind", slow_but(QUICK, sorted({*KINDS, *OF_SPACES} - {"softening"}))
)  # whose mesh widens errors
def test_the_kriging_answers_as_the_one_that_was_calibrated(kind):
    table = table_of(kind)
    asked = np.concatenate((asked_of(table, 200, span=1.3), special_of(table, 80)))
    result = packed_of(kind).batch(asked, None, "kriging", without_rows=True)
    for group in table.groups:
        if group.kriging is None:
            continue
        outputs = list(group.outputs)
        moved, errors = (part[:, outputs] for part in group.kriging.answer_many(asked))
        given = np.isfinite(result.outputs[:, outputs])
        near = SAME * np.fmax(size_of(table), np.abs(result.outputs)) + rounding_of(table)
        near = near[:, outputs]
        assert (np.abs(result.outputs[:, outputs] - moved) <= near)[given].all()
        known = given & np.isfinite(errors).all(axis=1, keepdims=True)
        np.testing.assert_array_equal(np.isfinite(result.errors[:, outputs]), known)
        deviation = (group.kriging.deviation * group.kriging.scaling.spread)[outputs]
        loose = near + ROOT * (errors + deviation)
        assert (np.abs(result.errors[:, outputs] - errors) <= loose)[known].all()


def test_the_kernel_takes_the_same_of_equally_near_rows_as_the_build():
    x = np.concatenate((np.eye(6), -np.eye(6), np.zeros((1, 6)), full_wrenches(12, 4)))
    table = build(solved(RESPONSES["strongly_coupled"], x), responses.RANGE)
    own = table.rows.wrench
    asked = np.array([(own[i] + own[j]) / 2 for i in range(12) for j in range(i)])
    expected = table.kriging.answer_many(asked)[1]
    assert np.isfinite(expected).all(axis=1).mean() > 0.5
    np.testing.assert_allclose(pack(table).batch(asked, None, "kriging").errors, expected, 1e-4)


STEP = 3e-5  # of the load range: central differences then err by up to 1e-6 of a slope
FLAT = "one axis", "one force", "oblique line", "planar"  # their axes have fewer than 3 dimensions


@pytest.mark.parametrize(
    "kind", slow_but(QUICK, sorted({*KINDS, *OF_SPACES} - {"empty", "only beyond the range"}))
)
@pytest.mark.parametrize("method", METHODS)
def test_derivatives_are_differences_of_values(kind, method):
    """Of wrenches in the hulls of the axes: beyond them slopes are those along the hull."""
    table, packed = table_of(kind), packed_of(kind)
    if kind in OF_SPACES and method in BY_AXES:
        with pytest.raises(UnknownMethodError, match="one wrench at one interface"):
            packed.answer([0.0] * packed.inputs, None, method)
        return
    by_axes, asked = packed.answers_by(method) in BY_AXES, asked_of(table, 60, span=0.9)
    if by_axes and kind in FLAT:
        shares = np.random.default_rng(4).dirichlet(np.ones(len(table.rows)), 60)
        asked = shares @ table.rows.wrench
    here = packed.batch(asked, None, method, without_rows=True)
    scale = table.load_range.scale
    result = packed.derivatives(asked, None, method, without_rows=True) * scale
    size = np.fmax(size_of(table), np.nanmax(np.abs(result), axis=2, initial=0.0))
    limit = size * 1e-6 + rounding_of(table) / STEP
    for load, step in enumerate(STEP * np.diag(scale)):
        ahead, behind = (
            packed.batch(asked + sign * step, None, method, without_rows=True).outputs
            for sign in (1, -1)
        )
        slope, bend = (ahead - behind) / (2 * STEP), (ahead + behind - 2 * here.outputs) / STEP
        apart = np.abs(result[:, :, load] - slope)
        known = np.isfinite(apart)
        if by_axes:  # a kink between two simplices is no slope
            known &= (np.abs(bend) <= limit) & (here.coverage < 2)[:, None]
        assert known.any() or by_axes or not np.ptp(table.rows.wrench[:, load])
        assert (apart <= limit)[known].all()


@pytest.mark.parametrize("kind", slow_but({*QUICK, "repeated"} & {*KINDS}, sorted(KINDS)))
def test_a_reply_of_a_row_names_it_and_its_sources(kind):
    table, packed = table_of(kind), packed_of(kind)
    for wrench in table.rows.wrench[:10]:
        result = packed.answer(wrench.tolist(), [0.0] * 6)
        if result.method == "row":
            same = (table.rows.wrench == wrench).all(axis=1)
            assert result.exact
            own = table.rows.compliance[same][-1]
            np.testing.assert_array_equal(packed.derivative(wrench, [0.0] * 6), own)
            assert result.row in table.rows.seq[same]
            assert result.source == ", ".join(dict.fromkeys(table.rows.source[same].tolist()))


def test_the_reason_tells_the_rows_of_every_group_of_outputs_that_is_off_its_rows():
    """The kernel told those of the first group alone."""
    wrenches = clean(12)
    reported = moved(wrenches)
    reported[::2, 2] = np.nan
    reported[::3, 4] = np.nan
    table = build(Rows.of(wrenches, reported), RANGE)
    packed, spans = pack(table), set()
    assert len(table.groups) == 3
    for wrench in asked_of(table, 40).tolist():
        result = packed.answer(wrench, None, "griddata").reason
        spans |= set(re.findall(r"axis x: [^;]*", result)) if "lies outside" in result else set()
    assert len(spans) > 40


@pytest.mark.parametrize("kind", ["solved", "linear", "softening", "partial", "clean"])
def test_whole_errors_are_judged_by_the_tolerance(kind):
    table, packed, asked = table_of(kind), packed_of(kind), asked_of(table_of(kind), 60)
    errors = packed.batch(asked).errors
    # No answer has just this error, which rounding would judge.
    known = np.where(np.isnan(errors), 0.0, errors).reshape(-1, 2, 3)
    translation, rotation = 1e-12 + 1.0001 * np.quantile(known, 0.7, axis=(0, 2))
    tolerance = Tolerance(translation, rotation)
    replies = packed.batch(asked, tolerance and allowed_by(tolerance))
    expected = within_tolerance_many(replies.outputs, replies.errors, tolerance)
    if not table.bars_are_complete:
        expected = [None] * len(asked)
    result = [
        packed.answer(w, tolerance and allowed_by(tolerance)).within_tolerance
        for w in asked.tolist()
    ]
    assert result == expected


def test_the_parts_of_an_error_are_those_of_the_solver():
    table, packed = table_of("linear"), packed_of("linear")
    for wrench in asked_of(table, 5).tolist():
        result, shares = packed.answer(wrench), table.solver_error.parts(wrench)
        np.testing.assert_allclose(result.discretisation, shares["mesh"], rtol=1e-13)
        np.testing.assert_allclose(result.linearity, shares["linearity"], rtol=1e-13)
        total = np.add(result.interpolation, np.add(result.discretisation, result.linearity))
        np.testing.assert_allclose(result.error, total, rtol=1e-13)
    unknown = packed_of("solved").answer(asked_of(table_of("solved"), 1)[0].tolist())
    assert unknown.discretisation is None
    assert unknown.error == unknown.interpolation
    reported = packed_of("clean").answer([1.0] * 6)
    assert reported.discretisation == (0.0,) * 6


def test_a_table_of_partial_outputs_names_those_that_no_row_holds():
    table, packed = table_of("partial"), packed_of("partial")
    assert table.rows.partial
    result = packed.answer([1.0] * 6)
    assert result.missing == ("ry",)
    assert result.outputs[OUTPUTS.index("ry")] is None
    assert "not measured in any row: ry" in result.reason


def test_estimates_beyond_the_limits_of_tables_are_not_given():
    asked = asked_of(table_of("huge"), 300, span=4.0)
    result = packed_of("huge").batch(asked)
    gone = np.isnan(result.outputs).all(axis=1)
    assert gone.any()
    assert not gone.all()
    assert (result.coverage[gone] > 0).all()
    reply = packed_of("huge").answer(asked[gone][0].tolist())
    assert reply.outputs is None
    assert "20 degrees" in reply.reason
    assert reply.within_tolerance is None
    assert np.nanmax(np.linalg.norm(result.outputs[:, 3:], axis=1)) <= math.radians(20.0)


@pytest.mark.parametrize("locked", [(1,), (0, 4, 5)])
def test_loads_on_locked_freedoms_change_nothing(locked):
    asked = asked_of(table_of("solved"), 50)
    other = asked.copy()
    other[:, list(locked)] *= -3.0
    packed = packed_of("solved", locked)
    for one, two in zip(packed.batch(asked), packed.batch(other), strict=True):
        np.testing.assert_array_equal(one, two)
    assert packed.answer(asked[0].tolist()) == packed.answer(other[0].tolist())
