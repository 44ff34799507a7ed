"""What the check of a bundle found when it was uploaded, and the interface it describes."""

from __future__ import annotations

import json
from functools import lru_cache
from pathlib import Path
from typing import Any

from wrenchbook.fea.bundle.read import read_bundle
from wrenchbook.service.contract import MOMENT_POINT
from wrenchbook.service.library.component import Component
from wrenchbook.service.library.library import CHECK_FILE


def interface_of(component: Component) -> dict[str, Any] | None:
    """Return the interface of a component in SI; None if it has no finite-element setup.

    Returns
    -------
    dict
        ``section``, ``point`` (shape (3,), m; None for the section's area centre while no check has
        told where that is), ``axes`` (shape (3, 3), one axis a row), ``coupling``, ``locked`` and
        ``moment``, in words.
    """
    return _interface(component.folder, component.fingerprint)


def warnings_of(folder: Path) -> list[dict[str, str]]:
    """Return what the check of a bundle warned of, each ``{"where", "message"}``."""
    return _report(folder).get("warnings", [])


def estimate_of(folder: Path) -> dict[str, Any]:
    """Return what a solve takes by the check of a bundle (`fea.check.cost`); empty if unknown."""
    found = _report(folder).get("estimate")
    return found if isinstance(found, dict) else {}


def solver_error_of(folder: Path, fingerprint: str) -> dict[str, Any] | None:
    """Return what the check of a bundle estimated its solver to be wrong by, if of that set-up."""
    report = _report(folder)
    found = report.get("solver_error") if report.get("fingerprint") == fingerprint else None
    return found if isinstance(found, dict) and found.get("mesh") is not None else None


def vibration_of(folder: Path) -> dict[str, Any] | None:
    """Return mass and first natural frequency as the check of a bundle found them.

    By itself, without what it will carry: ``mass`` (kg), ``first_frequency`` (Hz), ``motion`` (six
    numbers, m and rad). None where the bundle tells no density or no check has been stored.
    """
    return _report(folder).get("vibration") or None


@lru_cache(maxsize=256)
def _interface(folder: Path, _fingerprint: str) -> dict[str, Any] | None:
    """Read once for each fingerprint: reading a bundle hashes its mesh."""
    interface = read_bundle(folder).interface
    if interface is None:
        return None
    point = interface.point
    return {
        "section": interface.section,
        "point": _report(folder).get("section", {}).get("point")
        if point is None
        else point.tolist(),
        "axes": interface.axes.tolist(),
        "coupling": interface.coupling,
        "locked": list(interface.locked),
        "moment": f"about {MOMENT_POINT}",
    }


def _report(folder: Path) -> dict[str, Any]:
    """Return the stored report; an empty one where no check has been stored."""
    try:
        found = json.loads((folder / CHECK_FILE).read_text("utf-8"))
    except (OSError, ValueError):
        return {}
    return found if isinstance(found, dict) else {}
