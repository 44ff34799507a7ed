"""Reduced parts as files: arrays for Simscape, Nastran's DMIG and Abaqus's matrices."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from scipy.linalg import eigh
from scipy.spatial.transform import Rotation

from wrenchbook.fea.solver.reduction import CraigBampton

_NASTRAN = {"stiffness": "K", "mass": "M", "damping": "B"}  # matrices in the case control
_ABAQUS = {"stiffness": "STIFFNESS", "mass": "MASS", "damping": "VISCOUS DAMPING"}  # in an assembly
_RIGID_MOTIONS = 6  # motions of a free part: its lowest modes
_WIDTH = 16  # characters of a large field of Nastran


def arrays(part: CraigBampton, damping: float = 0.0) -> dict[str, Any]:
    """Return a part's fields, ``quaternions`` (f, 4), w first, of its frames, and ``damping``.

    damping: ratio of each elastic mode of the free part; 0 leaves the matrix (N·s/m) out. The
    matrix is the sum over modes of 2 damping omega p p^T, with p the mode's momentum, M times its
    shape of unit modal mass.
    """
    content: dict[str, Any] = dict(vars(part))
    content["quaternions"] = Rotation.from_matrix(part.rotations).as_quat(scalar_first=True)
    if damping:
        squares, motions = eigh(part.stiffness, part.mass)
        squares[:_RIGID_MOTIONS] = 0.0  # omega^2, rad^2/s^2
        momenta = part.mass @ motions * (2 * damping) ** 0.5 * squares**0.25
        content["damping"] = momenta @ momenta.T
    return content


def nastran(part: Mapping[str, Any], first: int) -> str:
    """Return bulk data GRID, SPOINT and DMIG; `first` is the number of the first frame's point."""
    names = {key: name for key, name in _NASTRAN.items() if key in part}
    control = ", ".join(f"{name}2GG = {name}AAX" for name in names.values())
    lines = [f"$ Reduced part, SI units. Case control: {control}"]
    rows = _rows(part, first, 0)
    for node, (name, point) in enumerate(zip(part["names"], part["origins"], strict=True), first):
        x, y, z = (_number(value).replace("D", "E") for value in point)
        lines += [f"$ {name}", f"GRID*   {node:>16}{'':16}{x}{y}", f"*       {z}"]
    lines.append(f"SPOINT  {first + len(part['names']):>8}THRU    {rows[-1][0]:>8}")
    for key, name in names.items():
        lines.append(f"DMIG    {name}AAX    {0:>8}{6:>8}{2:>8}{0:>8}")  # symmetric, in double
        for j, column in enumerate(part[key].T):
            lines.append("DMIG*   {}AAX{:12}{:>16}{:>16}".format(name, "", *rows[j]))
            for i in j + np.flatnonzero(column[j:]):
                lines.append("*       {:>16}{:>16}{}".format(*rows[i], _number(column[i])))
    return "\n".join(lines) + "\n"


def abaqus(part: Mapping[str, Any], first: int) -> str:
    """Return *NODE and *MATRIX; `first` is the number of the first frame's node."""
    rows = _rows(part, first, 1)
    keys = [key for key in _ABAQUS if key in part]
    points = {node: np.zeros(3) for node, _ in rows} | dict(enumerate(part["origins"], first))
    lines = ["** Reduced part, SI units", "*NODE"]
    lines += ["{}, {:.16e}, {:.16e}, {:.16e}".format(node, *at) for node, at in points.items()]
    for key in keys:
        lines.append(f"*MATRIX INPUT, NAME={key.upper()}, TYPE=SYMMETRIC")
        for i, j in zip(*np.nonzero(np.tril(part[key])), strict=True):
            lines.append("{},{},{},{},{:.16e}".format(*rows[i], *rows[j], part[key][i, j]))
    assembly = ", ".join(f"{_ABAQUS[key]}={key.upper()}" for key in keys)
    return "\n".join([*lines, f"*MATRIX ASSEMBLE, {assembly}"]) + "\n"


def _rows(part: Mapping[str, Any], first: int, scalar: int) -> list[tuple[int, int]]:
    """Return node and freedom of each row; a mode has a node of its own and freedom `scalar`."""
    frames, count = len(part["names"]), len(part["stiffness"])
    rows = [(first + frame, freedom) for frame in range(frames) for freedom in range(1, 7)]
    return rows + [(first + frames + mode, scalar) for mode in range(count - len(rows))]


def _number(value: float) -> str:
    """Return a number in a field of 16 characters with all digits that fit: 9 to 13."""
    parts = (f"{value:.{digits}e}".split("e") for digits in range(12, 7, -1))
    texts = (f"{mantissa}D{int(exponent)}" for mantissa, exponent in parts)
    return next(text.rjust(_WIDTH) for text in texts if len(text) <= _WIDTH)
