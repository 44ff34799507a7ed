"""The default method of a table."""

from types import SimpleNamespace
from typing import Any, cast

import numpy as np

from wrenchbook.surrogate.build import choose
from wrenchbook.surrogate.table.rows import LoadRange, Rows

ERROR = 0.1  # m and rad, of every left-out row


def test_the_error_at_left_out_rows_is_over_the_range_of_outputs_with_empty_cells_too():
    """An output with one empty cell counted as one that does not vary, so the error was 0."""
    rng = np.random.default_rng(8)
    displacement = rng.uniform(-1.0, 1.0, (12, 6))
    widths = np.ptp(displacement[6:], axis=0)
    displacement[:6] = displacement[6:]
    displacement[range(6), range(6)] = np.nan
    rows = Rows.of(rng.uniform(-1.0, 1.0, (12, 6)), displacement)
    kriging = SimpleNamespace(
        scaling=SimpleNamespace(constant=np.zeros(6, dtype=bool)),
        left_out=lambda: np.full((12, 6), ERROR),
    )
    fit = SimpleNamespace(complete=False)
    choice = choose(
        rows, LoadRange(-np.ones(6), np.ones(6)), cast("Any", fit), lambda: cast("Any", kriging)
    )
    expected = np.sqrt(np.mean((ERROR / widths) ** 2))
    assert np.isclose(choice.errors["kriging"], expected, rtol=1e-12)
