"""Off the hull, where the rows do not tell how long the step from it is: nothing tells the bar."""

import numpy as np
import pytest

from surrogate.composition.composition import OFF_HULL
from surrogate.table.rows import Rows
from tests.surrogate.law import build
from tests.surrogate.responses import HIGH, RANGE, full_wrenches, smooth


def _one_axis():
    """A table of F_z, M_x and M_y: what other loads do is not known."""
    places = np.zeros((27, 6))
    places[:, [2, 3, 4]] = np.array(list(np.ndindex(3, 3, 3))) - 1.0
    rows = np.concatenate((places, full_wrenches(24, 5) * np.array([0, 0, 1, 1, 1, 0])))
    return build(Rows.of(rows * HIGH, smooth(rows)), RANGE)


@pytest.mark.parametrize("method", ["griddata", "additive", "tangent"])
def test_a_step_of_unknown_length_makes_the_error_bar_unknown(method: str) -> None:
    table, asked = _one_axis(), 1.1 * full_wrenches(40, 6) * HIGH
    found = table.batch(asked, None, method)
    singles = [table.answer(wrench, None, method).error for wrench in asked]
    unknown = np.isnan(table.composition.evaluate(asked).rest).any(axis=1)
    assert (table.composition.evaluate(asked).state[unknown] >= OFF_HULL).all()
    assert unknown.any()
    assert np.isnan(found.error[unknown]).all()
    assert all(singles[place] is None for place in np.flatnonzero(unknown))
