"""An FMU answers from the packed table by the kernel: its numbers are the table's, bit by bit."""

import numpy as np
import pytest

from tests.service.fmu.made import answers, judged, opened, packed, slopes, solved, wrenches_of
from tests.surrogate.kernel.kinds import KINDS, asked_of, special_of, table_of
from wrenchbook.surrogate.answer import six
from wrenchbook.surrogate.table.rows import Tolerance

TABLES = sorted(set(KINDS) - {"empty", "only beyond the range"})


def assert_same(table, folder, asked, method=None, tolerance=None):
    """Compare an FMU's numbers and judgements with those of the packed table."""
    limits = (tolerance.translation, tolerance.rotation) if tolerance else (0.0, 0.0)
    with opened(table, folder, method).running(tolerance=limits) as instance:
        outputs, errors, coverage = answers(instance, asked)
        within, derivatives = judged(instance, asked[:40]), slopes(instance, asked[:20])
    one = packed(table)
    expected = one.batch(asked, six(tolerance), method)
    for found, own in zip((outputs, errors, coverage), expected, strict=True):
        np.testing.assert_array_equal(found, own)
    replies = [one.answer(wrench, six(tolerance), method) for wrench in asked[:40].tolist()]
    assert within == [reply.within_tolerance for reply in replies]
    own = one.derivatives(asked[:20], six(tolerance), method)
    np.testing.assert_array_equal(derivatives, own)


@pytest.mark.parametrize("kind", TABLES)
def test_an_fmu_has_the_bits_of_its_table(tmp_path, kind):
    table = table_of(kind)
    assert_same(table, tmp_path, np.concatenate((asked_of(table, 200), special_of(table, 60))))


@pytest.mark.parametrize("method", ["griddata", "additive", "kriging", "linear"])
def test_every_method_has_the_bits_of_the_table(tmp_path, method):
    table = table_of("solved")
    assert_same(table, tmp_path, asked_of(table, 200), method)


@pytest.mark.parametrize("size", [1e-9, 1e-5, 1e-1])
def test_a_tolerance_of_the_user_decides_what_is_covered(tmp_path, size):
    table = table_of("solved with a tolerance")
    assert_same(table, tmp_path, asked_of(table, 200), tolerance=Tolerance(size, 10 * size))


def test_ten_thousand_random_wrenches_have_the_bits_of_the_table(tmp_path):
    table = table_of("solved")
    assert_same(table, tmp_path, asked_of(table, 10_000))


def test_loads_on_locked_freedoms_change_nothing_in_an_fmu_either(tmp_path):
    table = table_of("solved", (1, 5))
    assert_same(table, tmp_path, asked_of(table, 50))


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
    asked, step = wrenches_of(table, 1, 0.5)[0], 1e-4 * table.load_range.scale
    low, high = packed(table).batch([asked - step, asked + step]).errors
    with opened(table, tmp_path).running() as instance:
        instance.setReal(list(range(6)), asked)
        found = instance.getDirectionalDerivative(list(range(12, 18)), list(range(6)), step)
    np.testing.assert_allclose(found, (high - low) / 2, rtol=1e-2)
