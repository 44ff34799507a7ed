"""Solving a component by its deck: from a spatial wrench to a `Solution`."""

from __future__ import annotations

import contextlib
import tempfile
import time
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path

import numpy as np

from wrenchbook.fea.deck.running import run_deck
from wrenchbook.fea.failure import SolveFailed
from wrenchbook.fea.solution import Progress, Solution, checked_wrench
from wrenchbook.fea.spec.schema import FREEDOMS, LOADS, Bundle, Deck
from wrenchbook.fea.tensors import TINY, spin_per_vector

FOLDER = "deck"
"""Subfolder of the work folder; below it each run of the command has a separate folder."""

_MOMENT_GAP = 1e-5
"""Largest relative difference between the moment that acted and the required moment."""

_MAX_RUNS = 12  # runs of a nonlinear deck; a rotation of 20 degrees takes half of them
# Largest relative differences of sums of displacements, and of the works of two loads on each
# other's displacements (square roots of the works' product): CalculiX prints seven digits.
LINEAR_GAP = 1e-5
_RECIPROCAL_GAP = 1e-4
_ZERO_WORK = 1e-9  # relative to the largest work; smaller ones are roundoff
# Part of a step: with a smaller change, Broyden's update would divide by almost zero.
_MIN_CHANGE = 1e-3


def solve_deck(
    bundle: Bundle,
    wrench: Sequence[float] | np.ndarray,
    progress: Progress | None,
    folder: Path | None,
    accept: Callable[[np.ndarray], None],
) -> Solution:
    """Solve a component for one wrench with its deck.

    A linear deck runs seven times: for the wrench, and for six single loads, which give its
    compliance and show whether it is linear. A nonlinear deck runs once if it takes spatial
    moments, otherwise until the conjugate moment fits the rotation (two or three times for small
    rotations); its compliance and strain energy are unknown: NaN.

    bundle: with a deck.
    wrench: shape (6,), N and N·m: at the displaced interface point, in the undeformed interface
    frame's axes.
    progress: called with the fraction done and a message.
    folder: folder of the files of every run, below ``deck``; None deletes them.
    accept: raises if a displacement, shape (6,), m and rad, is beyond the limits of an answer.

    Raises ValueError if the wrench is not six finite numbers, or the bundle has no deck. Raises
    SolveFailed as `run_deck`, and of kind ``not_linear``, ``not_reciprocal``, or ``not_converged``
    if no conjugate moment fits.
    """
    started = time.perf_counter()
    loads = checked_wrench(wrench)
    if bundle.deck is None:
        raise ValueError("component.toml has no [deck]; add a [deck]")
    report = progress or (lambda fraction, message: None)
    with _work_folder(folder) as work_folder:
        runs = _Runs(bundle.deck, work_folder, report, accept)
        if bundle.analysis.nonlinear:
            displacement = _nonlinear(runs, loads)
            compliance = np.full((6, 6), np.nan)
            work = np.nan
        else:
            sizes = np.maximum(np.abs(bundle.range.low), np.abs(bundle.range.high))
            sizes = np.where(sizes > 0, sizes, sizes.max())  # a range may be 0, a single load not
            displacement, compliance = _linear(runs, loads, sizes)
            _require_reciprocity(compliance, sizes)
            work = 0.5 * float(loads @ displacement)
    accept(displacement)
    report(1.0, "done")
    return Solution(
        wrench=loads,
        displacement=displacement,
        compliance=compliance,
        strain_energy=work,
        work=work,
        unknowns=runs.unknowns,
        seconds=time.perf_counter() - started,
        history=(),
        nodes=np.empty((0, 3)),
    )


class _Runs:
    """The runs of one solve."""

    def __init__(
        self, deck: Deck, folder: Path, progress: Progress, accept: Callable[[np.ndarray], None]
    ) -> None:
        self.deck = deck
        self.accept = accept
        self.unknowns = 0
        self._folder = folder
        self._progress = progress

    def run(self, name: str, wrench: np.ndarray, begin: float, end: float) -> np.ndarray:
        """Run the deck; its part of the progress is from `begin` to `end`."""

        def progress(fraction: float, message: str) -> None:
            self._progress(begin + (end - begin) * fraction, f"{name}: {message}")

        progress(0.0, "starting")
        displacement, self.unknowns = run_deck(self.deck, wrench, self._folder / name, progress)
        return displacement


def _linear(runs: _Runs, wrench: np.ndarray, sizes: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return displacement, shape (6,), and compliance, shape (6, 6), of a linear deck.

    sizes: shape (6,), N and N·m: the six single loads, those of the load range, for which the deck
    is made.

    Raises SolveFailed of kind ``not_linear`` if the displacement is not the sum of the single
    loads'.
    """
    displacement = runs.run("wrench", wrench, 0.0, 1.0 / 7.0)
    columns = []
    for i, load in enumerate(LOADS):
        single = sizes[i] * np.eye(6)[i]
        run = runs.run(load.lower(), single, (i + 1) / 7.0, (i + 2) / 7.0)
        columns.append(run / sizes[i])
    compliance = np.stack(columns, axis=1)

    # Each entry relative to the largest translation or rotation: entries that are zero by symmetry
    # are roundoff.
    largest = (np.abs(compliance) @ np.abs(wrench)).reshape(2, 3).max(axis=1)
    gaps = np.abs(compliance @ wrench - displacement).reshape(2, 3).max(axis=1)
    if (gaps > LINEAR_GAP * largest).any():
        gap = float((gaps / np.maximum(largest, TINY)).max())
        raise SolveFailed(
            "not_linear",
            f"The deck's answer to this wrench differs by {gap:.1e} of its size from the sum of "
            f"its answers to single loads; at most {LINEAR_GAP:g} is roundoff.",
            "Set nonlinear = true in [analysis], or remove what is nonlinear from the "
            "deck: NLGEOM, contact, plasticity, loads other than the wrench.",
        )
    return displacement, compliance


def _require_reciprocity(compliance: np.ndarray, sizes: np.ndarray) -> None:
    """Check that a compliance is that of an elastic body.

    No load of `sizes`, shape (6,), N and N·m, does negative work, and two loads do the same work on
    each other's displacements (Betti 1872). Works in J are compared, because a locked freedom may
    have a compliance of roundoff.

    Raises SolveFailed of kind ``not_reciprocal`` if it is not.
    """
    exchange = compliance * np.outer(sizes, sizes)
    works = np.diagonal(exchange)
    floor = _ZERO_WORK * float(np.abs(works).max())
    if (works < -floor).any():
        i = int(np.argmin(works))
        raise _not_reciprocal(
            f"A unit load along {FREEDOMS[i]} moves {FREEDOMS[i]} by {compliance[i, i]:.6e}, in "
            "the opposite direction."
        )
    works = np.maximum(works, 0.0)
    gap = np.abs(exchange - exchange.T) - _RECIPROCAL_GAP * np.sqrt(np.outer(works, works))
    i, j = np.unravel_index(int(np.argmax(gap)), gap.shape)
    if gap[i, j] > floor:
        first, second = FREEDOMS[i], FREEDOMS[j]
        raise _not_reciprocal(
            f"A unit load on {second} moves {first} by {compliance[i, j]:.6e}, one on "
            f"{first} moves {second} by {compliance[j, i]:.6e}: in an elastic body the two "
            "are equal."
        )


def _not_reciprocal(message: str) -> SolveFailed:
    """Return the failure of a compliance that violates reciprocity."""
    return SolveFailed(
        "not_reciprocal",
        message,
        "Check that each placeholder stands at its own freedom with a plus sign, that point and "
        "rotation name the loaded sets, and that unit is the unit of the deck.",
    )


def _nonlinear(runs: _Runs, wrench: np.ndarray) -> np.ndarray:
    """Return the displacement of a nonlinear deck under a spatial wrench.

    The virtual work of a spatial moment M is M . J(r) dr, with J the left Jacobian of the rotation
    vector r; so the moment conjugate to r is J(r)^T M. It depends on the answer: Broyden's method
    finds it, begun with the unit matrix, as J is near it.
    """
    if runs.deck.moment == "spatial":
        return runs.run("wrench", wrench, 0.0, 1.0)

    moment = wrench[3:]
    size = float(np.linalg.norm(wrench[3:]))
    acting = moment.copy()
    inverse = np.eye(3)
    step = np.zeros(3)
    before = np.zeros(3)
    gap = np.inf
    displacement = np.zeros(6)
    for number in range(_MAX_RUNS):
        name = f"wrench-{number + 1}"
        loads = np.concatenate([wrench[:3], acting])
        displacement = runs.run(name, loads, 1.0 - 0.5**number, 1.0 - 0.5 ** (number + 1))
        excess = acting - spin_per_vector(displacement[3:]).T @ moment
        gap = float(np.linalg.norm(excess))
        if gap <= _MOMENT_GAP * size:
            return displacement
        if number:
            # The inverse Jacobian after a step that changed the excess so (the "good" update).
            change = excess - before
            row = step @ inverse
            scale = float(row @ change)
            if abs(scale) >= _MIN_CHANGE * float(step @ step):
                inverse = inverse + np.outer(step - inverse @ change, row) / scale
        step = -inverse @ excess
        before = excess
        acting = acting + step

    runs.accept(displacement)
    raise SolveFailed(
        "not_converged",
        f"After {_MAX_RUNS} runs the deck's moment still differs by {gap / size:.1e} of its size "
        f"from the required one; at most {_MOMENT_GAP:g} is allowed.",
        'If the deck applies moments about fixed axes, write moment = "spatial" in [deck]; '
        "otherwise lower the load range, because the part rotates too much.",
    )


@contextlib.contextmanager
def _work_folder(folder: Path | None) -> Iterator[Path]:
    """Make the folder of this solve; a number is added if it exists."""
    if folder is None:
        with tempfile.TemporaryDirectory(prefix="wrenchbook-deck-") as temporary:
            yield Path(temporary)
        return
    path = Path(folder) / FOLDER
    number = 1
    while path.exists():
        number += 1
        path = Path(folder) / f"{FOLDER}-{number}"
    path.mkdir(parents=True)
    yield path.resolve()
