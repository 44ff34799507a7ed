"""Loads on locked freedoms are left out by the table itself, in whatever form it is asked."""

from __future__ import annotations

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
from wrenchbook.surrogate.packed.writer import packed_of
from wrenchbook.surrogate.solver_error import SolverError
from wrenchbook.surrogate.table.hdf5 import read_table, write_table
from wrenchbook.surrogate.table.meta import TableMeta
from wrenchbook.surrogate.table.rows import Rows

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
    found, expected = packed.batch(full), packed.batch(bare)
    assert not expected.coverage.any()
    for one, other in zip(found, expected, strict=True):
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
    assert [packed.answer(one, [0.0] * 6).method == "row" for one in full] == [True] * 5 + [
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
