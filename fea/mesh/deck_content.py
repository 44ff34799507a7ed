"""Content of an input deck besides its mesh: materials, sections, and load cases.

All numbers are in the deck's units, which a deck does not state; `si_factor` converts them by its
length unit and the usual force unit of that length unit.
"""

from __future__ import annotations

import re
from dataclasses import dataclass, field, replace

import numpy as np

from wrenchbook.fea.spec.mesh_source import UNITS
from wrenchbook.fea.spec.schema import FREEDOMS, Tie

_FORCES = {"in": 4.4482216152605, "ft": 4.4482216152605, "um": 1e-6}
"""Force unit in N of a length unit: pounds for inches and feet, micronewtons for micrometres.

All others go with newtons.
"""

_HEX20 = re.compile(r"^\s*\*ELEMENT\s*,[^*]*?\bTYPE\s*=\s*C3D20(\w*)", re.I | re.M)


def integrations(text: str) -> list[str]:
    """Return how a deck integrates its 20-node hexahedra: "full" (C3D20), "reduced" (C3D20R)."""
    kinds = {"reduced" if "R" in letters.upper() else "full" for letters in _HEX20.findall(text)}
    return sorted(kinds)


def si_factor(quantity: str, unit: str) -> float:
    """Return the factor from a deck's consistent units to SI.

    quantity: a key of ``[[material]]``, ``length``, ``force`` or ``moment``; others have no unit.
    unit: the deck's length unit, a key of `fea.spec.mesh_source.UNITS`.
    """
    length = UNITS[unit]
    force = _FORCES.get(unit, 1.0)
    stress = force / length**2
    factors = {"youngs_modulus": stress, "yield_strength": stress, "density": stress / length**2}
    factors |= {"shear_modulus": stress, "length": length, "force": force, "moment": force * length}
    return factors.get(quantity, 1.0)


Constant = float | tuple[float, ...]


@dataclass(frozen=True)
class SolidSection:
    """A cell group and the name of its material; `where` is the line and keyword.

    `orientation` are the material's directions in rows, nine numbers, or a point of a cylinder's
    axis, in the deck's length unit, and its direction, six; empty: the global axes.
    """

    where: str
    region: str
    material: str
    orientation: tuple[float, ...] = ()


@dataclass(frozen=True)
class HeldGroup:
    """A node or facet group that does not move along `directions`, such as "xyz".

    `axes` are nine numbers, the directions x, y, z in rows; empty: the global axes.
    """

    where: str
    group: str
    directions: str
    axes: tuple[float, ...] = ()


@dataclass
class CoupledGroup:
    """A group that a reference point moves, or whose mean motion is the point's."""

    where: str  # line and keyword
    group: str  # a facet or node group
    kind: str  # "rigid" or "distributed"
    # Position of the reference point, in the deck's length unit; empty if it has no node
    point: tuple[float, ...] = ()
    # Freedoms of the point that a support holds, as indices 0 to 5
    held: set[int] = field(default_factory=set)
    # Force and moment on the point in the deck's units
    loads: list[float] = field(default_factory=lambda: [0.0] * 6)
    weighted: bool = False  # whether the deck weights the nodes of its mean
    directions: str = "xyz"  # the global directions along which it moves its group


@dataclass(frozen=True, eq=False)
class DeckSpring:
    """A spring from the point of a coupling to the ground, or between two, at the first's point."""

    where: str
    ends: tuple[CoupledGroup, ...]
    stiffness: np.ndarray  # shape (6, 6), along the global axes, in the deck's units

    def stiffness_in_si(self, unit: str) -> np.ndarray:
        """Return the stiffness in N/m, N and N·m for the deck's length unit."""
        length = si_factor("length", unit)
        size = np.repeat([1.0, length], 3)
        return self.stiffness * np.outer(size, size) * si_factor("force", unit) / length


@dataclass
class LoadCase:
    """Supports and loads of a step, load case or subcase of a deck; groups are the mesh's.

    `loads` are sums of forces on groups without a coupling, shape (6,).
    """

    name: str
    supports: list[HeldGroup] = field(default_factory=list)
    couplings: list[CoupledGroup] = field(default_factory=list)
    springs: list[DeckSpring] = field(default_factory=list)
    loads: dict[str, list[float]] = field(default_factory=dict)
    nonlinear: bool = False

    def conditions(self) -> str:
        """Supports, couplings, springs and loads with all digits, to tell cases apart."""
        supports = sorted((held.group, held.directions, held.axes) for held in self.supports)
        couplings = [replace(coupled, where="") for coupled in self.couplings]
        springs = [
            ([replace(end, where="") for end in spring.ends], spring.stiffness.tolist())
            for spring in self.springs
        ]
        return repr((supports, couplings, springs, sorted(self.loads.items()), self.nonlinear))

    def summary(self) -> str:
        """Supports and loads in words, in the deck's units."""
        held = [f"{support.group} ({support.directions})" for support in self.supports]
        held += [
            f"{coupled.group} ({', '.join(FREEDOMS[at] for at in sorted(coupled.held))})"
            for coupled in self.couplings
            if coupled.held
        ]
        held += [f"{end.group} (on springs)" for spring in self.springs for end in spring.ends]
        acting = [
            *((coupling.group, coupling.loads) for coupling in self.couplings),
            *self.loads.items(),
        ]
        loads = [
            f"{group} ({', '.join(f'{load:g}' for load in values)})"
            for group, values in acting
            if any(values)
        ]
        held, loads = (", ".join(sorted(set(names))) or "nothing" for names in (held, loads))
        nonlinear = "; large displacements" if self.nonlinear else ""
        return f"holds {held}; loads {loads}{nonlinear}"


@dataclass
class DeckContent:
    """Content of a deck besides its mesh; sections and cases are in the order of the deck."""

    # Constants of each material by the keys of ``[[material]]``, three of an orthotropic one
    materials: dict[str, dict[str, Constant]] = field(default_factory=dict)
    sections: list[SolidSection] = field(default_factory=list)
    # At least one; definitions before the first step act in all cases.
    cases: list[LoadCase] = field(default_factory=list)
    elements: dict[str, int] = field(default_factory=dict)  # number of elements of each type
    taken: dict[str, list[int]] = field(default_factory=dict)  # lines of keywords that are read
    ignored: dict[str, list[int]] = field(default_factory=dict)  # lines of all other keywords
    # By line and keyword: contents that matter and cannot be imported, and the remedy
    missing: dict[str, str] = field(default_factory=dict)
    left_out: dict[str, str] = field(default_factory=dict)  # by surface, its line and the cause
    ties: list[tuple[str, Tie]] = field(default_factory=list)  # with line and keyword, deck's unit

    @property
    def notes(self) -> list[str]:
        """The texts of `missing`; a note of several keywords, such as of equations, once."""
        lines: dict[tuple[str, str], list[str]] = {}
        for where, note in self.missing.items():
            line, _, word = where.rpartition(": ")
            lines.setdefault((word, note), []).append(line)
        return [
            f"{first}{f' and {len(more)} more' if more else ''}: {word} {note}"
            for (word, note), (first, *more) in lines.items()
        ]
