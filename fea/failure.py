"""Named failures of a solve, each with its remedy, and the end of an outside program as text."""

from __future__ import annotations

import signal
from collections.abc import Mapping
from typing import Any, Literal

import numpy as np

_OfPart = Literal["mechanism", "inverted_elements", "locking_material", "yields"]
_OfSolve = Literal["not_converged", "ill_conditioned", "snap_through", "rotation_too_large"]
_OfDeck = Literal["bad_deck", "bad_output", "not_linear", "not_reciprocal"]
_OfProgram = Literal["no_solver", "timed_out", "solver_failed"]
FailureKind = _OfPart | _OfSolve | _OfDeck | _OfProgram

REMEDIES: Mapping[FailureKind, str] = {
    # Newton's method ends before an equilibrium.
    "not_converged": (
        "Check that the part can carry this load; then try a smaller load, or a finer mesh where "
        "the part bends most."
    ),
    # Supports leave a motion without resistance.
    "mechanism": (
        "Fix at least three points that are not on one line, join parts that only touch, and mesh "
        "each section with at least two reduced-integration hex20 cells, or use integration = "
        "'full'."
    ),
    # Roundoff of the equations reaches the significant digits.
    "ill_conditioned": (
        "Reduce the ratio of the stiffnesses or the slenderness: mesh thin walls with thicker or "
        "fewer cells, and give nearly rigid parts a lower modulus."
    ),
    # Cells are turned inside out.
    "inverted_elements": (
        "If the undeformed mesh has these cells, repair it in the mesher (often midside nodes are "
        "too far from the middle of their edge); otherwise reduce the load."
    ),
    # The part buckles or snaps over before the full load.
    "snap_through": (
        "Keep the load range below that load, or lock the freedoms of the interface that the real "
        "assembly guides (locked); beyond it the part has no unique answer."
    ),
    # The kind of cell locks with a nearly incompressible material.
    "locking_material": (
        "Mesh that region with 27-node hexahedra (hex27; in gmsh Mesh.SecondOrderIncomplete = 0), "
        "which are accurate up to a ratio of 0.4999; for a higher ratio write 0.4999."
    ),
    # A part of the volume yields; the message ends with the remedy for the part itself.
    "yields": 'Or accept such answers: write on_yield = "warn" under [analysis].',
}
"""The remedy of each kind that has one for all places that raise it."""


class SolveFailed(Exception):  # noqa: N818 - an outcome with a name, not a programming error
    """A solve without a reliable answer.

    message: the failure, in an FEA engineer's words.
    remedy: the change to make; None takes that of `REMEDIES`, and is a KeyError for other kinds.
    """

    def __init__(self, kind: FailureKind, message: str, remedy: str | None = None) -> None:
        remedy = REMEDIES[kind] if remedy is None else remedy
        super().__init__(f"{kind}: {message} {remedy}")
        self.kind: FailureKind = kind
        self.message = message
        self.remedy = remedy
        # The iterations up to the failure: the fields of `fea.solution.Iteration`
        self.history: tuple[tuple[float, int, float], ...] = ()
        # The part of the wrench at which the component snaps through or buckles, if known
        self.load_factor: float | None = None
        # The last converged state: its load factor, and the displacement of each mesh point in the
        # mesh's axes, shape (n, 3), m; None if there is none.
        self.last: tuple[float, np.ndarray] | None = None

    def __reduce__(self) -> tuple[Any, ...]:
        return SolveFailed, (self.kind, self.message, self.remedy), self.__dict__


def exit_text(code: int) -> str:
    """Return the ending of a program as text, by its exit code or minus its signal."""
    if code == 0:
        return "reported an error"
    if code > 0:
        return f"ended with exit code {code}"
    try:
        name = signal.Signals(-code).name
    except ValueError:
        name = f"signal {-code}"
    memory = " (out of memory?)" if -code == signal.SIGKILL else ""
    return f"was ended by {name}{memory}"
