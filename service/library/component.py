"""A component as the service sees it, and what can be wrong with one."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from fea.bundle.read import Bundle
from surrogate.table.rows import LoadRange, Tolerance


@dataclass(frozen=True)
class Component:
    """One component as the service sees it; the mesh stays with the solver."""

    name: str
    title: str
    folder: Path
    fingerprint: str
    has_fea: bool
    linear: bool
    load_range: LoadRange
    tolerance: Tolerance | None
    shipped: bool


class UnknownComponentError(KeyError):
    """No component of that name; carries the names there are."""

    def __init__(self, name: str, known: list[str]) -> None:
        super().__init__(name)
        self.name = name
        self.known = known

    def __str__(self) -> str:
        known = ", ".join(self.known) or "none yet"
        return f"There is no component {self.name!r}. The library has: {known}."


class ComponentExistsError(ValueError):
    """A component of that name is there already; nothing was changed."""


class BrokenComponentError(UnknownComponentError):
    """The component's folder is there and cannot be used; carries the reason."""

    def __init__(self, name: str, known: list[str], reason: str) -> None:
        super().__init__(name, known)
        self.reason = reason

    def __str__(self) -> str:
        return (
            f"The component {self.name!r} is in the library but cannot be used: {self.reason}. "
            "Mend the files in its folder; it is then taken up by itself."
        )


class LibraryUnavailableError(OSError):
    """The component could not be written to the disk; nothing was added."""


def component_of(bundle: Bundle, *, shipped: bool) -> Component:
    """Return the component that a checked bundle describes."""
    limit = bundle.tolerance
    return Component(
        name=bundle.name,
        title=bundle.title,
        folder=bundle.folder,
        fingerprint=bundle.fingerprint,
        has_fea=bundle.has_fea,
        linear=bundle.analysis is not None and not bundle.analysis.nonlinear,
        load_range=LoadRange(
            np.asarray(bundle.range.low, dtype=float), np.asarray(bundle.range.high, dtype=float)
        ),
        tolerance=Tolerance(limit.translation, limit.rotation) if limit else None,
        shipped=shipped,
    )
