"""Where the fields of rows are kept, and what never gets in the way of a row."""

import shutil
import types

import numpy as np
import pytest

from wrenchbook.service.fields.record import GEOMETRY, ROW, DamagedFieldsError, leave
from wrenchbook.service.fields.store import FieldStore, key_of

WRENCH = (1.0, -2.0, 0.1, 0.0, 0.0, 1e-300)


def fields(linear=False, scale=1.0):
    return types.SimpleNamespace(
        linear=linear,
        weight=False,
        vertices=np.arange(12.0).reshape(4, 3),
        triangles=np.array([[0, 1, 2], [0, 2, 3]], dtype=np.int32),
        full_vertices=4,
        displacement=scale * np.arange(12.0).reshape(4, 3),
        displacement_slopes=np.ones((4, 3, 6)),
        stress=np.ones((2, 6)),
        stress_slopes=np.ones((2, 6, 6)),
        places=np.zeros((2, 3)),
        materials=np.zeros(2, dtype=np.int32),
        regions=("all",),
        largest=1.5,
        largest_at=(0.0, 0.1, 0.2),
        largest_region="all",
    )


@pytest.fixture
def attempt(tmp_path):
    folder = tmp_path / "attempt"
    folder.mkdir()
    return folder


def kept(store, attempt, wrench=WRENCH, fingerprint="f1", **changes):
    leave(attempt, wrench, fields(**changes))
    return store.take(attempt, "plate", fingerprint, wrench)


def test_what_a_solver_left_is_found_by_its_wrench(store, attempt):
    assert kept(store, attempt)
    assert store.has("plate", "f1", [(0.0,) * 6, WRENCH]) == [1]
    row = store.row("plate", "f1", WRENCH)
    np.testing.assert_array_equal(row.displacement, fields().displacement)
    geometry = store.geometry("plate", "f1", row.meta["geometry"])
    np.testing.assert_array_equal(geometry.triangles, fields().triangles)
    assert not list(attempt.iterdir())


def test_another_component_wrench_or_fingerprint_has_none(store, attempt):
    kept(store, attempt)
    assert store.has("bar", "f1", [WRENCH]) == []
    assert store.has("plate", "f2", [WRENCH]) == []
    with pytest.raises(DamagedFieldsError, match="cannot be read"):
        store.row("plate", "f2", WRENCH)


def test_zero_has_no_sign():
    assert key_of((0.0, 1, 2, 3, 4, 5)) == key_of((-0.0, 1, 2, 3, 4, 5))


def test_a_solver_that_left_nothing_costs_nothing(store, attempt):
    assert not store.take(attempt, "plate", "f1", WRENCH)
    (attempt / ROW).write_bytes(b"cut off")
    (attempt / GEOMETRY).write_bytes(b"cut off")
    assert not store.take(attempt, "plate", "f1", WRENCH)


def test_a_folder_that_cannot_be_written_costs_a_row_its_fields_only(tmp_path, attempt):
    (tmp_path / "file").write_text("in the way")
    assert not kept(FieldStore(tmp_path / "file"), attempt)


def test_it_never_takes_more_than_its_share(tmp_path, attempt):
    leave(attempt, WRENCH, fields())
    size = sum(path.stat().st_size for path in attempt.iterdir())
    store = FieldStore(tmp_path / "fields", most_bytes=int(2.5 * size))
    taken = [kept(store, attempt, (float(i),) * 6) for i in range(10)]
    assert taken[:2] == [True, True]
    assert not taken[-1]
    held = sum(p.stat().st_size for p in (tmp_path / "fields").rglob("*") if p.is_file())
    assert held <= 2.5 * size


def test_older_set_ups_make_room_for_the_present_one(tmp_path, attempt):
    leave(attempt, WRENCH, fields())
    size = sum(path.stat().st_size for path in attempt.iterdir())
    store = FieldStore(tmp_path / "fields", most_bytes=int(1.5 * size))
    assert kept(store, attempt, fingerprint="f1")
    assert kept(store, attempt, fingerprint="f2")
    assert store.has("plate", "f1", [WRENCH]) == []
    assert store.has("plate", "f2", [WRENCH]) == [0]


def test_a_linear_component_has_one_file_whatever_is_solved(store, attempt):
    assert store.linear("plate", "f1") is None
    for load in (1.0, 2.0):
        assert kept(store, attempt, (load,) * 6, linear=True)
    assert store.linear("plate", "f1").meta["linear"]
    assert len(list((store._folder / "plate" / "f1").glob("*.fields"))) == 1


def test_a_file_of_another_wrench_is_known_by_its_name_and_its_words(store, attempt):
    kept(store, attempt)
    folder = store._folder / "plate" / "f1"
    other = (5.0,) * 6
    shutil.copy(folder / f"{key_of(WRENCH)}.fields", folder / f"{key_of(other)}.fields")
    with pytest.raises(DamagedFieldsError, match="another wrench"):
        store.row("plate", "f1", other)
