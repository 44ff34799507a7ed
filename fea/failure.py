"""Named failures of a solve, each with what to do about it."""

from __future__ import annotations

from typing import Any

REMEDIES = {
    # A Newton's method that stopped short of an equilibrium.
    "not_converged": (
        "Check that the load lies within what the part can carry; a smaller load or a finer mesh "
        "where it bends most may help."
    ),
    # Supports that leave a motion without resistance.
    "mechanism": (
        "Fix more of the part (three points that are not on a line hold a body), join parts that "
        "only touch, and put at least two reduced-integration hex20 across each section, or use "
        "integration = 'full'."
    ),
    # Equations whose roundoff reaches the digits that count.
    "ill_conditioned": (
        "Lessen the contrast of stiffnesses or the slenderness: thicker or fewer cells across thin "
        "walls, a softer stand-in for nearly rigid parts."
    ),
    # Cells turned inside out.
    "inverted_elements": (
        "If this is the undeformed mesh, repair it in the mesher (midside nodes too far from the "
        "middle of their edge are the usual cause); if it came of the load, the load is too large."
    ),
    # A part that buckles or snaps over before the load is reached.
    "snap_through": (
        "The part has no unique answer at this load: keep the load range below the buckling load, "
        "or guide the interface (locked) as the real assembly does."
    ),
    # Cells that are no good for a nearly incompressible material.
    "locking_material": (
        "Mesh that region with 27-node hexahedra (hex27; in gmsh Mesh.SecondOrderIncomplete = 0), "
        "which are right up to 0.4999; write that for a higher ratio."
    ),
    # A part of which a fraction, named in the message, yields.
    "yields": (
        'Lower the load range, strengthen the part, or write on_yield = "warn" under [analysis] to '
        "take such answers."
    ),
}
"""What to change after a failure of each kind that has the same remedy everywhere."""


class SolveFailed(Exception):  # noqa: N818 - an outcome with a name, not a programming error
    """A solve that gave no answer that can be trusted.

    kind: one of ``not_converged``, ``mechanism``, ``ill_conditioned``, ``inverted_elements``,
    ``snap_through``, ``rotation_too_large``, ``locking_material``; for a deck also those of
    `fea.deck.running`.
    message: what happened, in an FEA engineer's words.
    remedy: what to change; None takes that of `REMEDIES`.
    """

    history: tuple = ()  # the iterations up to the failure (`fea.solution.Iteration`)
    # The part of the wrench at which the part snaps through or buckles, if known
    load_factor: float | None = None
    # The last converged state: its load factor, and the displacement of each mesh point in the
    # mesh's axes, shape (n, 3), m; None if there is none.
    last: tuple[float, Any] | None = None

    def __init__(self, kind: str, message: str, remedy: str | None = None) -> None:
        remedy = REMEDIES[kind] if remedy is None else remedy
        super().__init__(f"{kind}: {message} {remedy}")
        self.kind = kind
        self.message = message
        self.remedy = remedy

    def __reduce__(self) -> tuple:
        return SolveFailed, (self.kind, self.message, self.remedy), self.__dict__


def gave_way(kind: str, factor: float) -> SolveFailed | None:
    """Return the failure of a part whose equilibrium path ends below the full load.

    kind: of the ending (`fea.solver.arc_length.Ending`): ``"limit"`` or ``"bifurcation"``; None
    comes of others.
    factor: the part of the wrench at which it ends.
    """
    if kind == "limit":
        message = "The part snaps through at {} of this wrench, where its load has a maximum."
    elif kind == "bifurcation":
        message = "The part buckles at {} of this wrench, where its equilibrium becomes unstable."
    else:
        return None
    failure = SolveFailed("snap_through", message.format(f"{factor:.3g}"))
    failure.load_factor = factor
    return failure


def rotation_too_large(degrees: float, limit: float, load_factor: float = 1.0) -> SolveFailed:
    """Return the failure of an interface that rotates further than tables cover.

    degrees, limit: its rotation, and the largest allowed.
    load_factor: the part of the wrench under which it does.
    """
    under = f" under {load_factor:.3g} of this wrench already" if load_factor < 1.0 else ""
    return SolveFailed(
        "rotation_too_large",
        f"The interface turns by {degrees:.1f} degrees{under}; tables hold at most {limit:.0f}.",
        "Lower the load range, or stiffen the part: this is outside the small deformation that "
        "wrenchbook is for.",
    )
