"""A file of another solver, written as an Abaqus deck."""

from __future__ import annotations

from collections import Counter, defaultdict
from collections.abc import Iterable
from dataclasses import dataclass, field


@dataclass
class Case:
    """A load case: rows of ``*BOUNDARY`` and of ``*CLOAD``."""

    name: str = ""
    held: list[str] = field(default_factory=list)
    loads: list[str] = field(default_factory=list)


@dataclass
class Translated:
    """A deck in the making; all entries are text as it goes into the deck.

    Attributes
    ----------
    nodes
        Rows of ``*NODE``.
    elements
        By type and region, numbers of element and nodes.
    constants
        By material, rows by keyword.
    sections
        Material by region.
    groups
        Nodes by name.
    ties
        Lines of couplings.
    cases
        Each a step.
    left
        How often each thing occurs that is not in the deck.
    decide
        What the file leaves open.
    """

    nodes: list[str] = field(default_factory=list)
    elements: dict[tuple[str, str], list[list[str]]] = field(
        default_factory=lambda: defaultdict(list)
    )
    constants: dict[str, dict[str, str]] = field(default_factory=lambda: defaultdict(dict))
    sections: dict[str, str] = field(default_factory=dict)
    groups: dict[str, list[str]] = field(default_factory=lambda: defaultdict(list))
    ties: list[str] = field(default_factory=list)
    cases: list[Case] = field(default_factory=list)
    left: Counter[str] = field(default_factory=Counter)
    decide: list[str] = field(default_factory=list)
    nonlinear: bool = False

    def lines(self) -> list[str]:
        """Return the deck."""
        lines = ["*NODE", *self.nodes]
        for (kind, region), rows in self.elements.items():
            lines.append(f"*ELEMENT, TYPE={kind}, ELSET={region}")
            lines += [",\n".join(_rows(row)) for row in rows]
        for name, nodes in self.groups.items():
            lines += [f"*NSET, NSET={name}", *_rows(nodes)]
        for name, constants in self.constants.items():
            lines.append(f"*MATERIAL, NAME={name}")
            lines += [f"*{word}\n{row}" for word, row in constants.items()]
        known = {region for _, region in self.elements}
        pairs = ((region, name) for region, name in self.sections.items() if region in known)
        lines += [f"*SOLID SECTION, ELSET={region}, MATERIAL={name}" for region, name in pairs]
        lines += self.ties
        before = Case()
        for case in self.cases or [before]:
            lines.append(f"*STEP, NAME={case.name}" + ", NLGEOM" * self.nonlinear)
            if case.held != before.held:  # a step keeps what it does not change
                lines += ["*BOUNDARY, OP=NEW", *case.held]
            if case.loads != before.loads:
                lines += ["*CLOAD, OP=NEW", *case.loads]
            lines.append("*END STEP")
            before = case
        return [*lines, ""]

    def tie(self, name: str, nodes: list[str], reference: str, kind: str) -> None:
        """Let nodes follow a reference node ("KINEMATIC"), or it their mean ("DISTRIBUTING")."""
        self.groups[name] = nodes
        self.ties += [f"*SURFACE, TYPE=NODE, NAME={name}", name]
        self.ties += [f"*COUPLING, CONSTRAINT NAME={name}, SURFACE={name}, REF NODE={reference}"]
        self.ties.append(f"*{kind}")


def _rows(texts: Iterable[str]) -> list[str]:
    texts = list(texts)
    return [", ".join(texts[i : i + 10]) for i in range(0, len(texts), 10)]
