"""Real rows: the thin plate's solves, asked at wrenches that are not among them."""

from pathlib import Path

import numpy as np
import pytest

from wrenchbook.surrogate.kriging import Kriging
from wrenchbook.surrogate.table.rows import LoadRange, Rows

TABLE = Path(__file__).parents[1] / "tables" / "plate_thin.npz"
CLEAN = 168  # rows of one axis come first in the file, then those of six loads
SOLVED = 248  # rows with a compliance; the rest is asked


def _held_against_truth(chosen: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return RMS over range, share inside the bars, and median bar over median error, each (6,)."""
    with np.load(TABLE) as file:
        columns = {name: file[name] for name in file.files}
    rows = Rows.of(
        columns["wrench"][chosen],
        columns["displacement"][chosen],
        compliance=columns["compliance"][chosen].astype(float),
    )
    kriging = Kriging.build(rows, LoadRange(columns["low"], columns["high"]))
    asked, true = columns["wrench"][SOLVED:], columns["displacement"][SOLVED:]
    displacement, bar = kriging.answer_many(asked)
    error = np.abs(displacement - true)
    rms = np.sqrt((error**2).mean(axis=0)) / np.ptp(true, axis=0)
    known = np.isfinite(bar).all(axis=1)
    assert known.mean() >= 0.75  # elsewhere wrenches are further from the rows than any row is
    error, bar = error[known], bar[known]
    return rms, (error <= bar).mean(axis=0), np.median(bar, axis=0) / np.median(error, axis=0)


@pytest.mark.parametrize(("full", "worst"), [(15, 0.003), (30, 0.0015), (60, 0.0008)])
def test_full_wrenches_alone_answer_to_a_tenth_of_a_percent(full: int, worst: float) -> None:
    rms, _, ratio = _held_against_truth(np.arange(CLEAN, CLEAN + full))
    assert rms.max() < worst
    assert np.median(ratio) <= 8


@pytest.mark.parametrize("full", [15, 30, 60])
def test_bars_of_full_wrenches_alone_hold_nine_errors_of_ten(full: int) -> None:
    """Of three tables together: 73 wrenches tell one table's share to a thirtieth."""
    first = [CLEAN, CLEAN + 10, CLEAN + 20]
    inside = [_held_against_truth(np.arange(one, one + full))[1] for one in first]
    assert np.mean(inside, axis=0).min() >= 0.9


def test_clean_rows_and_full_ones_answer_to_a_tenth_of_a_percent() -> None:
    clean = np.random.default_rng(0).permutation(CLEAN)[:40]
    rms, inside, ratio = _held_against_truth(np.append(clean, np.arange(CLEAN, SOLVED)))
    assert rms.max() < 0.0008
    assert inside.min() >= 0.9
    assert np.median(ratio) <= 8
