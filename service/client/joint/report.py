"""A joint's steps in review: coverage, largest error bars, energy, and axes that need more rows."""

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

    `output` is the displacement that adds most to it; its bar should be `needed`, not `tolerance`.
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
        The share of steps whose wrench the table covers.
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
        Of several interfaces, by name: the share of steps whose wrench there is covered.
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
    """Review a joint's steps, of which the first began at a time, s; J, or NaN if not known."""
    history, free, arrays = joint._history, joint.free, joint._packed.arrays
    count, outputs, loads, covered_at = int(history["steps"]), OUTPUTS, LOADS, {}
    if len(joint.interfaces) > 1:
        space = joint._table.space
        outputs, loads = (
            tuple(names[k] for k in joint._at) for names in (space.output_names, space.input_names)
        )
        shares = (history["covered_at"] / max(count, 1)).tolist()
        covered_at = dict(zip(joint.interfaces, shares, strict=True)) if count else {}

    def largest(kind: str, names: tuple[str, ...]) -> dict[str, LargestError | None]:
        columns = (history[kind][of].ravel().tolist() for of in ("value", "step", "time"))
        rows = zip(*columns, strict=True)
        all_of = [LargestError(v, int(step), began + t) if step else None for v, step, t in rows]
        return {names[int(k)]: all_of[k] for k in free}

    scale, tolerance = (arrays[f"space/{of}"][joint._at] for of in ("scale", "tolerance"))
    moved, pulled = (history[kind]["value"].ravel() for kind in ("pose_error", "wrench_error"))
    # By the stiffness of the last step: the displacement that adds most to a load's error bar.
    most = np.nan_to_num(np.abs(joint._stiffness) * moved)
    most += np.finfo(float).tiny * np.eye(len(moved))
    stiff = []
    for load in free:
        error, allowed, output = pulled[load], FORCE_ERROR * scale[load], int(most[load].argmax())
        if error > allowed:
            needed, limit = float(moved[output] * allowed / error), float(tolerance[output])
            limits = outputs[output], needed, None if np.isnan(limit) else limit
            stiff.append(StiffAxis(loads[load], float(error), float(allowed), *limits))
    covered = float(history["covered"]) / count if count else None
    uncovered = covered is not None and covered < 1.0
    remedy, packed = joint._more_rows(), joint._packed
    if joint._method is None and packed.answers_by() == "linear":
        remedy = "more solves do not help a linear component; use a finer mesh or nonlinear = true"
    if joint._warned_beyond:
        remedy = f"widen the load range, which a pose of the steps exceeds; {remedy}"
    return JointReport(
        *(joint._name, count, float(history["time"]), covered),
        *(largest("pose_error", outputs), largest("wrench_error", loads)),
        float(history["stored"]) if count else None,
        energy_drift if np.isfinite(energy_drift) else None,
        tuple(stiff),
        remedy=remedy if stiff or uncovered else "",
        covered_at=covered_at,
    )
