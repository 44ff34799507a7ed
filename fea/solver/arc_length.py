"""Equilibrium path by its length, beyond the reach of load control.

The load factor becomes an unknown and the length of a step is given instead (Riks 1979, with the
plane normal to the predictor; Crisfield, "Non-linear finite element analysis of solids and
structures", volume 1, chapter 9). The path can then be followed round a limit point, where load
control finds no state or, worse, a state on a far branch.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Literal, NamedTuple

import numpy as np

from wrenchbook.fea.assembly.linearisation import Linearisation
from wrenchbook.fea.assembly.system import System
from wrenchbook.fea.solver.newton import Equilibrium, Report, Stuck, correct, tangent_after
from wrenchbook.fea.tensors import TINY

_MAX_STEPS = 80  # steps of a path before its kind is "lost"
_MAX_ITERATIONS = 10  # iterations of a step before it is halved
_FEW_ITERATIONS = 5  # iterations up to which the next step grows
_GROWTH = 1.6  # ratio of the next step to the last
_MIN_LENGTH = 1.0 / 256  # shortest step, over the first step
# Longest step, over the first, that can distinguish a limit point from a bifurcation.
_FINE_LENGTH = 1.0 / 8
_MAX_NODE_STEP = 0.01  # largest motion of a node in one step, over the part's size
_MAX_LENGTH = 8.0  # longest step, over the first step
_SAMPLES = 201  # samples of the cubic between two points, whose maximum is the critical load
_MIN_COSINE = 0.7  # cosine of the largest angle by which a path may turn in one step


class Ending(NamedTuple):
    """The reason for which a path ends."""

    # The full load, by stable states all along; a maximum of the load on the path; states that
    # become unstable while the load still grows; or no equilibrium further on that converged.
    kind: Literal["reached", "limit", "bifurcation", "lost"]
    factor: float  # part of the load: the largest with a stable state on this path
    equilibrium: Equilibrium  # the last state, beyond the full load if it was reached


class _Point(NamedTuple):
    """One equilibrium on the path."""

    size: float  # size of its load, in the unit of `ArcPath`'s `full`
    equilibrium: Equilibrium
    # Motion per unit of the load's size: free nodes, (n, 3), m, and border, (border,)
    rate: tuple[np.ndarray, np.ndarray]
    speed: float  # Euclidean norm of all nodes' motion in it, m


class ArcPath:
    """Follows the path of one wrench from an equilibrium on it.

    direction: shape (k,): the inputs per unit of the size.
    full: the size of the full load.
    start: a stable equilibrium at the load factor `factor`, with its tangent.
    step: initial change of the load factor.
    report: called with a load factor; returns a function that is called after each iteration.
    """

    def __init__(
        self,
        system: System,
        direction: np.ndarray,
        full: float,
        factor: float,
        start: Equilibrium,
        step: float,
        report: Callable[[float], Report],
    ) -> None:
        self._system = system
        self._direction = direction
        self._full = full
        self._report = report
        self._point = self._point_at(factor * full, start)
        furthest = _MAX_NODE_STEP * system.body.extent * self._point.speed
        farthest_node = np.abs(self._field(self._point)).max(initial=0.0)
        longest = furthest / max(farthest_node, TINY)
        self._first = min(step * full * self._point.speed, longest)
        self._length = self._first

    def follow(self, accept: Callable[[Equilibrium, float], None]) -> Ending:
        """Step to the full load, or to the end of the stable path.

        accept: called with each stable state below the full load, and its factor.
        """
        for _ in range(_MAX_STEPS):
            ahead = self._step()
            if ahead is None:
                if self._length < _MIN_LENGTH * self._first:
                    break
                continue
            step = self._between(ahead)
            product = float(np.linalg.norm(step)) * ahead.speed
            course = float(np.vdot(self._field(ahead), step)) / product if product > 0 else 1.0
            if abs(course) < _MIN_COSINE and self._length > _MIN_LENGTH * self._first:
                self._length *= 0.5
                continue
            if course < 0:
                return Ending("limit", self._limit_before(ahead), self._point.equilibrium)
            if not ahead.equilibrium.tangent.stable:
                if self._length > _FINE_LENGTH * self._first:
                    self._length *= 0.5
                    continue
                middle = 0.5 * (self._point.size + ahead.size) / self._full
                return Ending("bifurcation", middle, self._point.equilibrium)
            if ahead.size >= self._full:
                return Ending("reached", 1.0, ahead.equilibrium)
            accept(ahead.equilibrium, ahead.size / self._full)
            self._point = ahead
            if ahead.equilibrium.iterations <= _FEW_ITERATIONS:
                self._length = min(_GROWTH * self._length, _MAX_LENGTH * self._first)
        return Ending("lost", self._point.size / self._full, self._point.equilibrium)

    def _limit_before(self, ahead: _Point) -> float:
        """Return the largest load factor up to a point beyond it, by a cubic in the path's length.

        The cubic (Hermite's) has the sizes and slopes of both points, the last one falling.
        """
        length = float(np.linalg.norm(self._between(ahead)))
        s = np.linspace(0.0, 1.0, _SAMPLES)
        start = length / self._point.speed
        end = -length / ahead.speed
        cubic = (
            self._point.size * (1 + 2 * s) * (1 - s) ** 2
            + start * s * (1 - s) ** 2
            + ahead.size * s**2 * (3 - 2 * s)
            + end * s**2 * (s - 1)
        )
        return float(cubic.max()) / self._full

    def _step(self) -> _Point | None:
        """Find the next point; None, after halving the length, if no point is that near."""
        point = self._point
        change = self._length / point.speed
        size = point.size + change
        normal = self._field(point) / point.speed
        nodes, border = (change * part for part in point.rate)
        equilibrium = self._correct(nodes, border, size, normal)
        if equilibrium is None or equilibrium[1].balance.least_stretch <= 0:
            self._length *= 0.5
            return None
        return self._point_at(*equilibrium)

    def _correct(
        self, nodes: np.ndarray, border: np.ndarray, size: float, normal: np.ndarray
    ) -> tuple[float, Equilibrium] | None:
        """Bring a predicted state into balance within the plane normal to the predictor."""
        system, balance = self._system, self._point.equilibrium.balance
        tangent = self._point.equilibrium.tangent
        tangent.release()  # `rate` is known
        consistent = False
        for iteration in range(1, _MAX_ITERATIONS + 1):
            balance = system.reload(balance, size * self._direction)
            try:
                step = correct(system, balance, tangent, nodes, border)
            except Stuck:
                return None
            balance = step.balance
            self._report(size / self._full)(iteration, balance.norm)
            if not np.isfinite(balance.norm):
                return None
            if consistent and step.converged:
                at_state = tangent_after(system, step, tangent)
                return size, Equilibrium(balance, at_state, iteration)
            consistent = step.nearly
            tangent = system.linearise(balance, None if consistent else step.aim)
            moved, edge = tangent.correction(balance)
            rate = self._rate(tangent)
            constraint = tangent.border.constraint
            along = float(np.vdot(normal, moved + constraint @ edge))
            shift = -along / float(np.vdot(normal, rate[0] + constraint @ rate[1]))
            nodes, border = moved + shift * rate[0], edge + shift * rate[1]
            size += shift
        return None

    def _rate(self, tangent: Linearisation) -> tuple[np.ndarray, np.ndarray]:
        """Return the motion of free nodes and border per unit of the load's size."""
        nodal, edge = (columns @ self._direction[:, None] for columns in tangent.load_columns)
        nodes, border = tangent.solve(nodal, edge)
        return nodes[:, :, 0], border[:, 0]

    def _point_at(self, size: float, equilibrium: Equilibrium) -> _Point:
        rate = self._rate(equilibrium.tangent)
        field = rate[0] + equilibrium.tangent.border.constraint @ rate[1]
        return _Point(size, equilibrium, rate, float(np.linalg.norm(field)))

    def _field(self, point: _Point) -> np.ndarray:
        """Return all nodes' motion per unit of the load's size at a point, shape (n, 3), m."""
        return point.rate[0] + point.equilibrium.tangent.border.constraint @ point.rate[1]

    def _between(self, ahead: _Point) -> np.ndarray:
        """Return the nodes' motion from the last accepted point to another, shape (n, 3), m."""
        return ahead.equilibrium.balance.state.nodes - self._point.equilibrium.balance.state.nodes
