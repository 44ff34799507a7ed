"""One wrench has the same bits alone, at any place of a batch, by any number of threads.

The kernel has one routine for all of them, `wb_reply_of`.
"""

from __future__ import annotations

import numpy as np
import pytest

from tests.slow import slow_but
from tests.surrogate.kernel.kinds import (
    KINDS,
    OF_SPACES,
    QUICK,
    asked_of,
    packed_of,
    special_of,
    table_of,
)
from wrenchbook.surrogate.answer import METHODS, NAMES, UnknownMethodError
from wrenchbook.surrogate.kernel.binding import PackedTable
from wrenchbook.surrogate.scene.cut import cut
from wrenchbook.surrogate.scene.plan import need_of


def cut_to_a_scene(kind: str, seed: int) -> PackedTable:
    """A table of some loads and outputs."""
    random, span = np.random.default_rng(seed), table_of(kind).load_range
    loads = random.random(6) < 0.5
    low, high = np.sort(random.uniform(-1, 1, (2, 6)), axis=0) * span.scale * loads
    outputs = np.flatnonzero(random.random(6) < 0.7).tolist() or [0]
    need = need_of(span, np.column_stack((low, high)), outputs)
    return PackedTable.from_bytes(b"".join(cut(packed_of(kind), need)))


def singles(table: PackedTable, asked: np.ndarray, method: str | None) -> list[np.ndarray]:
    """Outputs and errors (k, m), coverage (k,) and slopes (k, m, n), a call for each wrench."""
    unknown = (np.nan,) * table.outputs
    replies = [table.answer(wrench, None, method) for wrench in asked.tolist()]
    return [
        np.array([reply.outputs or unknown for reply in replies], dtype=float),
        np.array([reply.error or unknown for reply in replies], dtype=float),
        np.array([NAMES.index(reply.coverage) for reply in replies], dtype=np.uint8),
        np.array([table.derivative(wrench, None, method) for wrench in asked]),
    ]


WHOLE = [(kind, None) for kind in (*KINDS, *OF_SPACES)]
CUT = [(kind, scene) for kind in KINDS for scene in (1, 2)]
FEW = {*((kind, None) for kind in QUICK), ("clean and full", 1), ("second derivatives of some", 2)}


@pytest.mark.parametrize(("kind", "scene"), slow_but(FEW, WHOLE + CUT))
def test_one_wrench_has_the_same_bits_alone_and_in_any_batch(kind: str, scene: int | None) -> None:
    table = packed_of(kind) if scene is None else cut_to_a_scene(kind, scene)
    whole = table_of(kind)
    asked = np.concatenate((asked_of(whole, 20, span=1.2), special_of(whole, 20)[:40]))
    for method in (None, *METHODS):
        try:
            alone = singles(table, asked, method)
        except UnknownMethodError:
            continue
        for size, threads in ((1, 1), (7, 1), (len(asked), 1), (4099, 1), (4099, 2), (4099, 3)):
            if method and size > 2048:  # wrenches of a block, which one thread answers
                continue
            places = np.resize(np.arange(len(asked)), size)
            batch = table.batch(asked[places], None, method, threads)
            for column, expected in zip(batch, alone, strict=False):
                np.testing.assert_array_equal(column, expected[places])
            if size < 2048 or threads == 2:
                slopes = table.derivatives(asked[places[:2051]], None, method, threads)
                np.testing.assert_array_equal(slopes, alone[3][places[:2051]])
