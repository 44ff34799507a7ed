"""Which rows are nearest to some wrench of a box."""

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from wrenchbook.surrogate.scene.cut import nearest_anywhere


@settings(max_examples=30)
@given(seed=st.integers(0, 10_000), held=st.integers(0, 5), count=st.integers(1, 60))
def test_every_row_that_is_nearest_somewhere_is_kept(seed: int, held: int, count: int) -> None:
    rng = np.random.default_rng(seed)
    points, rates = rng.uniform(-1, 1, (count, 6)), np.exp(rng.uniform(-7, 4, 6))
    ends = np.sort(rng.uniform(-1, 1, (2, 6)), axis=0)
    ends[1, :held] = ends[0, :held]
    kept = nearest_anywhere(points, rates, ends[0], ends[1])
    at = rng.uniform(ends[0], ends[1], (3000, 6))
    near = ((at[:, None] - points[None]) ** 2 @ rates).argmin(axis=1)
    assert kept[near].all()


def test_a_row_that_is_nowhere_nearest_is_left_out() -> None:
    points = np.zeros((3, 6))
    points[:, 0] = [-0.1, 0.1, 0.0]
    points[1, 1] = points[0, 1] = 1.0  # far from the line that the box is
    box = np.array([0.05, 0, 0, 0, 0, 0.0])
    np.testing.assert_array_equal(
        nearest_anywhere(points, np.ones(6), -box, box), [False, False, True]
    )
