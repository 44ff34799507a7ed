"""Relaxation of the pose towards its answer, so that scene and component reach an equilibrium.

With the displacement u set, a scene answers with a wrench W(u) and the component with U(W(u)). The
equilibrium is u = U(W(u)). A step by the whole residual multiplies the distance from it by -C K,
the component's compliance times the scene's stiffness: the distance grows if their spectral radius
G is over 1. A step by the fraction 2/(1 + G) or less does not let it grow.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from numbers import Real

import numpy as np
from numpy.typing import ArrayLike

from wrenchbook.surrogate.table.rows import ROTATION_LIMIT

from ..errors import CouplingDiverged, InvalidArgument
from ..wrenches import Vector

RELAXATIONS = ("aitken", "newton", "off")
MIN_FACTOR, MAX_FACTOR = 0.02, 1.0  # 0.02 is stable for G = 99, 1 takes the answer itself
GROWTH = 1.3  # of the factor without overshoot: slow, since only an overshoot shows a too large one
# Tolerances: smaller residuals of a running simulation mean nothing. A load that rests on a row of
# the table meets the row's own answer or, a rounding error beside it, the interpolated one: as
# overshoots, such jumps reduced the factor to its smallest value, and the next load lagged by 12 %.
MIN_RESIDUAL = 1e-3
MAX_RESIDUAL = 1e100  # tolerances: beyond this squares overflow, and no test can decide
DERIVED_TOLERANCE = 1e-3  # part of the largest answer so far: the tolerance if none is given

# Signs of divergence: a row of residuals, each opposite to the one before. Loads that change by
# themselves make such rows too, but short ones and of all sizes. White noise is opposite and as
# large with a chance of 0.4: once in two million syncs over sixteen.
OPPOSITE_COSINE = -0.9  # the largest cosine between opposite residuals
# Number in a row, none smaller than this part of the one before, and no decay over all.
MAX_ROW, STEADY_RATIO = 16, 0.8
# Number in a row, and each one's ratio to the largest of the run so far.
MAX_GROWING_ROW, GROWING_RATIO = 4, 1.5
# Signs of monotonic divergence: a scene that tips, or a Newton step by a stiffness of the wrong
# sign. Loads may grow, but not by half each sync, `MAX_ROW` times in a row: 650 x.
ONWARD_COSINE = 0.9  # the smallest cosine between such residuals
# Syncs in a row with an answer beyond the limit: the load causes it, and no overshoot.
MAX_BEYOND = 16

# A limit cycle: in `CYCLE_SYNCS` answers have a period of `MAX_PERIOD` syncs or less, that is two
# turns, and swing by more than `MIN_SWING` tolerances; more than `MAX_CYCLES` such spans in a row
# do not become smaller.
CYCLE_SYNCS, MAX_PERIOD, MIN_SWING, MAX_CYCLES = 64, 12, 2.0, 3
MAX_UNEXPLAINED = 0.5  # part of the variance of answers in a cycle; noise leaves 0.7 and more
LAGS = 4  # earlier answers in the autoregression of a cycle: enough for two oscillations

REMEDY = (
    "Use relaxation='aitken', a factor below 2/(1 + G), or relaxation='newton' with stiffness=; or "
    "correct the sign of the wrench."
)


def spectral_radius(compliance: ArrayLike, stiffness: ArrayLike) -> float:
    """Return G, the spectral radius of compliance times the scene's stiffness, dimensionless.

    Parameters
    ----------
    compliance : array_like
        Shape (6, 6): du/dw, m/N, m/(N·m), rad/N, rad/(N·m).
    stiffness : array_like
        Shape (6, 6): the scene's dw/du, N/m, N/rad, N·m/m, N·m/rad; of either sign.
    """
    product = np.asarray(compliance, dtype=float) @ np.asarray(stiffness, dtype=float)
    return float(np.abs(np.linalg.eigvals(product)).max())


def stable_factor(compliance: ArrayLike, stiffness: ArrayLike) -> float:
    """Return 2/(1 + G), the relaxation below which an iteration against a stiff scene converges.

    Parameters are those of `spectral_radius`, shapes (6, 6), in m, rad, N and N·m.

    Notes
    -----
    The error of u <- u + f (U(W(u)) - u) is multiplied by 1 - f (1 + g) for each eigenvalue -g of
    the loop; with 0 <= g <= G it is below 1 for f < 2/(1 + G).
    """
    return 2.0 / (1.0 + spectral_radius(compliance, stiffness))


class Scale:
    """The tolerance of each output, the unit of measured m and rad.

    Without a tolerance, ``translation``, m, and ``rotation``, rad, it is a thousandth of the
    largest answers.
    """

    def __init__(self, tolerance: dict[str, float] | None) -> None:
        self._fixed = tolerance is not None
        self._largest = np.zeros(2)
        self._set((tolerance["translation"], tolerance["rotation"]) if tolerance else (0.0, 0.0))

    def _set(self, pair: ArrayLike) -> None:
        """Set a tolerance, m and rad; outputs with 0 are not measured."""
        self.tolerance: Vector = np.repeat(np.asarray(pair, dtype=float), 3)  # (6,), m and rad
        self._per_unit = np.zeros(6)  # tolerances per m and rad
        np.divide(1.0, self.tolerance, out=self._per_unit, where=self.tolerance > 0.0)

    def update(self, answer: Vector) -> None:
        """Update the scale by an answer (6,), m and rad."""
        if not self._fixed:
            self._largest = np.maximum(self._largest, np.abs(answer).reshape(2, 3).max(axis=1))
            self._set(DERIVED_TOLERANCE * self._largest)

    def measure(self, change: Vector) -> Vector:
        """Return a change of displacement (6,), m and rad, in tolerances."""
        return change * self._per_unit


class Relaxation:
    """Aitken's factor from one residual to the next, or a fixed one, with detection of divergence.

    Aitken's secant (Irons and Tuck 1969; for interfaces Kuettler and Wall 2008) is used if the
    residual has changed its sign, which only an overshoot causes, clipped to [0.02, 1]. Otherwise
    the factor grows by `GROWTH`: so a running simulation, whose loads change by themselves, is
    followed without lag, and a contact that opens does not reset it to 1.
    """

    def __init__(self, relaxation: str | float) -> None:
        """Take Mount's `relaxation`: one of `RELAXATIONS`, or a fixed factor."""
        names = ", ".join(RELAXATIONS)
        if isinstance(relaxation, str):
            if relaxation not in RELAXATIONS:
                raise InvalidArgument(f"relaxation must be one of {names}, not {relaxation!r}")
        elif not isinstance(relaxation, Real) or not 0.0 < relaxation <= 1.0:
            raise InvalidArgument(
                f"relaxation must be one of {names}, or a factor above 0 and at most 1, not "
                f"{relaxation!r}"
            )
        fixed = {"aitken": None, "newton": 1.0, "off": 1.0}
        self._fixed = fixed[relaxation] if isinstance(relaxation, str) else float(relaxation)
        self.start = MAX_FACTOR
        self.restart()

    def restart_at(self, factor: float) -> None:
        """Restart with another first factor; a fixed one stays."""
        self.start = min(max(factor, MIN_FACTOR), MAX_FACTOR)
        self.restart()

    def restart(self) -> None:
        """Delete all residuals, for another scene or another time."""
        self.factor = self.start if self._fixed is None else self._fixed
        self._before: Vector | None = None
        self._watch = ContractionWatch()
        self._turned = False

    def next_factor(self, residual: Vector, *, driven: bool) -> float:
        """Return the fraction of a residual (6,), in tolerances, by which the pose moves.

        `driven` loads change by themselves, as they do in time. A smooth load changes its sign once
        at each of its peaks: only the second change in a row is then an overshoot.

        Raises CouplingDiverged, without changing anything, if the residual changes its sign again
        and again and does not become smaller.
        """
        before = self._before
        size = math.hypot(*residual.tolist())
        if not size < MAX_RESIDUAL:
            raise _run_away(self._watch.size, size)
        rests = driven and min(size, self._watch.size) <= MIN_RESIDUAL
        along = 0.0 if before is None or rests else float(residual @ before)
        watch = self._watch.updated(size, along)
        turned = along < 0.0
        if self._fixed is None and before is not None:
            grown = GROWTH * self.factor
            if turned and (self._turned or not driven):  # Aitken's next factor
                change = residual - before
                grown = -self.factor * float(before @ change) / float(change @ change)
                grown = max(grown, MIN_FACTOR)
            self.factor = min(grown, MAX_FACTOR)
        self._before = residual
        self._watch = watch
        self._turned = turned
        return self.factor


@dataclass(frozen=True)
class ContractionWatch:
    """Distinguishes a loop that drives itself from one that external loads drive."""

    size: float = 0.0  # size of the last residual, in tolerances
    largest: float = 0.0  # largest size of the run
    steady: int = 0  # residuals in a row that were opposite and hardly smaller
    records: int = 0  # residuals in a row that were opposite and far larger than all before
    first: float = 0.0  # size of the residual before the steady row
    onward: int = 0  # residuals in a row in one direction and far larger than all before

    def updated(self, size: float, along: float) -> ContractionWatch:
        """Return the watch after a residual; `along` is its scalar product with the one before.

        Raises CouplingDiverged if the row of such residuals is too long.
        """
        opposite = along < OPPOSITE_COSINE * size * self.size
        steady = self.steady + 1 if opposite and size >= STEADY_RATIO * self.size else 0
        records = self.records + 1 if opposite and size >= GROWING_RATIO * self.largest else 0
        further = along > ONWARD_COSINE * size * self.size and size >= GROWING_RATIO * self.largest
        onward = self.onward + 1 if further else 0

        # Residuals within the tolerance do not count.
        first = self.first if steady > 1 else self.size
        if size > 1.0 and (records >= MAX_GROWING_ROW or (steady >= MAX_ROW and size >= first)):
            growth = "grows" if records >= MAX_GROWING_ROW else "does not decay"
            raise CouplingDiverged(
                "the coupling diverges: the pose has overshot the answer "
                f"{max(steady, records)} times in a row, and their distance, {size:.3g} "
                f"tolerances, {growth}. {REMEDY}",
                (self.size, size),
            )
        if size > 1.0 and onward >= MAX_ROW:
            raise _run_away(self.size, size)
        return ContractionWatch(size, max(size, self.largest), steady, records, first, onward)


class CycleWatch:
    """Detection of a limit cycle: answers that swing from sync to sync and do not converge.

    A cycle of a scene in contact has a period of some syncs. Loads of such a period are not
    resolved by the syncs either.
    """

    def __init__(self) -> None:
        self._answers: Vector = np.empty((CYCLE_SYNCS, 6))
        self._count = self._swings = 0
        self._spread = 0.0

    def record(self, answer: Vector) -> None:
        """Record an answer (6,), in tolerances; raises CouplingDiverged for a cycle."""
        self._answers[self._count] = answer
        self._count += 1
        if self._count < CYCLE_SYNCS:
            return

        self._count = 0
        before = self._spread
        spreads = np.ptp(self._answers, axis=0)
        output = int(spreads.argmax())
        self._spread = float(spreads[output])
        answers = self._answers[:, output]
        slopes = np.diff(answers)
        turns = int((slopes[1:] * slopes[:-1] < 0.0).sum())
        swings = self._spread > MIN_SWING and MAX_PERIOD * turns >= 2 * CYCLE_SYNCS
        if swings:
            # Answers of a cycle follow from earlier ones, unlike noise: by an autoregression.
            earlier = [answers[k : k - LAGS] for k in range(LAGS)]
            model = np.stack([*earlier, np.ones(len(answers) - LAGS)], axis=1)
            factors, *_ = np.linalg.lstsq(model, answers[LAGS:], rcond=None)
            unexplained = answers[LAGS:] - model @ factors
            swings = float(unexplained.var()) < MAX_UNEXPLAINED * float(answers.var())

        self._swings = self._swings + 1 if swings and self._spread >= STEADY_RATIO * before else 0
        if self._swings > MAX_CYCLES:
            raise CouplingDiverged(
                f"the coupling does not settle: for {self._swings * CYCLE_SYNCS} syncs the answers "
                f"have oscillated by {self._spread:.3g} tolerances. Use a shorter sync, or for "
                f"parts in contact or motion wrenchbook.MujocoJoint. {REMEDY}"
            )


def within_limit(displacement: Vector) -> Vector:
    """Return a displacement (6,), m and rad, scaled down to the largest rotation of a table."""
    turned = math.sqrt(float(displacement[3:] @ displacement[3:]))
    return displacement if turned <= ROTATION_LIMIT else displacement * (ROTATION_LIMIT / turned)


def require_within_limit(displacement: Vector, component: str) -> None:
    """Raise CouplingDiverged if an equilibrium (6,), m and rad, rotates beyond all tables."""
    turned = math.degrees(math.sqrt(float(displacement[3:] @ displacement[3:])))
    if turned > math.degrees(ROTATION_LIMIT):
        raise CouplingDiverged(
            f"{component} would rotate by {turned:.3g} degrees, but tables end at "
            f"{math.degrees(ROTATION_LIMIT):g}. Check the load against the component's range, the "
            "scene for tipping or buckling, and the signs of the wrench and of stiffness="
        )


def without_answers(count: int, component: str) -> CouplingDiverged:
    """Return the error of a pose far beyond a table, at whose wrenches the table has no answer."""
    return CouplingDiverged(
        f"{component} has no answer to {count} wrenches in a row, and the present pose is an "
        "extrapolation beyond its load range. Check the load against the range. If the pose causes "
        f"the load, the coupling diverges: {REMEDY[0].lower()}{REMEDY[1:]}"
    )


def _run_away(before: float, size: float) -> CouplingDiverged:
    """Return the error of a distance, in tolerances, that grows without a change of sign."""
    return CouplingDiverged(
        f"the coupling diverges: the answer moves away from the pose, by {size:.3g} "
        "tolerances. The scene tips or buckles: use a stiffer component, or correct the sign of "
        "the wrench or of stiffness= (negative for springs)",
        (before, size),
    )
