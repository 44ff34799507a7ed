"""Synthetic responses and tables with fixed seeds, shared by the surrogate's tests."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from tests.surrogate.law import Law, build_without_kriging
from wrenchbook.surrogate.table.axes import AXES
from wrenchbook.surrogate.table.rows import LoadRange, Rows

HIGH = np.array([1000.0, 1000.0, 5000.0, 500.0, 500.0, 200.0])
RANGE = LoadRange(-HIGH, HIGH)

Response = Callable[[np.ndarray], np.ndarray]


def smooth(x: np.ndarray) -> np.ndarray:
    """Return a smooth sum of functions of the axis triples, shape (n, 6), of scaled loads."""
    out = np.zeros((len(x), 6))
    for axis in AXES:
        force, first, second = x[:, list(axis.inputs)].T
        out[:, axis.outputs[0]] += np.tanh(force + 0.3 * first * second) + 0.2 * first**2
        out[:, 3] += 0.5 * np.sin(first + 0.4 * force) * (1 + 0.2 * second) + 0.1 * force * first
        out[:, 4] += 0.3 * second**3 + 0.2 * first * force**2
        out[:, 5] += np.exp(0.5 * force * second) - 1 + 0.3 * first
    return 1e-3 * out


def kinked(x: np.ndarray) -> np.ndarray:
    """Return the smooth response with kinks where each force changes its sign, as a contact has."""
    out = smooth(x)
    for axis in AXES:
        force, first, _ = x[:, list(axis.inputs)].T
        out[:, axis.outputs[0]] += 5e-4 * np.abs(force)
        out[:, 3:] += 1e-3 * (np.abs(force) + 0.5 * np.abs(first))[:, None]
    return out


def coupled(x: np.ndarray) -> np.ndarray:
    """Return the smooth response with load products that no axis holds."""
    out = smooth(x)
    out[:, 0] += 4e-4 * x[:, 1] * x[:, 2] + 1e-4 * x[:, 1]
    out[:, 2] /= 1 + 0.5 * (x[:, :3] ** 2).sum(axis=1)
    out[:, 4] += 3e-4 * x[:, 0] * x[:, 1]
    return out


def clean_wrenches(per_axis: int, seed: int) -> np.ndarray:
    """Return corners and random points of each axis, scaled, shape (3 per_axis, 6)."""
    rng = np.random.default_rng(seed)
    wrenches = np.zeros((3, per_axis, 6))
    corners = np.array(np.meshgrid([-1, 1], [-1, 1], [-1, 1])).reshape(3, -1).T
    for axis, block in zip(AXES, wrenches, strict=True):
        points = rng.uniform(-1, 1, (per_axis, 3))
        points[:8] = corners[:per_axis]
        block[:, list(axis.inputs)] = points
    return wrenches.reshape(-1, 6)


def full_wrenches(count: int, seed: int) -> np.ndarray:
    """Return random scaled wrenches of all six loads."""
    return np.random.default_rng(seed).uniform(-1, 1, (count, 6))


def axes_of(rows: Rows) -> Law:
    """Return a table of the axes alone: it is made in a hundredth of the time.

    By the methods of the axes it answers as every table does (`test_methods` holds them together),
    so that properties of the axes can be tried on many tables.
    """
    solves = replace(rows, source=np.full(len(rows), "fea"))  # which no rig has moved
    return build_without_kriging(solves, RANGE)


def six(error: tuple[float, ...] | None) -> tuple[float, ...]:
    """Return error bars as batches have them: NaN where they are not known."""
    return (np.nan,) * 6 if error is None else error


def table(response: Response, scaled: np.ndarray, **columns: object) -> Rows:
    """Return rows of a response of scaled loads."""
    return Rows.of(scaled * HIGH, response(scaled), **columns)
