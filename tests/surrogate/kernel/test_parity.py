"""The kernel answers what the numpy law does, to 1e-12 of an output's range.

A kriging's weights may be 1e8 times what they sum to: there no number is right beyond what its
`rounding` states, nor a sigma near its least beyond 1e-9 of itself.
"""

import math
import re

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.service.live import moved
from tests.surrogate import responses
from tests.surrogate.kernel.kinds import (
    KINDS,
    RANGE,
    SAME,
    SIGMA_AT_ROWS,
    SQUARED,
    asked_of,
    assert_law,
    by_numpy,
    clean,
    deviation_of,
    packed_of,
    rounding_of,
    six,
    size_of,
    special_of,
    table_of,
)
from tests.surrogate.kriging.responses import RESPONSES, solved
from tests.surrogate.law import build
from tests.surrogate.responses import full_wrenches
from wrenchbook.surrogate.answer import BY_AXES, METHODS, within_tolerance_many
from wrenchbook.surrogate.kernel.binding import PackedTable
from wrenchbook.surrogate.kernel.explain import explain
from wrenchbook.surrogate.packed.writer import pack
from wrenchbook.surrogate.table.rows import Rows, Tolerance
from wrenchbook.surrogate.table.space import OUTPUTS

LOCKED = [(), (1,), (0, 4, 5)]


def assert_same(kind, asked, tolerance=None, method=None, locked=()):
    """Compare all numbers and coverage at some wrenches."""
    assert_law(table_of(kind, locked), packed_of(kind, locked), asked, tolerance, method)


tolerances = st.none() | st.builds(
    Tolerance, st.floats(-8, -3).map(lambda x: 10**x), st.floats(-8, -2).map(lambda x: 10**x)
)


@settings(max_examples=60, deadline=None)
@given(
    kind=st.sampled_from(sorted(KINDS)),
    seed=st.integers(0, 2**32 - 1),
    span=st.sampled_from([0.4, 1.0, 1.3, 4.0]),
    tolerance=tolerances,
    method=st.none() | st.sampled_from(METHODS),
    locked=st.sampled_from(LOCKED),
)
def test_the_kernel_answers_as_numpy_does(kind, seed, span, tolerance, method, locked):
    assert_same(kind, asked_of(table_of(kind), 20, seed, span), tolerance, method, locked)


@pytest.mark.parametrize("kind", sorted(KINDS))
def test_every_kind_of_table_has_the_numbers_of_numpy_at_random_wrenches(kind):
    assert_same(kind, asked_of(table_of(kind), 400))


@pytest.mark.parametrize("kind", sorted(KINDS))
def test_wrenches_of_few_loads_and_of_rows_have_the_numbers_of_numpy(kind):
    """Between two simplices either may answer, each with its own coverage.

    So may the hull and what is 1e-8 beyond it: scipy takes more of that than DESIGN's 1e-9.
    """
    table, asked = table_of(kind), special_of(table_of(kind), 120)
    outputs, errors, coverage = by_numpy(table, asked)
    found = packed_of(kind).batch(asked)
    near = SAME * size_of(table) + rounding_of(table) + SAME * np.nan_to_num(np.abs(outputs))
    same = found.coverage == coverage
    assert same.mean() > 0.95
    assert (np.nan_to_num(np.abs(found.outputs - outputs))[same] <= near[same]).all()
    known = np.nan_to_num(errors)
    lost = SQUARED * deviation_of(table) ** 2 / np.fmax(known, near)
    loose = near + SIGMA_AT_ROWS * known + lost
    assert (np.nan_to_num(np.abs(found.errors - errors))[same] <= loose[same]).all()


def test_both_take_the_same_of_equally_near_rows():
    x = np.concatenate((np.eye(6), -np.eye(6), np.zeros((1, 6)), full_wrenches(12, 4)))
    table = build(solved(RESPONSES["strongly_coupled"], x), responses.RANGE)
    packed = PackedTable.from_bytes(b"".join(pack(table)))
    own = table.rows.wrench
    asked = np.array([(own[i] + own[j]) / 2 for i in range(12) for j in range(i)])
    expected = table.batch(asked, method="kriging").error
    assert np.isfinite(expected).all(axis=1).mean() > 0.5
    found = packed.batch(asked, None, "kriging").errors
    np.testing.assert_allclose(found, expected, rtol=1e-4)


STEP = 3e-5  # of the load range: central differences then err by up to 1e-6 of a slope
FLAT = "one axis", "one force", "oblique line", "planar"  # their axes have fewer than 3 dimensions


@pytest.mark.parametrize("kind", sorted(set(KINDS) - {"empty", "only beyond the range"}))
@pytest.mark.parametrize("method", METHODS)
def test_derivatives_are_differences_of_values(kind, method):
    """Of wrenches in the hulls of the axes: beyond them slopes are those along the hull."""
    table, packed = table_of(kind), packed_of(kind)
    by_axes, asked = packed.answers_by(method) in BY_AXES, asked_of(table, 60, span=0.9)
    if by_axes and kind in FLAT:
        shares = np.random.default_rng(4).dirichlet(np.ones(len(table.rows)), 60)
        asked = shares @ table.rows.wrench
    here = packed.batch(asked, None, method, without_rows=True)
    scale = table.load_range.scale
    found = packed.derivatives(asked, None, method, without_rows=True) * scale
    size = np.fmax(size_of(table), np.nanmax(np.abs(found), axis=2, initial=0.0))
    limit = size * 1e-6 + rounding_of(table) / STEP
    for load, step in enumerate(STEP * np.diag(scale)):
        ahead, behind = (
            packed.batch(asked + sign * step, None, method, without_rows=True).outputs
            for sign in (1, -1)
        )
        slope, bend = (ahead - behind) / (2 * STEP), (ahead + behind - 2 * here.outputs) / STEP
        apart = np.abs(found[:, :, load] - slope)
        known = np.isfinite(apart)
        if by_axes:  # a kink between two simplices is no slope
            known &= (np.abs(bend) <= limit) & (here.coverage < 2)[:, None]
        assert known.any() or by_axes or not np.ptp(table.rows.wrench[:, load])
        assert (apart <= limit)[known].all()


@pytest.mark.parametrize("kind", sorted(KINDS))
def test_replies_have_the_words_rows_and_judgements_of_the_numpy_law(kind):
    table, packed = table_of(kind), packed_of(kind)
    asked = np.concatenate((asked_of(table, 40, span=1.2), table.rows.wrench[:10]))
    for wrench in asked.tolist():
        expected, found = table.answer(wrench), packed.answer(wrench)
        assert found.coverage == expected.coverage
        assert found.missing == expected.missing
        if expected.displacement is None or found.outputs is not None:
            assert found.reason == expected.reason
            assert found.method == expected.method
        if found.method == "row":
            assert found.source == table.source_of(wrench)
            assert found.exact == table.has_row(wrench)
            assert (table.rows.wrench[table.rows.seq == found.row] == wrench).all() or (
                not found.exact
            )


def test_the_reason_tells_the_rows_of_every_group_of_outputs_that_is_off_its_rows():
    """The kernel told those of the first group alone."""
    wrenches = clean(12)
    told = moved(wrenches)
    told[::2, 2] = np.nan
    told[::3, 4] = np.nan
    table = build(Rows.of(wrenches, told), RANGE)
    packed = PackedTable.from_bytes(b"".join(pack(table)))
    spans = set()
    for wrench in asked_of(table, 40).tolist():
        found = packed.answer(wrench, None, "griddata").reason
        assert found == table.answer(wrench, None, "griddata").reason
        spans |= set(re.findall(r"axis x: [^;]*", found)) if "lies outside" in found else set()
    assert len(spans) > 40


def test_without_a_kriging_the_method_that_answers_for_it_is_told():
    """The numpy law said `kriging`, which the table has not."""
    table, packed = table_of("one row"), packed_of("one row")
    found, law = (one.answer([1.0] * 6, None, "kriging") for one in (packed, table))
    assert (found.method, law.method) == ("additive", "additive")


@pytest.mark.parametrize("kind", ["solved", "linear", "softening", "partial", "clean"])
def test_whole_errors_are_judged_by_the_tolerance(kind):
    table, asked = table_of(kind), asked_of(table_of(kind), 60)
    errors = by_numpy(table, asked)[1]
    # No answer has just this error, which rounding would judge.
    known = np.where(np.isnan(errors), 0.0, errors).reshape(-1, 2, 3)
    translation, rotation = 1e-12 + 1.0001 * np.quantile(known, 0.7, axis=(0, 2))
    tolerance = Tolerance(translation, rotation)
    errors = by_numpy(table, asked, tolerance)[1]
    expected = within_tolerance_many(errors, tolerance)
    if not table.bars_are_complete:
        expected = [None] * len(asked)
    found = [packed_of(kind).answer(w, six(tolerance)).within_tolerance for w in asked.tolist()]
    assert found == expected


def test_the_parts_of_an_error_are_those_of_the_solver():
    table, packed = table_of("linear"), packed_of("linear")
    for wrench in asked_of(table, 5).tolist():
        found, shares = packed.answer(wrench), table.solver_error.parts(wrench)
        np.testing.assert_allclose(found.discretisation, shares["mesh"], rtol=1e-13)
        np.testing.assert_allclose(found.linearity, shares["linearity"], rtol=1e-13)
        total = np.add(found.interpolation, np.add(found.discretisation, found.linearity))
        np.testing.assert_allclose(found.error, total, rtol=1e-13)
    unknown = packed_of("solved").answer(asked_of(table_of("solved"), 1)[0].tolist())
    assert unknown.discretisation is None
    assert unknown.error == unknown.interpolation
    told = packed_of("clean").answer([1.0] * 6)
    assert told.discretisation == (0.0,) * 6


@pytest.mark.parametrize("kind", sorted(set(KINDS) - {"empty", "only beyond the range"}))
def test_the_detail_of_an_answer_is_that_of_the_numpy_law(kind):
    table, packed = table_of(kind), packed_of(kind)
    for wrench in asked_of(table, 12, span=1.05).tolist():
        expected, found = table.explain(wrench), explain(packed, wrench)
        assert len(found) == len(expected)
        for one, other in zip(found, expected, strict=True):
            for key in ("axis", "inputs", "coverage", "reason"):
                assert one[key] == other[key], key
            if one["coverage"] != "outside":  # there two facets of a hull may be as near
                assert one["rows"] == other["rows"]
            for key in ("outputs", "error"):
                assert (one[key] is None) == (other[key] is None)
                if one[key] is not None:
                    assert list(one[key]) == list(other[key])
                    values = list(other[key].values())
                    np.testing.assert_allclose(
                        list(one[key].values()), values, rtol=1e-9, atol=1e-18
                    )


def test_a_table_of_partial_outputs_names_those_that_no_row_holds():
    table, packed = table_of("partial"), packed_of("partial")
    assert table.rows.partial
    found = packed.answer([1.0] * 6)
    assert found.missing == ("ry",)
    assert found.outputs[OUTPUTS.index("ry")] is None
    assert "not measured in any row: ry" in found.reason


def test_estimates_beyond_the_limits_of_tables_are_not_given():
    asked = asked_of(table_of("huge"), 300, span=4.0)
    found = packed_of("huge").batch(asked)
    gone = np.isnan(found.outputs).all(axis=1)
    assert gone.any()
    assert not gone.all()
    assert (found.coverage[gone] > 0).all()
    reply = packed_of("huge").answer(asked[gone][0].tolist())
    assert reply.outputs is None
    assert "20 degrees" in reply.reason
    assert reply.within_tolerance is None
    assert np.nanmax(np.linalg.norm(found.outputs[:, 3:], axis=1)) <= math.radians(20.0)


@pytest.mark.parametrize("locked", LOCKED[1:])
def test_loads_on_locked_freedoms_change_nothing(locked):
    asked = asked_of(table_of("solved"), 50)
    other = asked.copy()
    other[:, list(locked)] *= -3.0
    packed = packed_of("solved", locked)
    for one, two in zip(packed.batch(asked), packed.batch(other), strict=True):
        np.testing.assert_array_equal(one, two)
    assert packed.answer(asked[0].tolist()) == packed.answer(other[0].tolist())
