"""`--ulp`: the numbers of made-up rows and components, each one unit in the last place off or not.

Another BLAS, compiler or processor changes results by no more than that. A number moves by its own
row, column and seed alone, so that a row that is made twice is the same row, in any order of
tests and on any worker. Zeros and what is not a number stay.
"""

from __future__ import annotations

import sys
from dataclasses import fields, replace
from typing import Any

import numpy as np

from wrenchbook.fea.component import ComponentModel
from wrenchbook.fea.spec.material import Material
from wrenchbook.surrogate.table.rows import Rows

NUMBERS = ("wrench", "displacement", "compliance", "curvature", "uncertainty")
AS_THEY_ARE = ("tests.service.ledger_rows", "tests.service.table_files")  # rows of others anew
CONSTANTS = ("youngs_modulus", "poisson_ratio", "density")


def _mixed(keys: np.ndarray) -> np.ndarray:
    """Scatter 64-bit keys (splitmix64, Steele et al. 2014)."""
    keys = (keys ^ (keys >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
    keys = (keys ^ (keys >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    return keys ^ (keys >> np.uint64(31))


def moved(numbers: np.ndarray, seed: int, rows: np.ndarray | None = None) -> np.ndarray:
    """Numbers (n, ...), each by one unit in the last place up, down or not at all.

    `rows` (n, k), by default the numbers, tells rows apart: the wrenches of displacements, so that
    an output that a table lacks changes none of the others.
    """
    flat = np.array(numbers, dtype=float).reshape(len(numbers), -1)
    keys = _keys(flat, seed)
    own = keys if rows is None else _keys(np.array(rows, dtype=float), seed)
    steps = _mixed(keys + np.bitwise_xor.reduce(own, axis=1, keepdims=True)) % np.uint64(3)
    still = ~np.isfinite(flat) | (np.abs(flat) < np.finfo(float).tiny)
    result = flat.view(np.int64) + np.where(still, 0, steps.astype(np.int64) - 1)
    return result.view(float).reshape(np.shape(numbers))


def _keys(flat: np.ndarray, seed: int) -> np.ndarray:
    columns = np.arange(1, flat.shape[1] + 1, dtype=np.uint64) * np.uint64(0x9E3779B97F4A7C15)
    return _mixed(flat.view(np.uint64) + columns + np.uint64(seed % 2**63))


class Mover:
    """Moves what tests make while `active`."""

    def __init__(self, seed: int) -> None:
        self.seed, self.active = seed, True

    def install(self) -> None:
        """Hook into the two constructors that all made-up rows and components pass."""
        created, begin = Rows.of.__func__, ComponentModel.__init__

        def of(cls: type[Rows], *arguments: Any, **columns: Any) -> Rows:
            rows = created(cls, *arguments, **columns)
            caller = sys._getframe(1).f_globals.get("__name__", "")
            made_up = caller.startswith("tests.") and caller not in AS_THEY_ARE
            if not self.active or not made_up:
                return rows  # rows of a file or a ledger
            known = {name: getattr(rows, name) for name in NUMBERS}
            return replace(
                rows,
                **{
                    name: moved(column, self.seed, rows.wrench)
                    for name, column in known.items()
                    if column.size and any(column.strides)  # a column of no numbers takes no memory
                },
            )

        def init(model: ComponentModel, *arguments: Any, **more: Any) -> None:
            begin(model, *arguments, **more)
            if self.active:
                mesh = replace(model.mesh, points=moved(model.mesh.points, self.seed))
                materials = tuple(self._material(material) for material in model.materials)
                object.__setattr__(model, "mesh", mesh)
                object.__setattr__(model, "materials", materials)

        Rows.of = classmethod(of)  # type: ignore[method-assign, assignment]
        ComponentModel.__init__ = init  # type: ignore[method-assign]

    def _material(self, material: Material) -> Material:
        names = {field.name for field in fields(material)} & {*CONSTANTS}
        constants = {name: getattr(material, name) for name in CONSTANTS if name in names}
        known = {name: value for name, value in constants.items() if value is not None}
        if not known:
            return material
        numbers = moved(np.array([list(known.values())]), self.seed)[0].tolist()
        return replace(material, **dict(zip(known, numbers, strict=True)))
