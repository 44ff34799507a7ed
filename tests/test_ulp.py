"""What `--ulp` does to numbers."""

import numpy as np

from tests.ulp import moved

NUMBERS = np.random.default_rng(1).normal(size=(60, 6))
NUMBERS[0, :3], NUMBERS[1, 2] = 0.0, np.nan


def test_each_number_moves_by_at_most_one_unit_in_the_last_place_and_zero_stays():
    result = moved(NUMBERS, 3)
    steps = np.nan_to_num(result - NUMBERS) / np.spacing(np.abs(np.nan_to_num(NUMBERS)))
    assert np.abs(steps).max() == 1
    assert not steps[0, :3].any()
    assert np.isnan(result[1, 2])


def test_numbers_move_up_down_and_not_at_all_about_as_often():
    up = (moved(NUMBERS, 3) > NUMBERS)[2:].mean()
    down = (moved(NUMBERS, 3) < NUMBERS)[2:].mean()
    assert 0.25 < up < 0.42
    assert 0.25 < down < 0.42


def test_a_row_that_is_made_again_alone_or_in_another_order_is_the_same():
    order = np.random.default_rng(2).permutation(len(NUMBERS))
    np.testing.assert_array_equal(moved(NUMBERS[order], 3), moved(NUMBERS, 3)[order])
    np.testing.assert_array_equal(moved(NUMBERS[:1], 3), moved(NUMBERS, 3)[:1])
    assert (moved(NUMBERS, 4) != moved(NUMBERS, 3)).mean() > 0.5
