"""Deformed surfaces at solved wrenches and between them."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from tests.service.surfaces import keep, sheet, solved, solver, wrenches, write_bundle
from wrenchbook.service.fields.deformed import DeformedSurfaces, NoFieldsError, TooFarError
from wrenchbook.service.fields.shape import largest_stress, stress_of_row
from wrenchbook.service.fields.store import key_of
from wrenchbook.surrogate.build import build
from wrenchbook.surrogate.table.rows import Rows, Tolerance

ROWS, CHECKS = 24, 8


@pytest.fixture(scope="module")
def plate(tmp_path_factory):
    """A component, its rows, their fields, and the fields of wrenches that are no rows."""
    folder = write_bundle(tmp_path_factory.mktemp("bundles"))
    component = sheet(folder)
    fields, rows = solved(folder, wrenches(component, ROWS))
    asked = wrenches(component, CHECKS, seed=2)
    return component, rows, fields, asked, solved(folder, asked)[0]


@pytest.fixture
def shapes(store):
    result = DeformedSurfaces(store)
    yield result
    result.close()


def filled(store, plate, which=range(ROWS)):
    component, rows, fields, *_ = plate
    for row in which:
        keep(store, component, rows.wrench[row], fields[row])


def file_of(store, plate, row):
    component, rows, *_ = plate
    folder = store._folder / component.name / component.fingerprint
    return folder / f"{key_of(rows.wrench[row])}.fields"


def lengths(vectors):
    return np.linalg.norm(vectors, axis=1)


def test_a_solved_wrench_has_the_solvers_surface(plate, store, shapes):
    component, rows, fields, *_ = plate
    filled(store, plate)
    for row in (0, 7, ROWS - 1):
        result = shapes.answer(component, rows, rows.wrench[row])
        size = np.abs(fields[row].displacement).max()
        assert np.abs(result.displacement - fields[row].displacement).max() < 1e-12 * size
        np.testing.assert_array_equal(result.geometry.vertices, fields[row].vertices)
        np.testing.assert_array_equal(result.geometry.triangles, fields[row].triangles)
        assert (result.source, result.coverage, result.rows) == ("row", "covered", (row + 1,))
        assert result.stress.largest == fields[row].largest
        assert (result.error > 0).all()


def test_a_wrench_rounded_to_a_rows_is_led_there_by_its_slopes(plate, store, shapes):
    component, rows, *_ = plate
    filled(store, plate)
    asked = rows.wrench[0] + 0.4e-6 * component.load_range.scale
    true = solver(component.folder).fields(solver(component.folder).solve(asked))
    result = shapes.answer(component, rows, asked)
    assert result.source == "row"
    wrong = np.abs(result.displacement - true.displacement).max()
    assert wrong < 1e-9 * np.abs(true.displacement).max()
    assert result.stress.largest == pytest.approx(true.largest, rel=1e-6)


def test_between_rows_nine_of_ten_vertices_are_within_their_bars(plate, store, shapes):
    component, rows, _, asked, true = plate
    filled(store, plate)
    held = build(rows, component.load_range).groups[0].kriging.hyperparameters
    for lengths_of_loads in (None, held):
        errors, bars, sizes = [], [], []
        for wrench, one in zip(asked, true, strict=True):
            result = shapes.answer(component, rows, wrench, lengths_of_loads)
            assert result.source == "rows"
            errors.append(lengths(result.displacement - one.displacement))
            bars.append(result.error)
            sizes.append(lengths(one.displacement).max())
        errors, bars = np.array(errors), np.array(bars)
        free = errors.max(axis=0) > 0
        assert (errors <= bars)[:, free].mean() >= 0.9
        # And they say something: the error is a small part of what moves, the bar not far off.
        assert errors.max() < 0.05 * max(sizes)
        assert np.median(bars[:, free]) < 30 * np.median(errors[:, free])


def test_between_rows_the_largest_stress_is_within_its_bar(plate, store, shapes):
    component, rows, _, asked, true = plate
    filled(store, plate)
    inside = 0
    for wrench, one in zip(asked, true, strict=True):
        result = shapes.answer(component, rows, wrench).stress
        inside += abs(result.largest - one.largest) <= result.error
        assert result.largest == pytest.approx(one.largest, rel=0.1)
    assert inside >= 0.9 * CHECKS


def test_rows_of_another_fingerprint_or_measured_ones_have_no_fields(plate, store, shapes):
    component, rows, *_ = plate
    filled(store, plate)
    other = replace(rows, fingerprint=np.array(["other"] * ROWS))
    with pytest.raises(
        NoFieldsError, match=r"no row has fields \(rows: 24; solves of its present setup"
    ):
        shapes.answer(component, other, rows.wrench[0])


def test_a_damaged_file_is_a_row_without_fields(plate, store, shapes):
    component, rows, _, asked, _ = plate
    filled(store, plate)
    path = file_of(store, plate, 4)
    content = bytearray(path.read_bytes())
    content[len(content) // 2] ^= 0xFF
    path.write_bytes(content)
    file_of(store, plate, 5).write_bytes(b"")
    result = shapes.answer(component, rows, asked[0])
    assert set(range(1, ROWS + 1)) - set(result.rows) == {5, 6}
    at = shapes.answer(component, rows, rows.wrench[4])
    assert at.source == "rows"
    assert (lengths(at.displacement - plate[2][4].displacement) <= at.error).mean() >= 0.9


def test_fields_or_a_geometry_that_are_gone_are_named_and_not_guessed(plate, store, shapes):
    component, rows, _, asked, _ = plate
    filled(store, plate, range(5))
    for row in range(5):
        file_of(store, plate, row).write_bytes(b"nothing")
    with pytest.raises(
        NoFieldsError,
        match=r"all are damaged \(rows 1, 2, 3, 4, 5\)\. .* DELETE \S+table/1, then POST",
    ):
        shapes.answer(component, rows, asked[0])
    filled(store, plate, range(5))
    for path in (store._folder / component.name).glob("*/*.geometry"):
        path.unlink()
    with pytest.raises(NoFieldsError, match="geometry cannot be read: No such file"):
        shapes.answer(component, rows, asked[0])


def test_one_row_answers_flagged_and_without_a_bar(plate, store, shapes):
    component, rows, _, asked, _ = plate
    filled(store, plate, [0])
    result = shapes.answer(component, rows, asked[0])
    assert (result.coverage, result.error) == ("thin", None)
    assert "too few" in result.reason
    assert result.stress.error is None
    assert result.stress.yields is None


def test_new_rows_take_part_at_once_and_repeated_ones_count_once(plate, store, shapes):
    component, rows, _, asked, _ = plate
    filled(store, plate, range(5))
    assert len(shapes.answer(component, rows, asked[0]).rows) == 5
    filled(store, plate, range(5, 9))
    assert len(shapes.answer(component, rows, asked[0]).rows) == 9
    twice = rows.take([*range(6), *range(6)])
    assert len(shapes.answer(component, twice, asked[0]).rows) == 6


def test_a_tolerance_decides_what_is_covered(plate, store, shapes):
    component, rows, _, asked, _ = plate
    filled(store, plate)
    loose = replace(component, tolerance=Tolerance(1.0, 1.0))
    tight = replace(component, tolerance=Tolerance(1e-12, 1.0))
    assert shapes.answer(loose, rows, asked[0]).coverage == "covered"
    result = shapes.answer(tight, rows, asked[0])
    assert result.coverage == "thin"
    assert "may be wrong by" in result.reason


def test_beyond_the_range_it_is_flagged_and_far_beyond_refused(plate, store, shapes):
    component, rows, *_ = plate
    filled(store, plate)
    result = shapes.answer(component, rows, np.array([1500.0, 0, 0, 0, 0, 0]))
    assert result.coverage == "outside"
    assert "fx = 1500 N is outside" in result.reason
    for size in (4000.0, 1e300):
        with pytest.raises(TooFarError, match=r"too far away for a surface; give a load"):
            shapes.answer(component, rows, np.array([0.0, 0, 0, 0, size, 0]))


def test_the_part_that_yields_is_named(plate, store, shapes):
    component, rows, fields, *_ = plate
    filled(store, plate)
    worst = int(np.argmax([field.largest for field in fields]))
    result = shapes.answer(component, rows, rows.wrench[worst]).stress
    assert result.largest > 60e6
    assert (result.yields, result.region, result.yield_strength) == (True, "all", 60e6)
    strong = replace(component, yield_strengths={"all": 1e9})
    assert shapes.answer(strong, rows, rows.wrench[worst]).stress.yields is False
    silent = replace(component, yield_strengths={})
    assert shapes.answer(silent, rows, rows.wrench[worst]).stress.yields is None


def test_a_bar_across_the_yield_strength_leaves_it_open(plate, store, shapes):
    component, rows, _, asked, _ = plate
    filled(store, plate)
    reported = shapes.answer(component, rows, asked[0]).stress
    near = replace(component, yield_strengths={"all": reported.largest - 0.5 * reported.error})
    assert shapes.answer(near, rows, asked[0]).stress.yields is None


def two_parts(steel, aluminium):
    """A steel part, 800 MPa, beside an aluminium one, 100 MPa, in tension; stresses in MPa."""
    strengths = {"steel": 800e6, "aluminium": 100e6}
    parts = SimpleNamespace(yield_strengths=strengths)
    geometry = SimpleNamespace(
        regions=tuple(strengths), materials=np.arange(2), places=np.zeros((2, 3))
    )
    stresses = np.zeros((2, 6))
    stresses[:, 0] = 1e6 * steel, 1e6 * aluminium
    return parts, geometry, stresses


@pytest.mark.parametrize(
    ("aluminium", "region", "yields"),
    [(80, "steel", False), (95, "aluminium", None), (120, "aluminium", True)],
)
def test_whether_a_part_yields_is_decided_over_all_parts(aluminium, region, yields):
    """Steel at a quarter of its strength hid aluminium whose bar reaches across its own."""
    result = largest_stress(*two_parts(200, aluminium), 10e6)
    assert (result.region, result.yields) == (region, yields)


@pytest.mark.parametrize(("steel", "yields"), [(90, False), (200, None), (900, True)])
def test_a_row_with_only_its_largest_stress_does_not_deny_that_a_weaker_part_yields(steel, yields):
    parts, *_ = two_parts(steel, 0)
    meta = {"largest": 1e6 * steel, "at": [0, 0, 0], "region": "steel"}
    assert stress_of_row(parts, SimpleNamespace(meta=meta)).yields is yields


def test_a_linear_components_unit_fields_answer_every_wrench(tmp_path, store, shapes):
    folder = write_bundle(tmp_path, nonlinear=False)
    component = sheet(folder)
    asked = wrenches(component, 3)
    with pytest.raises(NoFieldsError, match="fields of unit loads"):
        shapes.answer(component, Rows.empty(), asked[0])
    keep(store, component, asked[0], solved(folder, asked[:1])[0][0])
    for wrench, true in zip(asked, solved(folder, asked)[0], strict=True):
        result = shapes.answer(component, Rows.empty(), wrench)
        size = np.abs(true.displacement).max()
        assert np.abs(result.displacement - true.displacement).max() < 1e-11 * size
        assert (result.source, result.coverage) == ("linear", "covered")
        assert result.stress.largest == pytest.approx(true.largest, rel=1e-10)
        assert result.stress.at == pytest.approx(true.largest_at)
    (path,) = store._folder.glob("*/*/*.fields")
    path.write_bytes(path.read_bytes()[:-1])
    with pytest.raises(NoFieldsError, match=r"used: linear.fields: its checksum is wrong"):
        shapes.answer(component, Rows.empty(), asked[0])


def test_the_memory_of_large_surfaces_is_bounded_by_fewer_rows(plate, store, shapes, monkeypatch):
    component, rows, _, asked, _ = plate
    filled(store, plate)
    row = store.row(component.name, component.fingerprint, rows.wrench[0])
    size = 56 * (row.displacement.size + row.stress.size)
    monkeypatch.setattr("wrenchbook.service.fields.deformed.BLEND_BYTES", 10 * size)
    result = shapes.answer(component, rows, asked[0])
    assert len(result.rows) == 10
    assert sum(blend[1].values.nbytes for blend in shapes._blends.values()) <= 10 * size
    apart = np.linalg.norm((rows.wrench - asked[0]) / component.load_range.scale, axis=1)
    assert set(result.rows) == set((np.argsort(apart)[:10] + 1).tolist())


def test_the_same_question_needs_no_file_a_second_time(plate, store, shapes):
    component, rows, _, asked, _ = plate
    filled(store, plate)
    first = shapes.answer(component, rows, asked[0])
    blend = shapes._blends[component.name][1]
    second = shapes.answer(component, rows, asked[1])
    assert shapes._blends[component.name][1] is blend
    assert first.geometry is second.geometry
