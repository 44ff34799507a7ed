"""Named failures of a deck, each with what to do about it."""

from __future__ import annotations

from pathlib import Path

from wrenchbook.fea.failure import SolveFailed

_PACKAGES = {"ccx": "CalculiX: on Debian and Ubuntu, apt-get install calculix-ccx"}
_LOOK = (
    "The deck as it was run and all that the solver wrote are in {place} of the attempt's files."
)


def no_solver(program: str, reason: str) -> SolveFailed:
    """Return the failure of a program that cannot be started."""
    package = f" ({_PACKAGES[program]})" if program in _PACKAGES else ""
    return SolveFailed(
        "no_solver",
        f'The program "{program}" of [deck] command cannot be started: {reason}.',
        f"Install it{package} where solves run, so that it is on the PATH there, or correct the "
        "command.",
    )


def timed_out(program: str, seconds: float) -> SolveFailed:
    """Return the failure of a program that was ended because it took too long."""
    return SolveFailed(
        "timed_out",
        f'"{program}" was ended: it had not finished after {seconds:g} s.',
        "Give it more time with timeout (seconds) in [deck], or make the deck smaller.",
    )


def solver_failed(program: str, ending: str, quoted: str, folder: Path) -> SolveFailed:
    """Return the failure that a program reports, by its exit code or in its output."""
    return SolveFailed(
        "solver_failed", f'"{program}" {ending}. It printed: {quoted}', _look(folder)
    )


def not_converged(program: str, quoted: str) -> SolveFailed:
    """Return the failure of an outside solver that found no equilibrium."""
    return SolveFailed(
        "not_converged",
        f'"{program}" found no equilibrium. It printed: {quoted}',
        "Check that the load lies within what the part can carry and that its supports hold it; "
        "smaller increments in the deck may help.",
    )


def bad_output(message: str, folder: Path) -> SolveFailed:
    """Return the failure of output in which the interface's motion cannot be found."""
    return SolveFailed("bad_output", message, _look(folder))


def bad_deck(message: str, remedy: str) -> SolveFailed:
    """Return the failure of a deck that cannot take the wrench."""
    return SolveFailed("bad_deck", message, remedy)


def moment_unsettled(runs: int, gap: float) -> SolveFailed:
    """Return the failure of the search for the conjugate moment."""
    return SolveFailed(
        "not_converged",
        f"After {runs} runs the deck's moment is still {gap:.1e} off the required one.",
        'If the deck takes moments about fixed axes, say moment = "spatial" in [deck]; else the '
        "part turns too much for its moment.",
    )


def not_linear(gap: float) -> SolveFailed:
    """Return the failure of a deck that its bundle calls linear and that is not."""
    return SolveFailed(
        "not_linear",
        f"The deck's answer to this wrench is {gap:.1e} off what its answers to single loads add "
        "up to.",
        "Set nonlinear = true in [analysis], or take out of the deck what is not linear: NLGEOM, "
        "contact, plasticity, loads other than the wrench.",
    )


def not_reciprocal(message: str) -> SolveFailed:
    """Return the failure of a compliance that no elastic body can have."""
    return SolveFailed(
        "not_reciprocal",
        message,
        "Check that each placeholder stands at its own freedom with a plus sign, that point and "
        "rotation name the sets the loads act on, and that unit is the deck's.",
    )


def _look(folder: Path) -> str:
    # Not the whole path: it goes to clients, whom the server's folders do not concern.
    return _LOOK.format(place=f"{folder.parent.name}/{folder.name}")
