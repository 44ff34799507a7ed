"""Findings of what only the order of the rows shows: hysteresis, drift, sessions, zero offset."""

from __future__ import annotations

import numpy as np

from ..kriging.effects import Effects
from ..table.rows import Floats
from ..table.space import OUTPUTS
from .response import REMARKABLE, Cause, RigFinding

MESSAGES: dict[Cause, str] = {
    "hysteresis": "loading and unloading differ by {part:.1%} of the range of {name}: hysteresis "
    "of the rig (friction, joints), or loads and displacements shifted in time (lag of joined "
    "logs). Answers are in the middle, and their error bars hold both branches",
    "drift": "the displacements drift by {part:.1%} of the range of {name} from the first row to "
    "the last, whatever the load: warm the rig up, or return to zero between runs and import with "
    "a zero offset. Answers are those of the middle of the time",
    "session": "sessions differ by up to {part:.1%} of the range of {name} from their mean, "
    "whatever the load: return to zero before each, and import with a zero offset. Answers are "
    "those of the mean",
    "zero": "{name} is {part:.1%} of its range at no load: import with a zero offset, unless the "
    "part is preloaded, has a play, or the reference of its displacement is another one",
}


def effect_findings(effects: Effects, displacement: Floats) -> list[RigFinding]:
    """Return a finding of each remarkable effect in rows with displacements (n, 6), m and rad."""
    ranges = np.fmax.reduce(displacement) - np.fmin.reduce(displacement)  # NaN: not measured
    findings = list[RigFinding]()
    causes: tuple[tuple[Cause, str, Floats], ...] = (
        ("hysteresis", "loop", np.abs(effects.loop)[None]),
        ("drift", "drift", effects.drift),
        ("session", "offset", effects.session),
        ("zero", "offset", effects.zero[None]),
    )
    for cause, entry, sizes in causes:
        most = sizes[np.abs(sizes).argmax(axis=0), np.arange(len(ranges))]
        remarkable = np.flatnonzero(np.abs(most) > REMARKABLE * ranges)
        if not len(remarkable):
            continue
        parts = np.abs(most[remarkable]) / ranges[remarkable]
        name, part = OUTPUTS[remarkable[parts.argmax()]], parts.max()
        numbers = {entry: {OUTPUTS[output]: float(most[output]) for output in remarkable}}
        findings.append(
            RigFinding(cause, MESSAGES[cause].format(part=part, name=name), (), numbers)
        )
    return findings
