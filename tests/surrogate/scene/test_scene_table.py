"""A table cut to a scene: the same answers as the whole, from less."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from surrogate.answer import NAMES
from surrogate.build import AnyTable, build
from surrogate.derivative import derivatives_at
from surrogate.scene.file import SceneFileError, read_scene, write_scene
from surrogate.scene.memory import array_bytes
from surrogate.scene.need import Need, need_of
from surrogate.scene.scene_table import OtherMethodError, SceneTable, scene_table
from surrogate.table.rows import Rows, Tolerance
from tests.surrogate.kriging.responses import RESPONSES, solved
from tests.surrogate.responses import HIGH, RANGE, clean_wrenches, coupled, full_wrenches, table

PLANAR = (0, 2, 4)  # fx, fz, my
EQUAL = 1e-12


@cache
def whole(kind: str) -> AnyTable:
    """Tables of each default method, and one of a rig that measured three outputs."""
    mixed = np.concatenate((np.zeros((1, 6)), clean_wrenches(9, 1), full_wrenches(25, 2)))
    if kind == "kriging":
        return build(solved(RESPONSES["hardening"], full_wrenches(40, 3)), RANGE)
    if kind == "griddata":
        return build(table(coupled, clean_wrenches(14, 4)), RANGE)
    if kind == "both":  # griddata held against what the axes leave out
        return build(table(coupled, mixed), RANGE, tolerance=Tolerance(1e-4, 1e-3))
    if kind == "linear":
        return build(solved(RESPONSES["nearly_linear"], full_wrenches(1, 5)), RANGE, linear=True)
    rows = table(coupled, mixed)
    lacking = rows.displacement.copy()
    lacking[10:, 3:] = np.nan
    lacking[:, 1] = np.nan
    return build(Rows.of(rows.wrench, lacking), RANGE)


KINDS = ("kriging", "griddata", "both", "linear", "partial")


def need(loads: tuple[int, ...] = PLANAR, outputs: tuple[int, ...] = tuple(range(6))) -> Need:
    bounds = np.where(np.isin(np.arange(6), loads)[:, None], [-1.0, 1.0], 0.0) * HIGH[:, None]
    return need_of(RANGE, bounds, outputs)


def within(wanted: Need, count: int = 60, seed: int = 9) -> np.ndarray:
    low, high = wanted.span.low, wanted.span.high
    return np.random.default_rng(seed).uniform(size=(count, 6)) * (high - low) + low


def assert_equal(cut: SceneTable, full: AnyTable, wrenches: np.ndarray) -> None:
    told, own = full.batch(wrenches), cut.batch(wrenches)
    read = list(cut.need.outputs)
    size = np.nanmax(np.abs(told.displacement), axis=0, initial=0.0) + 1e-30
    for mine, theirs in ((own.displacement, told.displacement), (own.error, told.error)):
        assert (np.isnan(mine) == np.isnan(theirs))[:, read].all()
        assert np.nanmax(np.abs(mine - theirs)[:, read] / size[read], initial=0.0) <= EQUAL


@pytest.mark.parametrize("kind", KINDS)
def test_a_planar_scene_has_the_whole_tables_answers_and_bars(kind: str) -> None:
    wanted = need()
    assert_equal(scene_table(whole(kind), wanted), whole(kind), within(wanted))


@pytest.mark.parametrize("kind", KINDS)
def test_single_answers_are_those_of_a_batch_and_of_the_whole_table(kind: str) -> None:
    wanted = need()
    cut = scene_table(whole(kind), wanted)
    wrenches = np.concatenate((within(wanted, 12), np.zeros((1, 6))))
    many = cut.batch(wrenches)
    for place, wrench in enumerate(wrenches.tolist()):
        one, full = cut.answer(wrench), whole(kind).answer(wrench)
        moved = np.array(one.displacement or [None] * 6, dtype=float)
        np.testing.assert_allclose(moved, many.displacement[place], rtol=1e-12, atol=1e-18)
        assert one.coverage == NAMES[many.coverage[place]] == full.coverage
        assert one.method == full.method
        assert one.missing == getattr(full, "missing", ())
        if kind != "partial":
            assert one.reason == full.reason


@settings(max_examples=40)
@given(
    kind=st.sampled_from(KINDS),
    ends=st.lists(st.tuples(st.floats(-1, 1), st.floats(-1, 1)), min_size=6, max_size=6),
    held=st.lists(st.sampled_from(["free", "zero", "fixed"]), min_size=6, max_size=6),
    outputs=st.sets(st.integers(0, 5), min_size=1),
)
def test_any_scene_has_the_whole_tables_answers(kind, ends, held, outputs) -> None:
    bounds = np.array([sorted(pair) for pair in ends]) * HIGH[:, None]
    for load, how in enumerate(held):
        if how == "zero":
            bounds[load] = 0.0
        elif how == "fixed":
            bounds[load] = bounds[load, 0]
    wanted = need_of(RANGE, bounds, tuple(outputs))
    assert_equal(scene_table(whole(kind), wanted), whole(kind), within(wanted, 20))


@pytest.mark.parametrize("kind", KINDS)
def test_a_file_of_it_is_the_same_table(kind: str) -> None:
    wanted = need(PLANAR, (2, 4))
    cut = scene_table(whole(kind), wanted, {"decision": "table"})
    again = read_scene(write_scene(cut))
    asked = within(wanted)
    for before, after in zip(cut.batch(asked), again.batch(asked), strict=True):
        np.testing.assert_array_equal(before, after)
    np.testing.assert_array_equal(cut.derivatives(asked), again.derivatives(asked))
    assert again.plan == {"decision": "table"}
    assert (again.version, again.default) == (cut.version, cut.default)


def test_what_is_no_file_of_a_scene_is_named() -> None:
    good = write_scene(scene_table(whole("linear"), need()))
    for bad in (b"", b"PK\x03\x04", good[: len(good) // 2], b"\x93NUMPY"):
        with pytest.raises(SceneFileError, match="no scene's table"):
            read_scene(bad)


def test_a_planar_scene_keeps_less_than_half_of_the_memory() -> None:
    full = whole("kriging")
    full.answer([0.0] * 6)
    cut = scene_table(full, need())
    cut.answer([0.0] * 6)
    assert array_bytes(cut) < 0.5 * array_bytes(full)


def test_an_output_that_is_not_read_is_not_answered_and_not_judged() -> None:
    tight = Tolerance(1e-12, 1.0)  # no translation is that sure, every rotation is
    cut = scene_table(whole("kriging"), need(PLANAR, (3, 4)))
    wrench = within(cut.need, 1)[0].tolist()
    told = cut.answer(wrench, tight)
    assert told.coverage == "covered"
    assert told.displacement is not None
    assert [one is None for one in told.displacement] == [True] * 3 + [False, False, True]
    assert told.missing == ("ux", "uy", "uz", "rz")
    assert whole("kriging").answer(wrench, tight).coverage == "thin"


def test_a_load_that_cannot_occur_has_no_answer_and_is_named() -> None:
    cut = scene_table(whole("kriging"), need())
    told = cut.answer([10.0, 3.0, 0.0, 0.0, 0.0, 0.0])
    assert (told.coverage, told.displacement, told.error) == ("outside", None, None)
    assert told.reason == "fy = 3 N cannot occur in the scene: 0..0 N"
    assert np.isnan(cut.batch([[10.0, 3.0, 0.0, 0.0, 0.0, 0.0]]).displacement).all()


def test_a_load_beyond_the_scenes_range_is_flagged_and_estimated_without_a_bar() -> None:
    wanted = need_of(RANGE, np.array([[-10.0, 10.0]] * 6))
    cut = scene_table(whole("kriging"), wanted)
    wrench = [11.0, 0.0, 0.0, 0.0, 0.0, 0.0]
    told = cut.answer(wrench)
    assert (told.coverage, told.error) == ("outside", None)
    assert told.displacement == whole("kriging").answer(wrench).displacement


def test_a_row_of_the_scene_answers_its_own_wrench_where_nothing_else_does() -> None:
    full = whole("griddata")
    wanted = need((0, 4, 5))
    cut = scene_table(full, wanted)
    rows = full.rows.wrench[(full.rows.wrench[:, [1, 2, 3]] == 0).all(axis=1)]
    assert len(rows)
    for wrench in rows.tolist():
        assert cut.answer(wrench, Tolerance(1e-12, 1e-12)).method == "row"
        assert cut.source_of(wrench) is not None
    assert len(cut.rows) < len(full.rows)


@pytest.mark.parametrize("kind", KINDS)
def test_the_derivative_by_loads_that_occur_is_the_whole_tables(kind: str) -> None:
    wanted = need()
    asked = within(wanted, 10)
    own = derivatives_at(scene_table(whole(kind), wanted), asked)  # type: ignore[arg-type]
    np.testing.assert_allclose(
        own[:, :, PLANAR], derivatives_at(whole(kind), asked)[:, :, PLANAR], rtol=1e-12
    )


def test_a_method_that_is_not_kept_is_refused_by_name() -> None:
    cut = scene_table(whole("kriging"), need())
    assert cut.answer([0.0] * 6, method="kriging").method == "kriging"
    with pytest.raises(OtherMethodError, match="download the whole table"):
        cut.answer([0.0] * 6, method="griddata")


def test_a_load_on_a_locked_freedom_changes_nothing() -> None:
    bounds = np.column_stack((-HIGH, HIGH))
    cut = scene_table(whole("kriging"), need_of(RANGE, bounds, idle=(5,)))
    assert cut.need.loads == ["fx", "fy", "fz", "mx", "my"]
    free, loaded = ([50.0, 0.0, 0.0, 0.0, 0.0, mz] for mz in (0.0, 1e9))
    assert cut.answer(free) == cut.answer(loaded)


def test_a_scene_without_rows_answers_that_there_are_none() -> None:
    cut = scene_table(build(Rows.empty(), RANGE), need())
    told = cut.answer([1.0, 0.0, 0.0, 0.0, 0.0, 0.0])
    assert (told.coverage, told.displacement, told.reason) == (
        "outside", None, "the table has no rows",
    )  # fmt: skip
    assert np.isnan(read_scene(write_scene(cut)).batch(within(need())).displacement).all()


def test_only_rotations_of_a_rig_that_measured_none_are_nothing() -> None:
    rows = table(coupled, full_wrenches(30, 1))
    moved = rows.displacement.copy()
    moved[:, 3:] = np.nan
    full = build(Rows.of(rows.wrench, moved), RANGE)
    told = scene_table(full, need(PLANAR, (3, 4, 5))).answer([1.0, 0.0, 0.0, 0.0, 0.0, 0.0])
    assert (told.displacement, told.coverage) == (None, "outside")
    assert "no row holds any output" in told.reason
