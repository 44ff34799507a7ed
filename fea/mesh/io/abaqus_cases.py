"""Groups of single nodes in a deck, and whether its last case has those of all cases.

Apart from the reader of decks, because `fea.bundle` imports no numerics.
"""

import re

HELD_IN = "nodes_held_in_"
"""Name of a group of single nodes that *BOUNDARY holds, before its directions."""
WITH_FORCES = "nodes_with_forces"
"""Name of the group of single nodes with forces of *CLOAD."""

_CASES = ("STEP", "LOAD CASE")
_KEYWORD = re.compile(
    r"^[^\w*\n]*\*[ \t]*(BOUNDARY|CLOAD|STEP|LOAD CASE)\b([^*]*)", re.A | re.I | re.M
)
_ANEW = re.compile(r",\s*(?:OP\s*=\s*NEW|PERTURBATION)\b", re.A | re.I)


def drops_nodes(deck: str) -> bool:
    """Whether the last case of a deck may lack held or loaded nodes of the cases before it.

    It may if there are two load cases, if one of several steps is a perturbation, or if a step
    removes earlier conditions (OP=NEW). Otherwise each step adds to the one before.
    """
    keywords = [
        (word.upper(), _ANEW.search(options) is not None)
        for word, options in _KEYWORD.findall(deck)
    ]
    cases = [(word, anew) for word, anew in keywords if word in _CASES]
    if sum(word == "LOAD CASE" for word, _ in cases) > 1:
        return True
    if len(cases) > 1 and ("STEP", True) in cases:
        return True
    conditions = [i for i, (word, _) in enumerate(keywords) if word not in _CASES]
    removing = [i for i in conditions if keywords[i][1]]
    return bool(removing) and any(
        word in _CASES for word, _ in keywords[conditions[0] : removing[-1]]
    )
