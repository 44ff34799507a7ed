"""Breaks of the wrench contract in all rows of a file: signs, units, reference points."""

from __future__ import annotations

from collections.abc import Collection
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..table.rows import ZERO_LOAD, Floats, LoadRange, Rows
from ..table.space import LOADS, OUTPUTS
from .origin import Slopes
from .response import CONFIDENT, REMARKABLE, RigFinding, RobustFit

# Part of the largest entry in its 3x3 block, by the motion of its load: smaller ones are unsure.
MIN_ENTRY = 0.05
TIE = 0.1  # difference of two factors' logarithms within which both quantities explain the blocks
CALIBRATION = 1.5  # a wrong calibration's factor is above it, a finite element error's below
FAR = 3.0  # a wrong unit's factor is above it, a difference between parts of a kind below
MAX_SCATTER = 1.6  # factor by which entries with one wrong unit may differ
UNIT_MATCH = 1.15  # largest ratio of a factor to that of two named units
MIN_IMPROVEMENT = 3.0  # factor by which a lever must lower the asymmetry
LEVER_ROUNDS = 3  # rounds of the lever's weights, which depend on the lever and settle in them
# Parts of the range: loads below or above are of another unit.
MIN_OF_RANGE, MAX_OF_RANGE = 0.02, 5.0
MAX_TRANSLATION = 0.1  # m: no part whose rotations are small moves farther without a remark
QUANTITIES = ("translations", "rotations", "forces", "moments")
LENGTHS, FORCES = ("translations", "moments"), ("forces", "moments")
UNITS = (  # ratio of two units, the quantities that have them, and their names
    (1000.0, LENGTHS, "millimetres for metres"),
    (1000.0, FORCES, "newtons for kilonewtons"),
    (4.448, FORCES, "pounds for newtons"),
    (25.4, LENGTHS, "inches for millimetres"),
    (39.37, LENGTHS, "inches for metres"),
    (9.807, FORCES, "kilograms for newtons"),
    (10.0, LENGTHS, "millimetres for centimetres"),
    (10.0, FORCES, "newtons for decanewtons"),
    (17.45, ("rotations",), "milliradians for degrees"),
    (57.3, ("rotations",), "degrees for radians"),
    (8.851, ("moments",), "pound-inches for newton metres"),
)


class Fit(NamedTuple):
    """A compliance at no load and its uncertainty."""

    matrix: Floats  # (6, 6), SI: row output, column load; 0 where unknown
    covariance: Floats  # (6, 6, 6), SI: covariance of each output's row
    # (6, 6): entries that are certainly nonzero, and not small beside others of their kind
    sure: NDArray[np.bool_]


def fit_of(matrix: Floats, covariance: Floats, load_range: LoadRange) -> Fit:
    """Return a compliance (6, 6) with its covariance (6, 6, 6), SI, and which entries are sure."""
    size = np.abs(matrix * load_range.scale)  # the motion by each load
    blocks = size.reshape(2, 3, 2, 3).max(axis=(1, 3)) * MIN_ENTRY
    deviation = np.sqrt(np.einsum("ijj->ij", covariance))
    sure = (size > np.kron(blocks, np.ones((3, 3)))) & (np.abs(matrix) > CONFIDENT * deviation)
    return Fit(matrix, covariance, np.asarray(sure))


def sign_findings(fit: Fit) -> list[RigFinding]:
    """Return a finding where loads do negative work on their displacements."""
    diagonal = np.diag(fit.matrix)
    work = np.diag(fit.sure)
    wrong = np.flatnonzero(work & (diagonal < 0))
    if not len(wrong):
        return []
    names = ", ".join(f"{LOADS[k]} on {OUTPUTS[k]}" for k in wrong)
    all_wrong = len(wrong) == work.sum()
    subject = (
        "the wrench must act ON the component; reverse the signs of all loads with a mapping such "
        "as Fz=-fz [N]"
        if all_wrong and len(wrong) > 1
        else "correct the sign (a mapping such as Fz=-fy [N]), the frame (--frame), or the "
        "reference point (--load-point, --displacement-point)"
    )
    message = f"the loads do negative work ({names}), which no elastic part does: {subject}"
    return [RigFinding("sign", message, (), {"loads": [LOADS[k] for k in wrong]})]


def turned_findings(fit: Fit, solved: Fit | None) -> list[RigFinding]:
    """Return a finding of loads, or displacements, whose sign is opposite to that of the solves."""
    if solved is None:
        return []
    both = fit.sure & solved.sure
    turned = both & (fit.matrix * solved.matrix < 0)
    for names, axis in ((LOADS, 0), (OUTPUTS, 1)):
        count = turned.sum(axis=axis)
        wrong = (count > 0) & (count == both.sum(axis=axis))
        if not wrong.any() or count[wrong].sum() < turned.sum():
            continue
        wrong_names = [names[k] for k in np.flatnonzero(wrong)]
        all_wrong = wrong.sum() == both.any(axis=axis).sum()
        subject = "all loads, or all displacements," if all_wrong else ", ".join(wrong_names)
        message = (
            f"{subject} have the opposite sign of the solves, whose wrench acts ON the component "
            "in the interface's axes. Reverse the sign with a mapping such as Fz=-fz [N]"
        )
        return [RigFinding("sign", message, (), {"quantities": wrong_names})]
    return []


def range_findings(rows: Rows, load_range: LoadRange) -> list[RigFinding]:
    """Return findings of forces and moments whose size differs from the load range."""
    findings = []
    for name, part in (("forces", slice(0, 3)), ("moments", slice(3, 6))):
        ends = np.abs(load_range.ends[:, part]).max(axis=0)
        largest = np.abs(rows.wrench[:, part]).max(axis=0)
        loaded = (largest > 0) & (ends > ZERO_LOAD * np.abs(load_range.ends).max())
        if not loaded.any():
            continue
        ratio = float((largest[loaded] / ends[loaded]).max())
        if MIN_OF_RANGE <= ratio <= MAX_OF_RANGE:
            continue
        unit = named_unit(ratio, (name,))
        message = (
            f"the largest of the {name} is {ratio:.3g} times the end of the load range; check "
            f"their unit{unit}, or the component's range"
        )
        findings.append(RigFinding("unit", message, (), {"quantity": name, "factor": ratio}))
    return findings


def size_findings(response: RobustFit) -> list[RigFinding]:
    """Return a finding if translations are too long for a part with such small rotations."""
    largest = float(np.nanmax(np.abs(response.expected[:, :3]), initial=0.0))
    if largest <= MAX_TRANSLATION:
        return []
    message = (
        f"translations reach {largest:.3g} m; check their unit (millimetres under a header in "
        "metres are 1000 times too large)"
    )
    return [RigFinding("unit", message, (), {"quantity": "translations", "factor": 1000.0})]


def unit_findings(fit: Fit, solved: Fit | None, *, linear: bool) -> list[RigFinding]:
    """Return a finding where compliances are in another unit than solves, or than their mirror.

    The secants of a part that is not `linear` differ with the size of the loads.
    """
    if solved is not None:
        return _against_solves(fit, solved, CALIBRATION if linear else FAR)
    # Maxwell and Betti: a moment's displacement by a force equals the force's rotation by the
    # moment.
    moved = fit.matrix[:3, 3:]
    turned = fit.matrix[3:, :3].T
    sure = fit.sure[:3, 3:] & fit.sure[3:, :3].T
    factor = _common(moved[sure], turned[sure])
    if factor is None:
        return []
    message = (
        f"translations by moments are {factor:.3g} times the rotations by forces, but by "
        f"reciprocity both must be equal; check all units{named_unit(factor)}"
    )
    return [RigFinding("unit", message, (), {"quantity": "translations", "factor": factor})]


def _against_solves(fit: Fit, solved: Fit, least: float) -> list[RigFinding]:
    """Return findings of factors of `least` or more between a compliance and that of the solves."""
    blocks = {}
    for name, part in {
        ("translations", "forces"): (slice(0, 3), slice(0, 3)),
        ("translations", "moments"): (slice(0, 3), slice(3, 6)),
        ("rotations", "forces"): (slice(3, 6), slice(0, 3)),
        ("rotations", "moments"): (slice(3, 6), slice(3, 6)),
    }.items():
        both = fit.sure[part] & solved.sure[part]
        ratio = _common(fit.matrix[part][both], solved.matrix[part][both], least=1.0)
        if ratio is not None:
            blocks[name] = np.log(ratio)
    if not blocks:
        return []
    # The quantity whose factor explains all blocks best; a larger load means a smaller compliance.
    quantities = {"translations": 1.0, "rotations": 1.0, "forces": -1.0, "moments": -1.0}
    best = []
    for quantity, power in quantities.items():
        matching = [value for name, value in blocks.items() if quantity in name]
        if not matching:
            continue
        factor = float(np.mean(matching)) * power
        residuals = [
            value - (factor * power if quantity in name else 0.0) for name, value in blocks.items()
        ]
        best.append((float(np.abs(residuals).max()), quantity, float(np.exp(factor))))
    residual, quantity, factor = min(best)
    size = float(abs(np.log(factor)))
    if size <= np.log(least) or residual > min(size / 3, np.log(FAR)):
        return []
    cause_kind = "unit" if size > np.log(FAR) else "calibration"
    others = {name: times for far, name, times in best if name != quantity and far - residual < TIE}
    more = "".join(f", or the {name} {times:.3g} times" for name, times in others.items())
    message = (
        f"the {quantity} are {factor:.3g} times those of the solves{more}; check their "
        f"{cause_kind}{named_unit(factor, (quantity, *others))}"
    )
    return [RigFinding("unit", message, (), {"quantity": quantity, "factor": factor})]


def _common(first: Floats, second: Floats, least: float = FAR) -> float | None:
    """Return the factor between two arrays (k,) if it is common to all entries, else None.

    `least`: a factor below it, and above one over it, counts as 1: None.
    """
    if not len(first):
        return None
    logs = np.log(np.abs(first / second))
    factor = float(np.exp(np.median(logs)))
    deviation = np.exp(np.abs(logs - np.median(logs))).max()
    return factor if deviation < MAX_SCATTER and max(factor, 1 / factor) >= least else None


def named_unit(factor: float, quantities: Collection[str] = QUANTITIES) -> str:
    """Return a remark on the units nearest to a factor of quantities; empty if none is near."""
    size = max(factor, 1 / factor)
    units = [unit for unit in UNITS if not set(unit[1]).isdisjoint(quantities)]
    known = min((ratio for ratio, _, _ in units), key=lambda ratio: abs(np.log(size / ratio)))
    names = ", or ".join(name for ratio, _, name in units if ratio == known)
    is_near = abs(np.log(size / known)) < np.log(UNIT_MATCH)
    return f" (a factor of {known:g}: {names}?)" if is_near else ""


def symmetry_findings(fit: Fit, load_range: LoadRange) -> list[RigFinding]:
    """Return a finding if the compliance is unsymmetric, with the lever that makes it symmetric.

    With the moments about a point at r from the point whose motion was measured, the true
    compliance is C L(r), where L adds r x F to the moment. The lever r that makes it symmetric
    follows from generalised least squares of energies. Deviations too small for a remark count as
    noise.
    """
    by_axis = np.zeros((3, 6, 6))  # F -> e x F
    by_axis[:, 3:, :3] = [np.cross(axis, np.eye(3)).T for axis in np.eye(3)]
    before = after = _Skew.of(fit, np.eye(6), load_range)
    if not before.sure.any():
        return []
    size = before.size
    complete = bool((before.known.all() & fit.matrix.any(axis=0)).all())
    lever = np.zeros(3)
    deviation = np.full(3, np.inf)
    moved = np.eye(6)
    for _ in range(LEVER_ROUNDS if complete else 0):  # the weights depend on the lever
        by_lever = [_Skew.of(fit, np.eye(6) + change, load_range).values for change in by_axis]
        changes = np.stack(by_lever, axis=1) - before.values[:, None]
        weighted = np.linalg.solve(after.covariance, changes)
        covariance = np.linalg.inv(changes.T @ weighted)
        lever = -covariance @ weighted.T @ before.values
        deviation = np.sqrt(np.diag(covariance))
        moved = np.eye(6) + np.tensordot(lever, by_axis, axes=1)
        after = _Skew.of(fit, moved, load_range)
    is_sure = (
        bool((np.abs(lever) > CONFIDENT * deviation).any()) and after.size * MIN_IMPROVEMENT < size
    )
    if is_sure and (np.diag(fit.matrix @ moved) > 0).all():
        load_point, moved_point = (",".join(f"{x:.4g}" for x in sign * lever) for sign in (-1, 1))
        message = (
            f"reference points of moments and displacements are {np.linalg.norm(lever):.4g} m "
            f"apart (asymmetry {size:.0%}). If the displacements are of the interface's point, "
            f"import again with --load-point {load_point}; otherwise with --displacement-point "
            f"{moved_point} (m, added to an earlier point)"
        )
        return [RigFinding("lever", message, (), {"lever": lever.tolist(), "asymmetry": size})]
    at = int(np.argmax(np.abs(before.values) * before.sure))
    first, second = int(PAIRS[0][at]), int(PAIRS[1][at])
    other = "" if complete else ", reference point"
    message = (
        f"the compliance is unsymmetric by {size:.0%}, impossible for an elastic part; worst: "
        f"{OUTPUTS[first]} by {LOADS[second]} against {OUTPUTS[second]} by {LOADS[first]}. Check "
        f"the frame{other}, the load cell's crosstalk and the rig's own motion"
    )
    return [RigFinding("asymmetry", message, (), {"asymmetry": size})]


PAIRS = np.triu_indices(6, 1)


class _Skew(NamedTuple):
    """The asymmetry of a compliance, (15,), over its largest energy, and its covariance."""

    values: Floats
    covariance: Floats
    known: NDArray[np.bool_]

    @classmethod
    def of(cls, fit: Fit, change: Floats, load_range: LoadRange) -> _Skew:
        """Return the asymmetry of a fit times a change (6, 6) of the loads."""
        scale = load_range.scale
        measured = np.asarray(fit.matrix.any(axis=1))
        unit = np.abs(fit.matrix * np.outer(scale, scale)).max()
        covariance = (REMARKABLE / CONFIDENT) ** 2 * np.eye(len(PAIRS[0]))
        for output in range(6):
            rows = np.zeros((6, 6, 6))
            rows[np.arange(6), output] = change  # the change of a unit of each entry
            by_entry = np.stack([_skew(row, load_range) for row in rows], axis=1) / unit
            covariance += by_entry @ fit.covariance[output] @ by_entry.T
        known = measured[PAIRS[0]] & measured[PAIRS[1]]
        return cls(_skew(fit.matrix @ change, load_range) / unit, covariance, known)

    @property
    def sure(self) -> NDArray[np.bool_]:
        over = np.abs(self.values) > CONFIDENT * np.sqrt(np.diag(self.covariance))
        return np.asarray(self.known & over)

    @property
    def size(self) -> float:
        return float(np.abs(self.values * self.known).max())


def _skew(matrix: Floats, load_range: LoadRange) -> Floats:
    """Return the asymmetry of a compliance (6, 6), in units of energy, (15,)."""
    energies = matrix * np.outer(load_range.scale, load_range.scale)
    return (energies - energies.T)[PAIRS]


def clearance_findings(slopes: Slopes, response: RobustFit) -> list[RigFinding]:
    """Return a finding where outputs jump as their own load changes its sign."""
    least = np.hypot(CONFIDENT * slopes.jump_deviation, REMARKABLE * response.range)
    at = np.flatnonzero(slopes.jump > least)
    if not len(at):
        return []
    sizes = {OUTPUTS[output]: float(slopes.jump[output]) for output in at}
    units = [f"{sizes[name]:.3g} {'m' if name[0] == 'u' else 'rad'} in {name}" for name in sizes]
    message = (
        f"the part has a clearance of about {', '.join(units)} where the load changes its sign, "
        "which is no error. Measure rows on both sides of zero load, because answers between them "
        "are unknown"
    )
    return [RigFinding("clearance", message, (), {"clearance": sizes})]
