"""Made-up responses of scaled loads (n, 6), shape (n, 6), and their tables with slopes."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from tests.surrogate.responses import (
    HIGH,
    clean_wrenches,
    coupled,
    full_wrenches,
    kinked,
    smooth,
)
from wrenchbook.surrogate.table.axes import AXES
from wrenchbook.surrogate.table.rows import Rows

Response = Callable[[np.ndarray], np.ndarray]

STEP = 1e-5  # of a half range, for slopes by central differences
NOISE = 3e-6  # m and rad: some 0.2 % of the smooth response's range

# Linear part of the responses below: full and symmetric, as a compliance is.
_SPREAD = np.random.default_rng(7).normal(size=(6, 6)) * 0.1
LINEAR = 1e-3 * (np.diag([1.0, 0.8, 0.5, 1.2, 0.9, 0.7]) + _SPREAD @ _SPREAD.T)


def hardening(x: np.ndarray) -> np.ndarray:
    """Return a linear response stiffened by the cube of its own size, as a membrane is."""
    straight = 1e3 * x @ LINEAR.T
    return 1e-3 * straight / np.cbrt(1 + straight**2)


def clearance(x: np.ndarray) -> np.ndarray:
    """Return a linear response with a softened play of 0.2 about 0.3 of each force."""
    out = x @ LINEAR.T
    for axis in AXES:
        force = x[:, axis.inputs[0]] - 0.3
        play = 2e-4 * np.tanh(force / 0.2)
        out[:, axis.outputs[0]] += play
        out[:, 3:] += 0.3 * play[:, None]
    return out


def kink_across(x: np.ndarray) -> np.ndarray:
    """Return a linear response with a kink along a plane that no axis holds."""
    over = np.abs(x[:, 0] + 0.5 * x[:, 1] - 0.4 * x[:, 5] - 0.1)
    return x @ LINEAR.T + 2e-4 * over[:, None] * np.array([1, 0.5, -0.7, 0.3, 0.8, -0.4])


def strongly_coupled(x: np.ndarray) -> np.ndarray:
    """Return the smooth response, its loads multiplied across axes."""
    out = coupled(x)
    out[:, 1] += 6e-4 * np.sin(x[:, 0] + x[:, 4]) * x[:, 2]
    out[:, 3:] += 4e-4 * (x[:, 0] * x[:, 1] * x[:, 2])[:, None] * np.array([1, -1, 0.5])
    return out


def nearly_linear(x: np.ndarray) -> np.ndarray:
    """Return a linear response with one percent of a smooth one."""
    return x @ LINEAR.T + 0.01 * smooth(x)


def six_decades(x: np.ndarray) -> np.ndarray:
    """Return a smooth response whose outputs are six decades apart."""
    return strongly_coupled(x) * np.array([1.0, 1e-2, 1e-6, 1e-3, 1.0, 1e-6])


def boundary_layer(x: np.ndarray) -> np.ndarray:
    """Return a linear response with a steep rise near one end of two loads."""
    rise = np.exp(12 * (x[:, 2] - 1)) + np.exp(12 * (-x[:, 4] - 1))
    return x @ LINEAR.T + 5e-4 * rise[:, None] * np.array([0.3, 0.2, 1, 0.5, 1, 0.1])


RESPONSES: dict[str, Response] = {
    "smooth": smooth,
    "hardening": hardening,
    "clearance": clearance,
    "kinked": kinked,
    "kink_across": kink_across,
    "strongly_coupled": strongly_coupled,
    "nearly_linear": nearly_linear,
    "six_decades": six_decades,
    "boundary_layer": boundary_layer,
}


def slopes(response: Response, x: np.ndarray) -> np.ndarray:
    """Return du/dx, shape (n, 6, 6), by central differences."""
    out = np.empty((len(x), 6, 6))
    for load, way in enumerate(STEP * np.eye(6)):
        out[:, :, load] = (response(x + way) - response(x - way)) / (2 * STEP)
    return out


def solved(response: Response, x: np.ndarray) -> Rows:
    """Return rows with their tangents, as solves write them."""
    return Rows.of(x * HIGH, response(x), compliance=slopes(response, x) / HIGH)


def spread_wrenches(per_axis: int, full: int, seed: int) -> np.ndarray:
    """Return clean wrenches of each axis, then wrenches of six loads, scaled."""
    clean = clean_wrenches(per_axis, seed)
    return np.concatenate((clean, full_wrenches(full, seed + 1000)))


def noisy_rows(response: Response, x: np.ndarray, seed: int, told: bool) -> Rows:
    """Return measured rows without tangents, with or without their uncertainty."""
    noise = np.random.default_rng(seed).normal(size=(len(x), 6)) * NOISE
    half_widths = np.full((len(x), 6), 1.96 * NOISE if told else np.nan)
    return Rows.of(x * HIGH, response(x) + noise, uncertainty=half_widths)
