"""A table as breakpoints for lookup blocks: MATLAB's .mat, for Simulink's n-D Lookup Table.

An axis is one block: its three loads are the breakpoints, u and the three rotations the table data
(linear interpolation, end values clipped). The rotation of a wrench that loads several axes is the
sum over the axes less the answers to each moment alone plus the one to no load, as the table's own
composition (DESIGN, section 3). Resampling makes an error of its own; it is measured on wrenches
between the grid's and is in the file, next to the table's own error bars.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from scipy.interpolate import RegularGridInterpolator
from scipy.io import savemat

from wrenchbook.service.contract import CONTRACT
from wrenchbook.service.tables.served import ServedTable
from wrenchbook.surrogate.table.space import OUTPUT_UNITS, OUTPUTS

AXES = {"x": (0, 4, 5), "y": (1, 5, 3), "z": (2, 3, 4)}
GRIDS = (5, 9, 17, 25)
"""Breakpoints a load; 25 make 15,625 entries a table, and halving the step from 17 on costs eight
times that for a quarter of the error."""
CHECKED = 2000  # wrenches the resampling is measured on
_LOADS = ("Fx", "Fy", "Fz", "Mx", "My", "Mz")
_ROTATIONS = (3, 4, 5)
_USE = (
    "u_i = interpn(axis_i.bp1, axis_i.bp2, axis_i.bp3, axis_i.u, F_i, M_j, M_k); r = sum over the "
    "axes of axis_i.rx, ry, rz there, less moment_m.rx, ry, rz at M_m for each of the three "
    "moments, plus zero(4:6)"
)


class NoTableError(ValueError):
    """The table has no rows, or lacks an output: there is nothing to resample."""


def write_breakpoints(table: ServedTable, name: str, path: Path) -> None:
    """Write a table's resampled axes as a MATLAB 5 file.

    Raises
    ------
    NoTableError
        If the table does not answer all six outputs within its load range.
    """
    if not table.load_range.space.is_default:
        raise NoTableError(
            f"lookup blocks are for one wrench at one interface, and {name!r} has the inputs "
            f"{', '.join(table.load_range.space.input_names)}; export fmu, csv, hdf5 or json"
        )
    low, high = table.load_range.low, table.load_range.high
    wrenches = _between(low, high)
    exact = table.packed.batch(wrenches)
    if not np.isfinite(exact.outputs).all():
        raise NoTableError(
            f"the table of {name!r} lacks some of the six outputs within its load range; add rows, "
            "or export them as they are: csv, xlsx, parquet, hdf5, json"
        )
    known = [column[np.isfinite(column)] for column in exact.errors.T]
    table_error = np.array([np.median(column) if len(column) else np.nan for column in known])
    alone = _single(wrenches)
    for count in GRIDS:
        content = _resampled(table, low, high, count)
        single = _errors(table, content, alone)
        if (single[1] <= 0.5 * table_error).all() or count == GRIDS[-1]:
            break
    else:
        raise AssertionError("there is a last grid")
    whole = _errors(table, content, wrenches)
    savemat(path, {**content, "about": _about(table, name, count, table_error, single, whole)})


def _about(
    table: ServedTable, name: str, count: int, table_error: Any, single: Any, whole: Any
) -> dict:
    return {
        "component": name,
        "table_version": float(table.version),
        "method": table.default,
        "contract": " ".join(f"{word}: {meaning}." for word, meaning in CONTRACT.items()),
        "use": _USE,
        "outputs": " ".join(OUTPUTS),
        "units": " ".join(OUTPUT_UNITS),
        "breakpoints_a_load": float(count),
        "table_bar_median": table_error,
        "resampling_error_max": single[0],
        "resampling_error_rms": single[1],
        "composition_error_max": whole[0],
        "composition_error_rms": whole[1],
    }


def _resampled(table: ServedTable, low: np.ndarray, high: np.ndarray, count: int) -> dict[str, Any]:
    """Return the axes, the answers to moments alone, and the one to no load."""
    found: dict[str, Any] = {"zero": table.packed.batch(np.zeros((1, 6))).outputs[0]}
    points = [_points(*ends, count) for ends in zip(low, high, strict=True)]
    for axis, loads in AXES.items():
        grid = np.meshgrid(*(points[load] for load in loads), indexing="ij")
        wrenches = np.zeros((grid[0].size, 6))
        for load, values in zip(loads, grid, strict=True):
            wrenches[:, load] = values.ravel()
        answers = table.packed.batch(wrenches)
        entry: dict[str, Any] = {f"bp{n + 1}": points[load] for n, load in enumerate(loads)}
        entry["loads"] = " ".join(_LOADS[load] for load in loads)
        entry["u"] = answers.outputs[:, "xyz".index(axis)].reshape(grid[0].shape)
        for output in _ROTATIONS:
            entry[OUTPUTS[output]] = answers.outputs[:, output].reshape(grid[0].shape)
        entry["coverage"] = answers.coverage.reshape(grid[0].shape)
        found[f"axis_{axis}"] = entry
    for load in _ROTATIONS:
        wrenches = np.zeros((count, 6))
        wrenches[:, load] = points[load]
        moved = table.packed.batch(wrenches).outputs
        entry = {"bp1": points[load]} | {OUTPUTS[output]: moved[:, output] for output in _ROTATIONS}
        found[f"moment_{_LOADS[load][1]}"] = entry
    return found


def composed(content: dict[str, Any], wrenches: np.ndarray) -> np.ndarray:
    """Return what the lookup blocks answer to wrenches, (n, 6), N and N·m: (n, 6), m and rad."""
    moved = np.zeros((len(wrenches), 6))
    moved[:, 3:] = np.asarray(content["zero"]).ravel()[3:]
    for axis, loads in AXES.items():
        entry = content[f"axis_{axis}"]
        points = [np.ravel(entry[f"bp{n}"]) for n in (1, 2, 3)]
        outputs = {"xyz".index(axis): "u"} | {output: OUTPUTS[output] for output in _ROTATIONS}
        for output, word in outputs.items():
            look_up = RegularGridInterpolator(points, entry[word])
            moved[:, output] += look_up(wrenches[:, list(loads)])
    for load in _ROTATIONS:
        entry = content[f"moment_{_LOADS[load][1]}"]
        for output in _ROTATIONS:
            at = np.ravel(entry["bp1"]), np.ravel(entry[OUTPUTS[output]])
            moved[:, output] -= np.interp(wrenches[:, load], *at)
    return moved


def _errors(
    table: ServedTable, content: dict[str, Any], wrenches: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return the largest and the RMS error of each output, m and rad, against the table."""
    off = composed(content, wrenches) - table.packed.batch(wrenches).outputs
    return np.abs(off).max(axis=0), np.sqrt((off**2).mean(axis=0))


def _points(low: float, high: float, count: int) -> np.ndarray:
    """Return breakpoints of a load that hold zero; one that has no range gets a made-up one."""
    low, high = min(low, 0.0), max(high, 0.0)
    if low == high:
        return np.linspace(-1.0, 1.0, count)
    return np.linspace(low, high, count)


def _between(low: np.ndarray, high: np.ndarray) -> np.ndarray:
    return np.random.default_rng(1).uniform(low, high, (CHECKED, 6))


def _single(wrenches: np.ndarray) -> np.ndarray:
    """Return wrenches of one axis each: a third of them for each axis."""
    kept = np.zeros_like(wrenches)
    for number, loads in enumerate(AXES.values()):
        kept[number::3, list(loads)] = wrenches[number::3, list(loads)]
    return kept
