"""The contents of an Abaqus or CalculiX deck besides its mesh, before groups have final names."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import NamedTuple

from wrenchbook.fea.mesh.deck_content import Constant, DeckContent
from wrenchbook.fea.mesh.io.abaqus_keywords import Keyword


@dataclass
class Coupling:
    """A coupling as read: the key of its surface or node set, and its nodes' labels."""

    keyword: Keyword
    key: str
    ref: int | None
    rot: int | None = None
    directions: str = "xyz"
    kind: str = "rigid"
    radius: float = math.inf


class Motion(NamedTuple):
    """A row of *BOUNDARY."""

    where: str
    key: str  # key of a node set; empty for a single node
    labels: list[int]
    freedoms: set[int]  # held freedoms, as indices from 0


@dataclass(eq=False)
class Motions:
    """The rows of *BOUNDARY in effect; steps that change none share the same object."""

    rows: list[Motion] = field(default_factory=list)


@dataclass
class Step:
    """Supports and forces at the end of a step; freedoms are indices from 0.

    `name` is empty if the step is no case, as for a step with load cases. `kind` is "general",
    "perturbation" or "load case". `forces` are the key and the load by label and freedom. `begun`
    has the words of the step's keywords and the keys of its forces.
    """

    name: str = ""
    kind: str = "general"
    motions: Motions = field(default_factory=Motions)
    forces: dict[tuple[int, int], tuple[str, float]] = field(default_factory=dict)
    nonlinear: bool = False
    begun: set[str | tuple[int, int]] = field(default_factory=set)

    def begin(self, keyword: Keyword) -> None:
        """At a word's first keyword, start from earlier steps' state, with OP=NEW from nothing."""
        if keyword.word not in self.begun:
            self.begun.add(keyword.word)
            new = keyword.options.get("OP", "").upper() == "NEW"
            if keyword.word == "CLOAD":
                self.forces = {} if new else dict(self.forces)
            else:
                self.motions = Motions([] if new else list(self.motions.rows))


@dataclass
class Reader:
    """Content besides the mesh; groups are keys of the deck's sets until the end."""

    content: DeckContent = field(default_factory=DeckContent)
    # For each *SOLID SECTION: line and keyword, key of its element set, material, orientation
    sections: list[tuple[str, str, str, str]] = field(default_factory=list)
    orientations: dict[str, tuple[float, ...]] = field(default_factory=dict)
    # Axes of nodes, nine numbers, if they differ from the global axes
    turned: dict[int, tuple[float, ...]] = field(default_factory=dict)
    couplings: list[Coupling] = field(default_factory=list)
    # Keyword and nodes of each element by label, and *SPRING
    springs: dict[int, tuple[Keyword, list[int]]] = field(default_factory=dict)
    spring_sections: list[Keyword] = field(default_factory=list)
    # Line and keyword, keys of both surfaces, and distance
    ties: list[tuple[str, str, str, float | None]] = field(default_factory=list)
    # By node and freedom from 0 (None: of several freedoms, or a second equation of a freedom):
    # keyword, and weights of the masters by label
    equations: dict[int, dict[int | None, tuple[Keyword, dict[int, float]]]] = field(
        default_factory=dict
    )
    # The first: contents before all steps.
    steps: list[Step] = field(default_factory=lambda: [Step()])
    sets: dict[frozenset[int], str] = field(default_factory=dict)  # keys of node sets by members
    # By reference node, the number of its coupling and the freedom that is its first, 0 or 3
    points: dict[int, tuple[int, int]] = field(default_factory=dict)
    material: str = ""  # the last *MATERIAL

    def lack(self, keyword: Keyword, message: str) -> None:
        """Note contents that matter and cannot be imported."""
        before = self.content.missing.get(keyword.where, message)
        together = before if message in before else f"{before}; it {message}"
        self.content.missing[keyword.where] = together

    @property
    def constants(self) -> dict[str, Constant]:
        """The constants of the current material."""
        return self.content.materials.setdefault(self.material, {})
