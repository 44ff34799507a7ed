"""A summary of a joint's steps: coverage, error bars, energy, and axes that need more rows."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from wrenchbook.surrogate.table.spread import FORCE_ERROR

from ...contract import LOADS, OUTPUTS

if TYPE_CHECKING:
    from .joint import Joint


class LargestError(NamedTuple):
    """The largest error bar of all steps, m, rad, N or N·m; its step, from 1 on, and time, s."""

    value: float
    step: int
    time: float


class StiffAxis(NamedTuple):
    """A load whose error bar is more than 5 % of its half load range, `allowed`.

    `output` is the displacement that contributes most to it; its bar should be `needed`, not
    `tolerance`.
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
    stiff : tuple of StiffAxis
        Loads with error bars too large for a joint. `remedy` says what to do about these and about
        steps that are not covered; it is empty if there are none.
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
    stiff: tuple[StiffAxis, ...]
    remedy: str
    covered_at: dict[str, float]


def report_of(joint: Joint, began: float = 0.0, energy_drift: float = np.nan) -> JointReport:
    """Return the summary of a joint's steps, of which the first began at the time `began`, s.

    `energy_drift`, J, is NaN if unknown.
    """
    history = joint._history
    count = int(joint._history["steps"])
    outputs = OUTPUTS
    loads = LOADS
    covered_at = {}
    if len(joint.interfaces) > 1:
        space = joint._table.space
        outputs = tuple(space.output_names[index] for index in joint._at)
        loads = tuple(space.input_names[index] for index in joint._at)
        if count:
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

    covered = float(history["covered"]) / count if count else None
    stiff = _stiff_axes(joint, outputs, loads)
    is_uncovered = covered is not None and covered < 1.0
    return JointReport(
        component=joint._name,
        steps=count,
        time=float(history["time"]),
        covered=covered,
        pose_error=largest("pose_error", outputs),
        wrench_error=largest("wrench_error", loads),
        stored=float(history["stored"]) if count else None,
        energy_drift=energy_drift if np.isfinite(energy_drift) else None,
        stiff=stiff,
        remedy=_remedy(joint) if stiff or is_uncovered else "",
        covered_at=covered_at,
    )


def _remedy(joint: Joint) -> str:
    """Return how the table of a joint becomes accurate enough."""
    remedy = joint._more_rows()
    if joint._method is None and joint._packed.answers_by() == "linear":
        remedy = "more solves do not help a linear part; use a finer mesh or nonlinear = true"
    if joint._warned_beyond:
        remedy = f"widen the load range, which a pose of the steps exceeds; {remedy}"
    return remedy


def _stiff_axes(
    joint: Joint, outputs: tuple[str, ...], loads: tuple[str, ...]
) -> tuple[StiffAxis, ...]:
    """Return the loads whose error bar exceeds the fraction `FORCE_ERROR` of half their range."""
    history, packed = joint._history, joint._packed
    allowed = FORCE_ERROR * packed.load_scale[joint._at]
    tolerance = packed.arrays["space/tolerance"][joint._at]
    moved = history["pose_error"]["value"].ravel()
    pulled = history["wrench_error"]["value"].ravel()
    # Contribution of each displacement to a load's error bar, by the stiffness of the last step.
    added = np.nan_to_num(np.abs(joint._stiffness) * moved)
    # If nothing is known, the load's own displacement.
    added += np.finfo(float).tiny * np.eye(len(moved))
    axes = []
    for load in joint.free.tolist():
        if pulled[load] > allowed[load]:
            output = int(added[load].argmax())
            limit = float(tolerance[output])
            axes.append(
                StiffAxis(
                    load=loads[load],
                    error=float(pulled[load]),
                    allowed=float(allowed[load]),
                    output=outputs[output],
                    needed=float(moved[output] * allowed[load] / pulled[load]),
                    tolerance=None if np.isnan(limit) else limit,
                )
            )
    return tuple(axes)
