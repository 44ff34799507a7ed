"""No table gives an estimate that no row could have: beyond 20 degrees or 10 m."""

from __future__ import annotations

import math
from dataclasses import replace
from itertools import chain
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest

from tests.surrogate.kriging.responses import RESPONSES, solved
from tests.surrogate.law import build
from tests.surrogate.responses import HIGH, RANGE
from wrenchbook.surrogate.kernel.reasons import LEAVES_LIMITS
from wrenchbook.surrogate.packed.writer import packed_of
from wrenchbook.surrogate.solver_error import SolverError
from wrenchbook.surrogate.table.hdf5 import read_table, write_table
from wrenchbook.surrogate.table.meta import TableMeta
from wrenchbook.surrogate.table.rows import LoadRange, Rows

TURN = math.radians(20.0)
EDGE = [
    ((10.0, 0, 0, 0, 0, 0), True),
    ((0, -10.001, 0, 0, 0, 0), False),
    ((0, 0, 0, 0, TURN, 0), True),
    ((0, 0, 0, 0, 0.8 * TURN, -0.8 * TURN), False),
    ((0, 0, 0, 1e6, 0, 0), False),
    ((None, 3.0, None, None, 0.1, None), True),
    ((None, 30.0, None, None, 0.1, None), False),
]


@pytest.mark.parametrize(("moved", "given"), EDGE)
def test_one_answer_and_a_batch_draw_the_same_line(
    moved: tuple[float | None, ...], given: bool
) -> None:
    reported = np.zeros((6, 6))
    reported[0] = np.array(moved, dtype=float) / 2
    reported[1:, np.isnan(reported[0])] = np.nan
    for high, coverage in ((2.0, "covered"), (1.0, "outside")):
        span = LoadRange(-np.full(6, high), np.full(6, high))
        packed = packed_of(build(Rows.of(np.eye(6), reported), span, linear=True))
        wrench = [2.0, 0, 0, 0, 0, 0]
        one, many = packed.answer(wrench, [1e9] * 6), packed.batch([wrench], [1e9] * 6)
        assert one.coverage == coverage
        assert (LEAVES_LIMITS in one.reason) == (not given and coverage == "outside")
        if LEAVES_LIMITS in one.reason:
            assert (one.outputs, one.error) == (None, None)
            assert np.isnan(many.outputs).all()
            assert np.isnan(many.errors).all()
        else:
            assert one.outputs == pytest.approx(moved)
            np.testing.assert_allclose(many.outputs[0], np.array(moved, dtype=float))


def soft(partial: bool) -> Rows:
    """Rows along z that turn by 14 degrees at the range's end; some lack rotations if partial."""
    wrench = np.linspace(-1, 1, 9)[:, None] * np.array([0, 0, 1.0, 0, 0, 0])
    moved = wrench[:, 2:3] * np.array([0, 0, 1.0, TURN / 2, TURN / 2, 0])
    if partial:
        moved[:, 3] = np.nan
        moved[::2, 4] = np.nan
    return Rows.of(wrench, moved)


@pytest.mark.parametrize("partial", [False, True])
def test_a_table_leaves_out_estimates_beyond_the_limits(partial: bool) -> None:
    """Of several groups of outputs the whole displacement counts, and all of it goes."""
    table = build(soft(partial), LoadRange(-np.ones(6), np.ones(6)))
    assert table.answer([0, 0, 1.3, 0, 0, 0]).displacement is not None
    for load in (2.5, 20.0):
        wrench = [0, 0, load, 0, 0, 0]
        answer, result = packed_of(table).answer(wrench), table.batch([wrench])
        assert (answer.outputs, answer.error) == (None, None)
        assert LEAVES_LIMITS in answer.reason
        assert answer.coverage == "outside"
        assert np.isnan(result.displacement).all()
        assert np.isnan(result.error).all()


def test_a_row_beyond_the_limits_answers_its_own_wrench() -> None:
    """No import takes one, but what a table has it tells."""
    rows = Rows.of([[0, 0, 3.0, 0, 0, 0]], [[0, 0, 30.0, 0, 0, 0]], source=np.array(["fea"]))
    answer = build(rows, _RANGE).answer(rows.wrench[0].tolist())
    assert (answer.method, answer.coverage) == ("row", "covered")
    assert answer.displacement == tuple(rows.displacement[0].tolist())


_RANGE = LoadRange(-np.ones(6), np.ones(6))


LOCKED = (0, 1, 3, 4)  # of a guide along z
FREE = [2, 5]
MESH = SolverError({"mesh": np.full((6, 6), 1e-9).tolist(), "loads": HIGH.tolist()})


def guided(partial: bool = False) -> Any:
    wrenches = np.random.default_rng(4).uniform(-1, 1, (30, 6)) * np.isin(np.arange(6), FREE)
    rows = solved(RESPONSES["hardening"], wrenches)
    slopes = np.where(np.isin(np.arange(6), FREE), rows.compliance, 0.0)
    rows = replace(rows, compliance=slopes)
    if partial:
        lacking = np.where(np.arange(6) == 4, np.nan, rows.displacement)
        rows = Rows.of(rows.wrench, lacking, compliance=slopes)
    return build(rows, RANGE, locked=LOCKED, solver_error=MESH)


@pytest.mark.parametrize("partial", [False, True])
def test_no_call_of_a_table_sees_the_loads_on_locked_freedoms(partial: bool) -> None:
    table = guided(partial)
    bare = np.concatenate((table.rows.wrench[:5], table.rows.wrench[5:15] * 0.7))
    full = bare + np.isin(np.arange(6), LOCKED) * 2.0 * HIGH  # beyond the range
    packed = packed_of(table)
    results, expected = packed.batch(full), packed.batch(bare)
    assert not expected.coverage.any()
    for one, other in zip(results, expected, strict=True):
        np.testing.assert_array_equal(one, other)
    slopes = packed.derivatives(full)
    np.testing.assert_array_equal(slopes, packed.derivatives(bare))
    known = np.isfinite(expected.outputs[0])
    assert not slopes[:, known][:, :, LOCKED].any()
    for with_all, without in zip(full.tolist(), bare.tolist(), strict=True):
        for tolerance in (None, [0.0] * 6):  # by the method, and at rows by the row
            assert packed.answer(with_all, tolerance) == packed.answer(without, tolerance)
        axes = [table.explain(asked) for asked in (with_all, without)]
        for axis in chain(*axes):
            del axis["inputs"]
        assert axes[0] == axes[1]
    assert [packed.answer(item, [0.0] * 6).method == "row" for item in full] == [True] * 5 + [
        False
    ] * 10


def test_a_file_has_the_names_of_the_locked_freedoms(tmp_path: Path) -> None:
    path = tmp_path / "spring.h5"
    write_table(path, Rows.empty(), TableMeta("spring", 0, RANGE, locked=LOCKED))
    assert read_table(path)[1].locked == LOCKED
    with h5py.File(path) as file:
        assert file.attrs["locked"] == "ux uy rx ry"
    write_table(path, Rows.empty(), TableMeta("spring", 0, RANGE))
    assert read_table(path)[1].locked == ()


def test_a_file_without_the_entry_locks_nothing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As files of version 0.2 are."""
    monkeypatch.setattr(h5py.AttributeManager, "__setitem__", _all_but_locked)
    write_table(tmp_path / "old.h5", Rows.empty(), TableMeta("old", 0, RANGE, locked=LOCKED))
    monkeypatch.undo()
    assert read_table(tmp_path / "old.h5")[1].locked == ()


def _all_but_locked(attributes: h5py.AttributeManager, name: str, value: object) -> None:
    if name != "locked":
        attributes.create(name, data=value)
