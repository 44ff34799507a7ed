"""A summary of a joint's steps: coverage, error bars, energy, and loads that need more rows."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from wrenchbook.surrogate.table.spread import FORCE_ERROR

from ..wrenches import Vector


class LargestError(NamedTuple):
    """The largest error bar of all steps, m, rad, N or N·m; its step, from 1 on, and time, s."""

    value: float
    step: int
    time: float


class StiffLoad(NamedTuple):
    """A load, N or N·m, whose error bar is above `allowed`: `FORCE_ERROR` of its half load range.

    `output` is the displacement that contributes most to it. With an error bar of `needed`, m or
    rad, there the load's would be `allowed`; `tolerance` is the table's own, None where unknown.
    """

    load: str
    error: float
    allowed: float
    output: str
    needed: float
    tolerance: float | None


@dataclass(frozen=True)
class JointReport:
    """All steps of a joint since its first or since `restart`, SI; None where unknown.

    Attributes
    ----------
    covered : float or None
        The fraction of steps whose wrench the table covers.
    pose_error, wrench_error : dict of LargestError
        By ``ux`` to ``rz`` and ``fx`` to ``mz``, of several interfaces by ``left.ux``: the largest
        error bar of the displacement, and of the wrench of a step's pose. Times are the scene's in
        MuJoCo, else from the first step on.
    stored, energy_drift : float or None
        The energy that the part has taken up before its last step, and the change of that of a
        MuJoCo scene with its parts: without drives, damping and contacts the integration's error.
    stiff : tuple of StiffLoad
        Loads with error bars too large for a joint.
    remedy : str
        What to do about stiff loads and steps that are not covered; empty without any.
    covered_at : dict of float
        Of several interfaces, by name: the fraction of steps whose wrench there is covered.
    """

    component: str
    steps: int
    time: float
    covered: float | None
    pose_error: dict[str, LargestError | None]
    wrench_error: dict[str, LargestError | None]
    stored: float | None
    energy_drift: float | None
    stiff: tuple[StiffLoad, ...]
    remedy: str
    covered_at: dict[str, float]


class ReportedJoint(NamedTuple):
    """The part of a joint with k interfaces: values of its 6 k freedoms, shape (6 k,)."""

    name: str
    interfaces: tuple[str, ...]  # (k,)
    free: NDArray[np.intp]  # indices of the freedoms that the part does not lock
    outputs: tuple[str, ...]
    loads: tuple[str, ...]
    load_scale: Vector  # half widths of the load range, N and N·m
    tolerance: Vector  # m and rad, NaN where unknown
    stiffness: Vector  # (6 k, 6 k) at the last step's pose, N/m to N·m/rad
    remedy: str


def report_of(
    joint: ReportedJoint, history: NDArray[Any], began: float, energy_drift: float
) -> JointReport:
    """Return the summary of a joint's steps, of which the first began at the time `began`, s.

    `history` is the joint's entry of `JointSteps.history`; `energy_drift`, J, is NaN if unknown.
    """
    count = int(history["steps"])
    covered = float(history["covered"]) / count if count else None
    covered_at = {}
    if count and len(joint.interfaces) > 1:
        fractions = (history["covered_at"] / count).tolist()
        covered_at = dict(zip(joint.interfaces, fractions, strict=True))

    def largest(kind: str, names: tuple[str, ...]) -> dict[str, LargestError | None]:
        """Return the largest error bars by name; None where unknown."""
        errors = history[kind]
        values, steps = errors["value"].ravel(), errors["step"].ravel()
        times = errors["time"].ravel()
        return {
            names[k]: LargestError(float(values[k]), int(steps[k]), began + float(times[k]))
            if steps[k]
            else None
            for k in joint.free.tolist()
        }

    stiff = _stiff_loads(joint, history)
    is_uncovered = covered is not None and covered < 1.0
    return JointReport(
        component=joint.name,
        steps=count,
        time=float(history["time"]),
        covered=covered,
        pose_error=largest("pose_error", joint.outputs),
        wrench_error=largest("wrench_error", joint.loads),
        stored=float(history["stored"]) if count else None,
        energy_drift=energy_drift if np.isfinite(energy_drift) else None,
        stiff=stiff,
        remedy=joint.remedy if stiff or is_uncovered else "",
        covered_at=covered_at,
    )


def _stiff_loads(joint: ReportedJoint, history: NDArray[Any]) -> tuple[StiffLoad, ...]:
    """Return the loads whose error bar exceeds the fraction `FORCE_ERROR` of half their range."""
    allowed = FORCE_ERROR * joint.load_scale
    pose_error = history["pose_error"]["value"].ravel()
    wrench_error = history["wrench_error"]["value"].ravel()
    # Of each displacement to a load's error bar, by the stiffness of the last step.
    contributions = np.nan_to_num(np.abs(joint.stiffness) * pose_error)
    # If nothing is known, the load's own displacement.
    contributions += np.finfo(float).tiny * np.eye(len(pose_error))
    stiff = []
    for load in joint.free.tolist():
        if wrench_error[load] > allowed[load]:
            output = int(contributions[load].argmax())
            tolerance = float(joint.tolerance[output])
            stiff.append(
                StiffLoad(
                    load=joint.loads[load],
                    error=float(wrench_error[load]),
                    allowed=float(allowed[load]),
                    output=joint.outputs[output],
                    needed=float(pose_error[output] * allowed[load] / wrench_error[load]),
                    tolerance=None if np.isnan(tolerance) else tolerance,
                )
            )
    return tuple(stiff)
