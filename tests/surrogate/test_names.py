"""The names of loads and outputs: one spelling in everything that leaves the room as data."""

from __future__ import annotations

import json

from tests.surrogate.law import build
from tests.surrogate.responses import RANGE, clean_wrenches, smooth, table
from wrenchbook.service.contract import LOADS, OUTPUTS
from wrenchbook.surrogate.table.physics_checks import check_physics

SYMBOLS = {name[0].upper() + "_" + name[1] for name in (*LOADS, *OUTPUTS)}


def keys_and_words(value: object) -> set[str]:
    """Return all keys, and all texts in lists, of nested JSON values."""
    if isinstance(value, dict):
        return set(value).union(*map(keys_and_words, value.values()))
    if isinstance(value, list):
        texts = {one for one in value if isinstance(one, str)}
        return texts.union(*map(keys_and_words, value))
    return set()


def test_no_key_or_list_that_leaves_the_room_spells_them_another_way() -> None:
    surrogate = build(table(smooth, clean_wrenches(30, 1)), RANGE)
    told = {
        "explained": surrogate.explain([100.0, 50, 30, 4, 5, 6]),
        "linear": surrogate.explain([100.0, 50, 30, 4, 5, 6], None, "linear"),
        "gaps": surrogate.axes.gaps(surrogate.load_range),
        "summary": surrogate.coverage_summary(),
        "checks": check_physics(surrogate.rows, RANGE, surrogate.fit),
    }
    words = keys_and_words(json.loads(json.dumps(told)))
    assert not words & {*SYMBOLS, *(name.upper() for name in (*LOADS, *OUTPUTS))}
    assert {*LOADS, *OUTPUTS} <= words
