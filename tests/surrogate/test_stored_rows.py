"""The rows that tests read from a file are those of the shipped component."""

import numpy as np

from tests.surrogate.tables.write import COMPONENTS, HERE
from wrenchbook.fea.bundle.read import read_bundle
from wrenchbook.fea.solve import Solver


def test_a_stored_row_of_plate_thin_is_what_the_shipped_mesh_solves() -> None:
    """Else write the rows anew: `python -m tests.surrogate.tables.write plate_thin`."""
    with np.load(HERE / "plate_thin.npz") as file:
        wrench, displacement = file["wrench"], file["displacement"]
    bundle = read_bundle(COMPONENTS / "plate_thin")
    row = len(wrench) // 2
    solved = Solver(bundle).solve(wrench[row]).displacement
    error = np.abs(solved - displacement[row]) / np.ptp(displacement, axis=0)
    assert error.max() < 1e-6
