"""Print which causes findings name, and on which clean files they are silent, by kinds of rigs.

SEED repeats a run's; FILES is how many files there are of either sort (120). A clean file of a
part with clearance is silent if nothing but the clearance is said. Causes of `SIX` are looked for
where all six loads and displacements are measured: with fewer they have no sign or symmetry.
"""

from __future__ import annotations

import os
import secrets
import time
from collections import Counter

from tests.surrogate.findings.rigs import CAUSES, DIRECTED, SHAPES, Rig
from wrenchbook.surrogate.findings.find import find

SEED = int(os.environ.get("SEED", secrets.randbelow(10**6)))
FILES = int(os.environ.get("FILES", "120"))
KINDS = ("random", "sweeps", "motion", "slow", "several", "grid")
IN_ORDER = ("sweeps", "motion", "slow")  # the rows follow a motion
SIX = ("moments about another point", "loads in another frame", "degrees under a header of radians")
UNIQUE = (*SIX, "kilonewtons under a header of newtons", "one load with the wrong sign")
CLEAN = "none"


def rig_of(number: int, error: str) -> Rig:
    """Return a rig of the next kinds of loads and response, with or without rotations."""
    kinds, responses = IN_ORDER if error in DIRECTED else KINDS, tuple(SHAPES)
    return Rig(
        SEED + number,
        (kinds[number % len(kinds)],),
        (responses[number // len(kinds) % len(responses)],),
        rows=(60, 2000) if number % 2 else (60, 400),
        noises=(0.001, 0.003, 0.01),
        resolutions=(0.0, 0.0, 0.01),
        outputs=6 if error in UNIQUE or number % 4 else 3,
    )


def test_findings() -> None:
    errors = list(CAUSES)
    named: Counter[tuple[str, bool]] = Counter()
    said: Counter[tuple[str, str]] = Counter()
    asked: Counter[tuple[str, bool]] = Counter()
    silent, took = 0, 0.0
    for number in range(int(os.environ.get("FIRST", "0")), 2 * FILES):
        error = CLEAN if number < FILES else errors[number % len(errors)]
        rig = rig_of(number, error)
        rows = rig.measured(error)
        started = time.perf_counter()
        causes = {finding.cause for finding in find(rows, rig.range)}
        took += time.perf_counter() - started
        causes -= {"clearance"} if rig.response == "clearance" else set()
        wanted = {CAUSES[error]} if error in CAUSES else set()
        right = wanted <= causes if wanted else not causes
        for group in ("loads: " + rig.kind, "response: " + rig.response, "cause: " + error):
            asked[group, error == CLEAN] += 1
            named[group, error == CLEAN] += right
        said.update((error, cause) for cause in causes - wanted)
        silent += right and error == CLEAN
        if not right:
            about = f"{rig.kind}, {rig.response}, {len(rows)} rows of {rig.outputs}, noise"
            print(f"seed {SEED + number}: {error}: {about} {rig.noise:.1%}: {sorted(causes)}")
    total = sum(count for (group, clean), count in named.items() if group[0] == "c" and not clean)
    print(f"\nSEED={SEED} FILES={FILES}: {total / FILES:.1%} of causes named, ", end="")
    print(f"{silent / FILES:.1%} of clean files silent, {took / FILES / 2:.2f} s a file")
    for group in sorted({group for group, _ in asked}):
        parts = (f"{named[group, clean]}/{asked[group, clean]}" for clean in (False, True))
        print("{:<52}named {:>7}  silent {:>7}".format(group, *parts))
    for (error, cause), count in sorted(said.items()):
        print(f"said besides, {error}: {cause} {count}")
