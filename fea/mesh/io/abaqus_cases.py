"""Groups of single nodes in a deck, apart because `fea.bundle` reads decks without numerics."""

import re

HELD_IN = "nodes_held_in_"  # begins the name of a group of single nodes that *BOUNDARY holds
WITH_FORCES = "nodes_with_forces"  # name of the group of single nodes with forces of *CLOAD

_CASES = ("STEP", "LOAD CASE")
_KEYWORD = re.compile(r"(?aim)^[^\w*\n]*\*[ \t]*(BOUNDARY|CLOAD|STEP|LOAD CASE)\b([^*]*)")
_ANEW = re.compile(r"(?ai),\s*(?:OP\s*=\s*NEW|PERTURBATION)\b")


def drops_nodes(deck: str) -> bool:
    """Whether the last case of a deck may lack held or loaded nodes of the cases before it.

    It may if there are two load cases, if one of several steps is a perturbation, or if a step
    removes earlier conditions (OP=NEW). Otherwise each step adds to the one before.
    """
    cases: list[tuple[str, bool]] = []
    has_conditions = is_later = False  # whether conditions are above, and a case after these
    for name, options in _KEYWORD.findall(deck):
        word, anew = name.upper(), _ANEW.search(options) is not None
        if word in _CASES:
            cases.append((word, anew))
            is_later |= has_conditions
        elif anew and is_later:
            return True
        has_conditions |= word not in _CASES
    load_cases = sum(word == "LOAD CASE" for word, _ in cases)
    return load_cases > 1 or (len(cases) > 1 and ("STEP", True) in cases)
