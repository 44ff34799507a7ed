"""An FMU answers what the table does: every method, every kind of table, held or not.

To 1e-12 in m and rad, as bars and displacements are, and of the outputs' ranges. A kriging's
weights may be 1e8 times what they sum to, so that sums in another order differ in the eighth digit:
the C has the order of the compiled Python, and by the same exponential gives the same digits.
"""

import numpy as np
import pytest

from surrogate.answer import within_tolerance_many
from surrogate.build import build
from surrogate.derivative import derivatives_at
from surrogate.solver_error import SolverError
from surrogate.table.rows import LoadRange, Rows, Tolerance
from surrogate.whole_bars import whole_bars
from tests.service.fmu.made import answers, judged, opened, slopes, solved, special, wrenches_of
from tests.service.live import FULL, clean_wrenches, full_wrenches, moved, tangents
from tests.surrogate.softening import SOFT, column, softening_table

RANGE = LoadRange(-FULL, FULL)
SAME = 1e-12  # m and rad


def grid(loads, count):
    """A regular grid over some loads, the others zero."""
    places = np.array(list(np.ndindex(*(count,) * len(loads)))) * 2 / (count - 1) - 1
    wrenches = np.zeros((len(places), 6))
    wrenches[:, loads] = places
    return wrenches * FULL


def measured(wrenches, **columns):
    return build(Rows.of(wrenches, moved(wrenches), **columns), RANGE)


def linear(count):
    compliance = np.random.default_rng(3).normal(size=(6, 6)) * 1e-6
    loads = np.eye(6)[:count] * FULL
    return build(Rows.of(loads, loads @ compliance.T), RANGE, linear=True)


def partial():
    """A rig that measured r_y never, and u_z in some rows only; r_x too, on a line of F_z alone."""
    wrenches = np.concatenate((clean_wrenches(), full_wrenches(24)))
    told = moved(wrenches)
    told[:, 4], told[30:, 2] = np.nan, np.nan
    return build(Rows.of(wrenches, told), RANGE)


def compare(table, folder, asked, method=None, tolerance=None):
    """Hold an FMU's numbers against the table's; return the greatest differences over ranges."""
    made = opened(table, folder, method)
    limits = (tolerance.translation, tolerance.rotation) if tolerance else (0.0, 0.0)
    with made.running(tolerance=limits) as instance:
        displacement, bars, coverage = answers(instance, asked)
        told = slopes(instance, asked[:40])
    expected = table.batch(asked, tolerance, method)
    np.testing.assert_array_equal(coverage, expected.coverage)
    np.testing.assert_allclose(displacement, expected.displacement, rtol=0, atol=SAME)
    np.testing.assert_allclose(bars, expected.error, rtol=0, atol=SAME)
    derivatives = derivatives_at(table, asked[:40], tolerance, method)
    size = np.nanmax(np.abs(table.rows.displacement), axis=0, initial=0.0)
    size = np.where(size > 0, size, 1.0)
    scaled = (told - derivatives) * table.load_range.scale / size[:, None]
    np.testing.assert_array_equal(np.isnan(told), np.isnan(derivatives))
    assert np.nanmax(np.abs(scaled), initial=0.0) < SAME
    return np.nanmax(np.abs(displacement - expected.displacement) / size, initial=0.0)


def test_the_solvers_own_share_is_in_the_bars_of_an_fmu_too(tmp_path):
    table, asked = linear(6), full_wrenches(50)
    bends = [1e-5] * 3 + [1e-4] * 3
    mesh = np.abs(np.random.default_rng(4).normal(size=(6, 6))) * 1e-7
    told = {"mesh": mesh.tolist(), "linearity": bends, "loads": FULL.tolist()}
    table.solver_error = SolverError(told)
    with opened(table, tmp_path).running() as instance:
        _, bars, _ = answers(instance, asked)
    expected = table.solver_error.widened_many(table.batch(asked).error, asked)
    np.testing.assert_allclose(bars, expected, rtol=1e-12)
    assert (bars > 1e-7).all()


def test_an_fmu_has_the_meshs_share_where_a_part_softens_and_of_a_row_beyond_the_range(tmp_path):
    table = softening_table()
    assert table.solver_error.asks_tangent
    asked = np.concatenate((column([0.05, 0.33, 0.62, 0.8]).wrench, table.rows.wrench[:3]))
    with opened(table, tmp_path).running() as instance:
        _, bars, _ = answers(instance, asked)
    np.testing.assert_allclose(bars, whole_bars(table, asked, table.batch(asked)), rtol=1e-9)
    span = LoadRange(-0.3 * np.ones(6), np.ones(6))
    told = SolverError(SOFT | {"loads": [0.3, 1.0, 0.01, 1.0, 1.0, 1.0]})
    table = build(column([0.0, 0.1, 0.2, 0.8]), span, solver_error=told)
    asked = table.rows.wrench
    (tmp_path / "beyond").mkdir()
    with opened(table, tmp_path / "beyond").running() as instance:
        _, bars, _ = answers(instance, asked)
    np.testing.assert_allclose(bars, whole_bars(table, asked, table.batch(asked)), rtol=1e-9)


@pytest.mark.parametrize("own", [None, 0.5])
@pytest.mark.parametrize("asked_for", [None, 0.3])
def test_an_fmu_says_as_the_table_does_whether_whole_bars_are_within_the_tolerance(
    tmp_path, own, asked_for
):
    """Tolerances that so much of the bars meet, each of displacement and of rotation."""
    wrenches = np.concatenate((clean_wrenches(), full_wrenches(24)))
    rows, asked = Rows.of(wrenches, moved(wrenches)), full_wrenches(60)
    error = SolverError({"mesh": (1e-8 * np.eye(6)).tolist(), "loads": FULL.tolist()})
    bars = error.widened_many(build(rows, RANGE).batch(asked).error, asked)
    own, asked_for = (share and _met_by(bars, share) for share in (own, asked_for))
    table = build(rows, RANGE, tolerance=own, solver_error=error)
    expected = within_tolerance_many(bars, asked_for or own) or [None] * len(asked)
    limits = (asked_for.translation, asked_for.rotation) if asked_for else (0.0, 0.0)
    with opened(table, tmp_path).running(tolerance=limits) as instance:
        assert judged(instance, asked) == expected
    assert (own or asked_for) is None or set(expected) == {True, False}


def _met_by(bars, share):
    translation, rotation = np.quantile(bars.reshape(-1, 2, 3).max(axis=2), share, axis=0)
    return Tolerance(translation, rotation)


def test_an_fmu_of_rows_whose_solver_told_nothing_of_itself_does_not_judge_the_bar(tmp_path):
    wrenches = full_wrenches(40)
    rows = Rows.of(wrenches, moved(wrenches), source=["fea"] * len(wrenches))
    table = build(rows, RANGE, tolerance=Tolerance(1.0, 1.0))
    with opened(table, tmp_path).running() as instance:
        assert judged(instance, wrenches[:5]) == [None] * 5


def test_ten_thousand_random_wrenches_have_the_tables_numbers(tmp_path):
    table = solved("plate", 18, 20)
    assert table.default == "kriging"
    wrong = compare(table, tmp_path, wrenches_of(table, 10_000))
    assert wrong < SAME


def test_ten_thousand_random_wrenches_by_griddata_are_equal_relative_to_the_range(tmp_path):
    table = solved("plate_thin", 120, 20)
    wrong = compare(table, tmp_path, wrenches_of(table, 10_000), "griddata")
    assert wrong < SAME


@pytest.mark.parametrize("method", ["griddata", "kriging", "linear", "tangent"])
def test_every_method_has_the_tables_numbers_for_few_loads_and_beyond_the_range(tmp_path, method):
    table = solved("plate_thin", 60, 40, tolerance=Tolerance(1e-5, 1e-4))
    wrong = compare(table, tmp_path, special(table, 400), method)
    assert wrong < SAME


def test_a_smooth_response_whose_weights_are_huge_has_the_same_digits(tmp_path):
    pytest.importorskip("numba", reason="the arrays of numpy sum in an order of their own")
    wrenches = full_wrenches(30)
    rows = Rows.of(wrenches, moved(wrenches), compliance=tangents(wrenches))
    table = build(rows, RANGE)
    assert table.default == "kriging"
    assert np.abs(table.kriging.inside.weights).sum() > 1e7
    assert compare(table, tmp_path, wrenches_of(table, 400)) < SAME


def test_the_nearest_row_is_the_same_one(tmp_path):
    table = solved("plate_thin", 60, 40)
    assert compare(table, tmp_path, wrenches_of(table, 300, 1.2), "nearest") == 0.0


@pytest.mark.parametrize(
    "table",
    [
        pytest.param(lambda: measured(clean_wrenches()), id="clean rows, no tangents"),
        pytest.param(
            lambda: measured(np.concatenate((clean_wrenches(), full_wrenches(30)))),
            id="clean and full rows",
        ),
        pytest.param(lambda: measured(grid((2, 3), 5)), id="a planar table"),
        pytest.param(lambda: measured(grid((2,), 7)), id="a table of one force"),
        pytest.param(lambda: measured(grid((2, 3, 4), 3)), id="one axis, no rows in the others"),
        pytest.param(
            lambda: measured(np.outer(np.arange(-4, 5), [0, 0, 10, 0.5, 0, 0])),
            id="a line that is oblique",
        ),
        pytest.param(lambda: measured(grid((2, 3), 2)[:3] + 5.0), id="no row near zero load"),
        pytest.param(lambda: measured(np.array([[0.0, 0, 5, 0, 0, 0]])), id="one row"),
        pytest.param(lambda: measured(np.zeros((1, 6))), id="one row at no load"),
        pytest.param(
            lambda: measured(np.concatenate((clean_wrenches(), 3 * full_wrenches(5)))),
            id="rows beyond the range",
        ),
        pytest.param(partial, id="outputs that rows lack"),
        pytest.param(lambda: linear(6), id="a linear component"),
        pytest.param(lambda: linear(4), id="a linear component, two loads unknown"),
    ],
)
def test_every_kind_of_table_has_its_numbers(tmp_path, table):
    table = table()
    compare(table, tmp_path, special(table, 240))


def test_uncertain_rows_of_several_noise_levels_have_a_factor_each(tmp_path):
    wrenches = np.concatenate((clean_wrenches(), full_wrenches(30)))
    doubt = np.abs(np.random.default_rng(5).normal(size=(len(wrenches), 6)))
    doubt *= 1e-6 * np.array([1, 1, 1, 1, 1, 100])
    table = measured(wrenches, uncertainty=doubt)
    assert table.default == "kriging"
    assert len(table.kriging.inside.shares) > 1
    compare(table, tmp_path, special(table, 240))


def few(count):
    """Solved rows with tangents, too few to tell how large errors are."""
    wrenches = full_wrenches(count)
    return build(Rows.of(wrenches, moved(wrenches), compliance=tangents(wrenches)), RANGE)


@pytest.mark.parametrize(
    "make",
    [
        lambda: few(6),
        lambda: measured(full_wrenches(12)),
        lambda: measured(full_wrenches(5), uncertainty=np.full((5, 6), 1e-6)),
        partial,
    ],
    ids=["tangents", "measured", "uncertain", "partial"],
)
def test_at_rows_and_beside_them_an_fmu_says_what_the_table_says(tmp_path, make):
    table = make()
    inside = (np.abs(table.rows.wrench) < 0.99 * FULL).all(axis=1)
    rows = table.rows.wrench[inside][:6]
    step = np.random.default_rng(2).uniform(-1, 1, rows.shape) * FULL
    far = (0.0, 1e-15, 1e-12, 1e-9, 9e-7, 3e-6, 1e-3)
    asked = np.concatenate([rows + share * step for share in far])
    compare(table, tmp_path, asked)
    coverage = table.batch(asked).coverage.reshape(len(far), -1)
    assert (coverage[:5] == coverage[0]).all()
    assert coverage[-1].any()


def test_where_left_out_rows_tell_no_size_of_errors_an_fmu_covers_nothing_either(tmp_path):
    """It said `covered` where the table, and the server, said `thin`."""
    table = few(6)
    assert not table.doubt.size_known
    asked = full_wrenches(40)[-30:] * 0.7
    assert (table.batch(asked).coverage > 0).all()
    compare(table, tmp_path, asked)


def test_a_tolerance_of_the_user_decides_what_is_covered(tmp_path):
    table = solved("plate_thin", 60, 40)
    asked = wrenches_of(table, 200)
    strict = Tolerance(1e-9, 1e-8)
    assert (table.batch(asked, strict).coverage != table.batch(asked).coverage).any()
    compare(table, tmp_path, asked, tolerance=strict)


def test_a_directional_derivative_is_the_sum_along_a_direction(tmp_path):
    table = solved("plate_thin", 18, 20)
    asked = wrenches_of(table, 1)
    direction = np.arange(1.0, 7.0)
    with opened(table, tmp_path).running() as instance:
        whole = slopes(instance, asked)[0]
        along = instance.getDirectionalDerivative(list(range(6, 12)), list(range(6)), direction)
    np.testing.assert_allclose(along, whole @ direction, rtol=1e-13)


def test_error_bars_have_the_slope_that_they_differ_by(tmp_path):
    table = solved("plate_thin", 18, 20)
    asked, step = wrenches_of(table, 1)[0], 1e-4 * table.load_range.scale
    low, high = table.batch([asked - step, asked + step]).error
    with opened(table, tmp_path).running() as instance:
        instance.setReal(list(range(6)), asked)
        told = instance.getDirectionalDerivative(list(range(12, 18)), list(range(6)), step)
    np.testing.assert_allclose(told, (high - low) / 2, rtol=1e-2)
