"""A part as springs, linear about one wrench, for simulators that cannot read a table."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING, Self

import numpy as np
from numpy.typing import ArrayLike

from wrenchbook.surrogate.answer import COVERED
from wrenchbook.surrogate.table.rows import SOLVED

from ...contract import LOAD_UNITS, LOADS, OUTPUTS
from ..errors import Document, InvalidArgument
from ..wrenches import Vector, floats_of
from .joint import FREEDOMS, further_inputs, moving

if TYPE_CHECKING:
    from ..table import Table


@dataclass(frozen=True)
class LinearPart:
    """A part's stiffness about one wrench, for simulators that have springs but no table.

    Attributes
    ----------
    component : str
        Name of the component.
    table_version : int
        Version of the table that the part was made from.
    freedoms : tuple of str
        The n freedoms that the part does not lock, of ``ux`` to ``rz``.
    stiffness : list of lists
        Shape (n, n), N/m to N·m/rad, symmetric: the derivative of the wrench on the interface by
        its displacement, in the undeformed interface frame.
    wrench, displacement : list of float
        Shape (n,): the load about which the part is linear, N and N·m, and its displacement, m and
        rad.
    largest_error, rms_error : list of float
        Shape (n,), m and rad: the difference from the table, over its load range.
    largest_displacement : list of float
        Shape (n,), m and rad: the table's, for the same wrenches.
    covered : float
        The fraction of these wrenches that the table covers; the others compare with estimates.
    """

    component: str
    table_version: int
    freedoms: tuple[str, ...]
    stiffness: list[list[float]]
    wrench: list[float]
    displacement: list[float]
    largest_error: list[float]
    rms_error: list[float]
    largest_displacement: list[float]
    covered: float

    @classmethod
    def of(
        cls,
        table: Table,
        wrench: ArrayLike | None = None,
        inputs: Mapping[str, float] | None = None,
    ) -> Self:
        """Return a table's part, linear about a wrench, shape (6,), N and N·m; at no load if None.

        `inputs` are those of the table that are no loads, by name, as `Joint` takes them.

        Raises
        ------
        InvalidArgument
            If the part moves at several interfaces or at none; if the wrench is not 6 finite
            numbers within the load range; if a further input is unknown, missing or beyond its
            range; if the table's derivative there is not known or not that of springs.
        """
        at, free, _ = moving(table, None, several=False)
        packed = table.packed
        indices = at[free]  # of the table's loads and outputs

        load = floats_of("wrench", np.zeros(FREEDOMS) if wrench is None else wrench, (FREEDOMS,))
        further = further_inputs(table, inputs or {})
        centre = np.concatenate([np.zeros(packed.inputs - len(further)), further])
        centre[at] = load
        for k, low, high in zip(free, *packed.load_range[:, indices], strict=True):
            if not low <= load[k] <= high:
                raise InvalidArgument(
                    f"{table.name}: {LOADS[k]} of wrench must be within the load range, "
                    f"{low:g} to {high:g} {LOAD_UNITS[k]}, not {load[k]:g}"
                )
        slope = packed.derivative(centre.tolist())[np.ix_(indices, indices)]
        compliance = 0.5 * (slope + slope.T)  # springs store energy: no antisymmetric part
        _require_springs(table, compliance)

        loads = packed.sample(centre, indices)
        answers = packed.batch(np.vstack([centre, loads]))
        moved = answers.outputs[1:, indices]
        at_centre = answers.outputs[0, indices]
        deviations = moved - at_centre - (loads - centre)[:, indices] @ compliance
        return cls(
            component=table.name,
            table_version=table.version,
            freedoms=tuple(OUTPUTS[k] for k in free),
            stiffness=np.linalg.inv(compliance).tolist(),
            wrench=centre[indices].tolist(),
            displacement=at_centre.tolist(),
            largest_error=np.abs(deviations).max(axis=0).tolist(),
            rms_error=np.sqrt((deviations**2).mean(axis=0)).tolist(),
            largest_displacement=np.abs(moved).max(axis=0).tolist(),
            covered=float((np.asarray(answers.coverage[1:]) == COVERED).mean()),
        )

    @property
    def unloaded(self) -> Vector:
        """The displacement at which the springs carry nothing, shape (n,), m and rad."""
        deflection = np.linalg.solve(np.array(self.stiffness), np.array(self.wrench))
        return np.asarray(np.array(self.displacement) - deflection, dtype=float)

    @property
    def error(self) -> str:
        """The largest error of each displacement, in words."""
        percentages = [
            f"{name} {round(100.0 * error / largest, 3):g} %"
            for name, error, largest in zip(
                self.freedoms, self.largest_error, self.largest_displacement, strict=True
            )
            if largest > 0.0
        ]
        return (
            f"{self.component} as springs is wrong by up to "
            f"{', '.join(percentages) or 'unknown'} of the largest displacement in the load range; "
            f"the table covers {self.covered:.0%} of the wrenches compared"
        )

    def to_dict(self, mass: ArrayLike | None = None) -> Document:
        """Return the part as a dict of plain numbers, with units and the condensed mass.

        Parameters
        ----------
        mass : array_like, optional
            Shape (6, 6), kg to kg·m^2; null in the dict where it is not known.
        """
        chosen = [OUTPUTS.index(name) for name in self.freedoms]
        condensed = None if mass is None else np.asarray(mass, dtype=float)[np.ix_(chosen, chosen)]
        return {
            **asdict(self),
            "loads": [LOADS[k] for k in chosen],
            "mass": None if condensed is None else condensed.tolist(),
            "units": "N, N·m, m, rad, kg",
            "frame": "the undeformed interface frame, about the interface point",
        }


def _require_springs(table: Table, compliance: Vector) -> None:
    """Raise InvalidArgument unless a compliance (n, n), SI, is known and positive definite."""
    smallest = 0.0
    cause = "its derivative is unknown"
    if np.isfinite(compliance).all():
        smallest = float(np.linalg.eigvalsh(compliance)[0])
        cause = f"its compliance is not positive definite (smallest eigenvalue {smallest:.3g})"
    if smallest <= 0.0:
        is_solved = SOLVED in table.packed.meta.get("provenance", {}).get("sources", {SOLVED: 1})
        more = (
            f"run wrenchbook fill {table.name} --for-joint"
            if is_solved
            else f"correct rows with findings first (wrenchbook withdraw {table.name}), measure "
            "more rows"
        )
        raise InvalidArgument(
            f"{table.name} has no stiffness at this load, because {cause}; {more}, or give another "
            "load"
        )
