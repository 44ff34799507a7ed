"""An HDF5 file that version 0.2 wrote is read, and answers as it did then.

A smooth table of 20 solves; the answers are those of the program that wrote it, the commit before
77a621e5. On one machine they are equal to the last bit; another compiler or BLAS may round
otherwise.
"""

from pathlib import Path

import numpy as np
import pytest

from wrenchbook.surrogate.build import build
from wrenchbook.surrogate.packed.writer import packed_of
from wrenchbook.surrogate.table.hdf5 import read_table

FOLDER = Path(__file__).parent / "tables/version_0_2"


@pytest.fixture(scope="module")
def then():
    with np.load(FOLDER / "answers.npz") as file:
        return dict(file)


def test_an_hdf5_table_answers_as_it_did(then):
    rows, meta = read_table(FOLDER / "table.h5")
    assert meta.load_range.space.is_default
    table = build(rows, meta.load_range, tolerance=meta.tolerance, linear=False)
    found = packed_of(table).batch(then["wrenches"]).outputs
    # At no load the kriging answers too, and its sum has rounding errors.
    rounding = 1e-12 * np.abs(then["kriging"]).max()
    np.testing.assert_allclose(found, then["kriging"], rtol=1e-9, atol=rounding)
