"""Parts whose displacement is known everywhere, for `test_bars`: made-up energies and responses.

A conservative part is an energy of the six scaled loads x = (F, mu) / `HIGH`, evaluated along
straight lines by Taylor polynomials of third order; its derivatives follow from those along 56
lines. Other parts are displacements of scaled loads, with tangents by central differences.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from itertools import combinations, combinations_with_replacement
from typing import Any, NamedTuple

import numpy as np

from tests.fea.shipped_meshes import COMPONENTS
from tests.surrogate.calibrating import SOLVES
from tests.surrogate.findings.rigs import Rig
from tests.surrogate.kriging.responses import RESPONSES, solved
from tests.surrogate.responses import RANGE as NINE_RANGE
from tests.surrogate.scenarios import ROUNDING, shipped_truth, spread
from tests.surrogate.scenarios import TOLERANCES as SHIPPED
from wrenchbook.fea.bundle.read import read_bundle
from wrenchbook.fea.solve import Solver
from wrenchbook.service.library.component import component_of
from wrenchbook.surrogate.table.axes import AXES
from wrenchbook.surrogate.table.rows import LoadRange, Rows, Tolerance
from wrenchbook.surrogate.table.second_derivatives import moment_map

HIGH = np.array([820.0, 1500.0, 4300.0, 210.0, 330.0, 120.0])  # N and N·m
# Energies are of scaled loads (F, mu); of the wrench (F, M) the range is a little wider.
RANGE = LoadRange(-1.08 * HIGH, 1.08 * HIGH)
SIZE = 0.08  # rad: of the largest rotations
STEP = 1e-6  # of a half range, for tangents by central differences
TRIPLES = np.array(list(combinations_with_replacement(range(6), 3)))
_MIXED = np.random.default_rng(90210).normal(size=(6, 6))
COMPLIANCE = np.diag([1.0, 0.7, 1.4, 0.9, 1.2, 0.6]) + 0.06 * _MIXED @ _MIXED.T


class Part(NamedTuple):
    """A part whose displacement is known at every wrench.

    Attributes
    ----------
    name : str
    load_range : LoadRange
    tolerance : Tolerance or None
    rows : callable
        From parts (n, 6) of -1 to 1 of the range, and 0 to 2 derivatives of the displacement, to
        solved rows with as many of these as the part has.
    accuracy : float
        Of the largest displacement: what the truth is known to.
    """

    name: str
    load_range: LoadRange
    tolerance: Tolerance | None
    rows: Callable[[np.ndarray, int], Rows]
    accuracy: float = ROUNDING


class Line:
    """Numbers along lines, as Taylor polynomials of third order: an array of four coefficients."""

    def __init__(self, terms):
        self.terms = terms

    def by(self, value, first, second, third):
        """Return a function of it, by the function's derivatives here."""
        _, a, b, c = self.terms
        slope = first * a, first * b + second / 2 * a**2
        return Line([value, *slope, first * c + second * a * b + third / 6 * a**3])

    def __add__(self, other):
        if not isinstance(other, Line):
            return Line([self.terms[0] + other, *self.terms[1:]])
        return Line([a + b for a, b in zip(self.terms, other.terms, strict=True)])

    def __mul__(self, other):
        if not isinstance(other, Line):
            return Line([other * a for a in self.terms])
        a, b = self.terms, other.terms
        return Line([sum(a[i] * b[k - i] for i in range(k + 1)) for k in range(4)])

    __radd__, __rmul__ = __add__, __mul__

    def __sub__(self, other):
        return self + -1 * other

    def __pow__(self, power):
        x, p = self.terms[0], power
        rest = (p - 1) * (p - 2) * x ** (p - 3.0) if p not in (1, 2) else 0 * x
        return self.by(x**p, p * x ** (p - 1.0), p * (p - 1) * x ** (p - 2.0), p * rest)


def sine(x):
    value, slope = np.sin(x.terms[0]), np.cos(x.terms[0])
    return x.by(value, slope, -value, -slope)


def exponential(x):
    value = np.exp(x.terms[0])
    return x.by(value, value, value, value)


def rounded(x):
    """Return log cosh: an absolute value with a round corner."""
    y = x.terms[0]
    slope = np.tanh(y)
    bend = 1 - slope**2
    return x.by(np.logaddexp(y, -y) - np.log(2), slope, bend, -2 * slope * bend)


def ramp(x):
    """Return log(1 + exp x): a smooth onset."""
    slope = 0.5 * (1 + np.tanh(x.terms[0] / 2))
    bend = slope * (1 - slope)
    return x.by(np.logaddexp(x.terms[0], 0), slope, bend, bend * (1 - 2 * slope))


def beyond(x, play):
    """Return the square of what is beyond a play, so that the slope has kinks."""
    over = np.sign(x.terms[0]) * np.maximum(np.abs(x.terms[0]) - play, 0)
    return x.by(over**2, 2 * over, 2.0 * (over != 0), 0 * over)


def combined(x, weights):
    return sum((one * float(by) for one, by in zip(x, weights, strict=True)), start=0.0)


def quadratic(x):
    return combined(
        [one * combined(x, row) for one, row in zip(x, COMPLIANCE, strict=True)], [1] * 6
    )


def bending(x):
    return 1.25 * (1 + 0.8 * quadratic(x)) ** 0.5 + 0.08 * sine(combined(x, COMPLIANCE.sum(axis=0)))


def membrane(x):
    across = 1 + 0.35 * (x[2] ** 2 + 0.5 * x[3] ** 2 + 0.5 * x[4] ** 2)
    return 0.35 * quadratic(x) * across**-1 + 0.1 * x[2] * (x[0] ** 2 - x[1] * x[4])


def beam_column(x):
    lateral = x[0] ** 2 + 1.2 * x[1] ** 2 + x[0] * x[4] + x[4] ** 2 + x[3] ** 2 - 0.6 * x[1] * x[3]
    return 0.3 * lateral * (1 + 0.75 * x[2]) ** -1 + 0.4 * x[2] ** 2 + 0.3 * x[5] ** 2


def touching(x):
    straight = [combined(x, row) for row in COMPLIANCE]
    corners = combined([rounded(item * (1 / 0.08)) for item in straight], [0.024] * 6)
    contact = ramp((x[2] - 0.3 * x[3] + 0.2) * (1 / 0.06)) * (x[2] + 1.2)
    return 0.15 * quadratic(x) + corners + 0.0576 * contact


def edge_layer(x):
    first = exponential((x[2] + 0.3 * x[0] - 1.1) * 20)
    return 0.35 * quadratic(x) + 0.015 * first + 0.021 * exponential((x[4] + 1) * (-1 / 0.07))


def ripple(x):
    first = sine(combined(x, [8.1, 1.8, 0.9, 4.5, -2.7, 1.8]))
    second = sine(combined(x, [1.0, -6.0, 8.0, 2.0, 3.0, 0.0]) + np.pi / 2)
    return 0.4 * quadratic(x) + 0.0083 * first + 0.0075 * second


def plays(x):
    straight = [combined(x, row) for row in COMPLIANCE]
    play = (0.3, 0.2, 0.5, 0.3, 0.4, 0.25)
    over = [beyond(one, by) for one, by in zip(straight, play, strict=True)]
    return 0.12 * quadratic(x) + combined(over, [0.4] * 6)


def products(x):
    product = 0.5 * x[0] * x[1] * x[2] + 0.3 * x[5] * x[0] * x[3]
    return 0.25 * quadratic(x) + product + 0.4 * sine(1.5 * x[3] * x[4] * x[2])


def by_axes(x):
    total = 0.0
    for axis in AXES:
        a, b, c = (x[load] for load in axis.inputs)
        total = total + (1 + 1.5 * (a**2 + b**2 + c**2)) ** 0.5 + 0.2 * a * b * c - 0.1 * a**3
    return total


def steep(x):
    wide = 0.5 * (exponential(x[1]) + exponential(-1 * x[1]))
    second = rounded(3 * (x[0] + x[5])) * wide
    return 0.3 * quadratic(x) + 0.075 * rounded(4 * (x[2] - 0.5 * x[4])) + 0.05 * second


_ENERGIES = bending, membrane, beam_column, touching, edge_layer, ripple, plays, products, steep
ENERGIES = {item.__name__: item for item in (*_ENERGIES, by_axes)}


def _lines() -> np.ndarray:
    """Return 56 directions that tell all derivatives up to the third, shape (56, 6)."""
    unit = np.eye(6)
    pairs = [unit[a] + sign * unit[b] for a, b in combinations(range(6), 2) for sign in (1, -1)]
    return np.array([*unit, *pairs, *(unit[list(abc)].sum(0) for abc in combinations(range(6), 3))])


LINES = _lines()


def _from_lines(degree: int) -> tuple[np.ndarray, np.ndarray]:
    """Return the index sets of a degree, and what makes derivatives of Taylor terms."""
    sets = np.array(list(combinations_with_replacement(range(6), degree)))
    counts = np.array([np.bincount(item, minlength=6) for item in sets])
    factorials = np.array([1, 1, 2, 6])
    terms = np.prod(LINES[:, None] ** counts / factorials[counts], axis=2)
    return sets, np.linalg.pinv(terms)


FROM_LINES = {degree: _from_lines(degree) for degree in (2, 3)}


def _conservative(energy: Callable[..., Line]) -> Callable[[np.ndarray, int], Rows]:
    joules = SIZE * HIGH[3:].min() / 2

    def rows(parts: np.ndarray, derivatives: int) -> Rows:
        count = len(parts)
        ways = LINES if derivatives else LINES[:6]
        zero = np.zeros((count, len(ways)))
        x = [Line([zero + parts[:, [k]], zero + ways[:, k], zero, zero]) for k in range(6)]
        terms = [joules * term for term in energy(x).terms]
        displacement, loads = terms[1][:, :6] / HIGH, parts * HIGH
        unit = moment_map(displacement[:, None, 3:], np.eye(3))
        turned = np.swapaxes(unit.value, 1, 2)
        moment = np.linalg.solve(turned, loads[:, 3:, None])[..., 0]
        wrench = np.concatenate((loads[:, :3], moment), axis=1)
        known = {}
        if derivatives:
            sets, of_terms = FROM_LINES[2]
            by_q = np.empty((count, 6, 6))
            by_q[:, sets[:, 0], sets[:, 1]] = by_q[:, sets[:, 1], sets[:, 0]] = (
                terms[2] @ of_terms.T
            )
            by_q /= HIGH[:, None] * HIGH
            by_load, by_motion = np.tile(np.eye(6), (2, count, 1, 1))
            by_motion[:] = 0.0
            by_load[:, 3:, 3:] = turned
            by_motion[:, 3:, 3:] = np.einsum("nk,nkia->nia", moment, unit.by_rotation)
            known["compliance"] = np.linalg.solve(np.eye(6) - by_q @ by_motion, by_q @ by_load)
        if derivatives > 1:
            sets, of_terms = FROM_LINES[3]
            known["curvature"] = terms[3] @ of_terms.T / HIGH[sets].prod(axis=1)
        return Rows.of(wrench, displacement, source=["fea"] * count, **known)

    return rows


def friction(x):
    straight = x @ COMPLIANCE
    hold, out = np.clip(0.55 - 0.4 * x[:, 2], 0.1, None), 0.3 * straight
    for load in (0, 1, 5):
        slip = np.maximum(np.abs(straight[:, load]) - hold, 0)
        out[:, load] += np.sign(straight[:, load]) * slip
    return out


def one_constant(x):
    out = x @ COMPLIANCE
    out /= np.sqrt(1 + 0.5 * (out**2).sum(axis=1))[:, None]
    out[:, 3] = 0.37
    return out


def one_tiny(x):
    out = np.tanh(1.2 * x @ COMPLIANCE)
    out[:, 4] = 1e-6 * (x[:, 4] + np.sin(3 * x[:, 0] * x[:, 2]))
    return out


def jumping(x):
    out = 0.6 * x @ COMPLIANCE
    out[:, 2] += 0.3 * (x[:, 2] > 0.25)
    out[:, 0] += 0.1 * (x[:, 1] * x[:, 2] > 0.1)
    return out


def even(x):
    return np.cos(1.3 * x @ COMPLIANCE + 0.4) + 0.3 * x


def saturating(x):
    return np.tanh(2.5 * x @ COMPLIANCE) * (1 + 0.3 * x[:, [1, 2, 0, 4, 5, 3]])


OTHERS = {
    item.__name__: item for item in (friction, one_constant, one_tiny, jumping, even, saturating)
}


def _by_differences(
    respond: Callable[[np.ndarray], np.ndarray], high: np.ndarray, size: float = 1.0
) -> Callable[[np.ndarray, int], Rows]:
    def rows(parts: np.ndarray, derivatives: int) -> Rows:
        known = {}
        if derivatives:
            ways = STEP * np.eye(6)
            pairs = [respond(parts + way) - respond(parts - way) for way in ways]
            known["compliance"] = size * np.stack(pairs, axis=2) / (2 * STEP) / high
        moved = size * respond(parts)
        return Rows.of(parts * high, moved, source=["fea"] * len(parts), **known)

    return rows


def _of_nine(name: str) -> Callable[[np.ndarray, int], Rows]:
    def rows(parts: np.ndarray, derivatives: int) -> Rows:
        if derivatives:
            return solved(RESPONSES[name], parts)
        return Rows.of(parts * NINE_RANGE.high, RESPONSES[name](parts))

    return rows


NINE = tuple(RESPONSES)
SIXTEEN = (*ENERGIES, *OTHERS)
SOLVED = tuple(f"solved {name}" for name in ("plate_thin", "spring", "link", "hot_bracket"))


def _of_solver(name: str) -> Part:
    """Return a shipped component whose every row is a solve."""
    bundle = read_bundle(COMPONENTS / name)
    solver, load_range = Solver(bundle), component_of(bundle, shipped=False).load_range

    def rows(parts: np.ndarray, derivatives: int) -> Rows:
        low, high = load_range.low, load_range.high
        results = [solver.solve((low + high) / 2 + part * (high - low) / 2) for part in parts]
        known: dict[str, Any] = {"compliance": [result.compliance for result in results]}
        if all(result.curvature is not None for result in results):
            known["curvature"] = [result.curvature for result in results]
        moved, source = [result.displacement for result in results], ["fea"] * len(results)
        return Rows.of(
            [result.wrench for result in results], moved, load_range.space, source=source, **known
        )

    return Part(f"solved {name}", load_range, None, rows, SOLVES)


@cache
def part_of(name: str, seed: int = 0) -> Part:
    """Return a part by name; only rigs have several, by seed."""
    if name in ENERGIES:
        return Part(name, RANGE, None, _conservative(ENERGIES[name]))
    if name in OTHERS:
        return Part(name, RANGE, None, _by_differences(OTHERS[name], HIGH, SIZE / 3))
    if name in SHIPPED:
        truth = shipped_truth(name)
        return Part(name, truth.load_range, truth.tolerance, lambda x, _: truth.rows(truth.at(x)))
    if name.startswith("solved "):
        return _of_solver(name.removeprefix("solved "))
    if name == "rig":
        rig = Rig(seed)
        rows = _by_differences(lambda x: rig.respond(x * rig.high), rig.high)
        return Part(name, rig.range, None, rows)
    return Part(name, NINE_RANGE, None, _of_nine(name))


@cache
def size_of(name: str, seed: int = 0) -> np.ndarray:
    """Return what each output of a part varies by over the range, shape (6,), m and rad."""
    return np.ptp(part_of(name, seed).rows(spread(500, 1), 0).displacement, axis=0)
