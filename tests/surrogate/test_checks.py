"""Physics checks: sound tables pass, and the row that breaks a law is named."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from tests.surrogate.responses import HIGH, RANGE, clean_wrenches, full_wrenches, smooth, table
from tests.surrogate.tables.write import HERE
from tests.surrogate.test_space import range_of
from wrenchbook.surrogate.build import build
from wrenchbook.surrogate.table.compliance import fit_compliance
from wrenchbook.surrogate.table.merging import row_conflicts
from wrenchbook.surrogate.table.physics_checks import check_physics
from wrenchbook.surrogate.table.rows import LoadRange, Rows
from wrenchbook.surrogate.table.space import Input, space_of
from wrenchbook.surrogate.table.spread import spread_wrenches

ROOT = np.random.default_rng(3).normal(size=(6, 6)) + 3 * np.eye(6)
SCALED = np.concatenate((np.zeros((1, 6)), clean_wrenches(30, 4), full_wrenches(20, 5)))
# Symmetric and positive in units of energy: 1e-3 m or rad at full load.
MATRIX = 1e-3 * (ROOT @ ROOT.T) / HIGH[:, None] / HIGH[None, :]


def checks(displacement: np.ndarray, **columns: Any) -> dict[str, Any]:
    rows = Rows.of(SCALED * HIGH, displacement, **columns)
    return check_physics(rows, RANGE, fit_compliance(rows, RANGE, linear=False))


LINEAR = (SCALED * HIGH) @ MATRIX.T
TANGENTS = np.tile(MATRIX, (len(SCALED), 1, 1))


def gaps_of(rows, load_range):
    """Return the gaps of a table's axes."""
    return build(rows, load_range).groups[0].axes.gaps(load_range)


def test_a_linear_elastic_table_passes_and_a_6x6_suffices() -> None:
    reported = checks(LINEAR, compliance=TANGENTS)
    assert reported["ok"]
    assert all(check["ok"] for check in reported["checks"].values())
    assert reported["checks"]["linear"]["says"].startswith("one 6x6 compliance describes")
    assert reported["checks"]["linear"]["index"] < 1e-9


def test_nonlinearity_is_measured_and_breaks_no_law() -> None:
    bent = LINEAR.copy()
    bent[:, 2] *= 1 + 0.1 * np.abs(SCALED).max(axis=1)
    reported = checks(bent)
    assert reported["ok"]
    assert not reported["checks"]["linear"]["ok"]
    assert 0.005 < reported["checks"]["linear"]["per_output"]["uz"] < 0.1
    assert len(reported["checks"]["linear"]["rows"]) == 5


def test_a_displacement_at_no_load_is_named() -> None:
    offset = LINEAR + np.abs(LINEAR).max(axis=0) * 0.01
    reported = checks(offset)["checks"]["zero_at_zero_load"]
    assert not reported["ok"]
    assert reported["rows"] == [1]


@pytest.mark.parametrize("row", [40, 77])
def test_a_row_with_a_wrong_sign_gives_work_back_and_is_named(row: int) -> None:
    wrong = LINEAR.copy()
    wrong[row] *= -1
    reported = checks(wrong)
    assert not reported["ok"]
    assert row + 1 in reported["checks"]["work"]["rows"]
    assert len(reported["checks"]["work"]["rows"]) < 5


def test_tangents_that_are_unsymmetric_negative_or_lead_elsewhere_are_named() -> None:
    tangents = TANGENTS.copy()
    tangents[5, 0, 1] += 0.5 * np.abs(MATRIX[0, 0] * HIGH[0] / HIGH[1])
    tangents[9] *= -1
    reported = checks(LINEAR, compliance=tangents)["checks"]
    assert 6 in reported["symmetric"]["rows"]
    assert reported["positive"]["rows"] == [10]
    assert 10 in reported["tangents"]["rows"]


@pytest.mark.parametrize("source", ["fea", "measured"])
def test_a_tangent_a_thousandth_off_symmetry_is_named_if_it_is_a_solves(source: str) -> None:
    tangents = TANGENTS.copy()
    tangents[5, 0, 1] += 1e-3 * np.abs(MATRIX[0, 0] * HIGH[0] / HIGH[1])
    reported = checks(LINEAR, compliance=tangents, source=[source] * len(SCALED))["checks"]
    assert reported["symmetric"]["rows"] == ([6] if source == "fea" else [])


def test_nonlinear_solves_are_symmetric_by_the_loads_of_the_energy() -> None:
    with np.load(HERE / "plate_thin.npz") as file:
        tangents, span = file["compliance"], LoadRange(file["low"], file["high"])
        places = slice(len(tangents))
        about = {"compliance": tangents, "source": ["fea"] * len(tangents)}
        rows = Rows.of(file["wrench"][places], file["displacement"][places], **about)
    reported = check_physics(rows, span, fit_compliance(rows, span, linear=False))["checks"]
    assert reported["symmetric"]["asymmetry_of_solves"] < 1e-8  # 4e-3 by force and moment
    assert reported["symmetric"]["rows"] == []


def test_rows_too_far_apart_for_their_tangents_are_not_called_broken() -> None:
    far = np.eye(6)[[2, 2, 4]] * [[1.0], [-1.0], [1.0]] * HIGH
    stiff = np.stack([MATRIX, 0.1 * MATRIX, 3 * MATRIX])
    rows = Rows.of(far, far @ MATRIX.T, compliance=stiff)
    reported = check_physics(rows, RANGE, fit_compliance(rows, RANGE, linear=False))
    assert reported["checks"]["tangents"]["ok"] is None
    assert reported["checks"]["tangents"]["reason"].endswith("solve rows between")


def test_noise_of_a_thousandth_of_the_largest_displacement_breaks_no_law() -> None:
    largest = np.repeat([np.abs(LINEAR[:, :3]).max(), np.abs(LINEAR[:, 3:]).max()], 3)
    noise = 5e-4 * largest * np.random.default_rng(1).uniform(-1, 1, LINEAR.shape)
    reported = checks(LINEAR + noise)["checks"]
    assert (reported["zero_at_zero_load"]["ok"], reported["work"]["ok"]) == (True, True)


def test_a_load_a_guide_holds_is_told_to_have_no_influence() -> None:
    held = MATRIX.copy()
    held[[1, 3]] = held[:, [1, 3]] = 0
    reported = checks((SCALED * HIGH) @ held.T)["checks"]["positive"]
    assert reported["ok"]
    assert reported["loads_without_influence"] == ["fy", "mx"]


def test_rows_without_all_outputs_are_left_out_of_the_checks() -> None:
    partial = LINEAR.copy()
    partial[::2, 3:] = np.nan
    rows = Rows.of(SCALED * HIGH, partial)
    reported = check_physics(rows, RANGE, build(rows, RANGE).groups[0].fit)
    assert reported["rows_checked"] == len(SCALED) // 2


def test_rows_that_contradict_each_other_are_listed_and_repeats_are_not() -> None:
    wrench = np.tile(SCALED[5] * HIGH, (4, 1))
    wrench[2:] = SCALED[6] * HIGH
    moved = np.tile(LINEAR[5], (4, 1))
    moved[1, 2] += 1e-4
    rows = table(smooth, SCALED) + Rows.of(wrench, moved, seq=[101, 102, 103, 104])
    rows = rows.take(np.delete(np.arange(len(rows)), [5, 6]))
    results = row_conflicts(rows, RANGE)["conflicts"]
    assert [result["rows"] for result in results] == [[101, 102]]
    assert results[0]["spread"] == pytest.approx({"uz": 1e-4})
    doubtful = Rows.of(wrench, moved, uncertainty=np.full((4, 6), 1e-4))
    assert row_conflicts(doubtful, RANGE)["conflicts"] == []
    summary = build(rows, RANGE).coverage_summary()
    assert summary["conflicting_wrenches"] == 1
    assert summary["repeated_wrenches"] == 2


def test_repeated_readings_within_their_noise_contradict_nothing_and_a_wrong_one_does() -> None:
    """Three cycles of a strut with a noise of 0.5 um listed all 41 wrenches as contradictions."""
    force = np.round(300 * np.sin(2 * np.pi * np.arange(240) / 80), 2)
    wrench, moved = np.zeros((240, 6)), np.full((240, 6), np.nan)
    wrench[:, 2] = force
    moved[:, 2] = force / 2e6 + np.random.default_rng(2).normal(0, 5e-7, 240)
    strut = LoadRange(np.array([0, 0, -300.0, 0, 0, 0]), np.array([0, 0, 300.0, 0, 0, 0]))
    summary = build(Rows.of(wrench, moved), strut).coverage_summary()
    assert summary["repeated_wrenches"] > 30
    assert summary["conflicts"] == []
    moved[100, 2] += 1e-5
    listed = build(Rows.of(wrench, moved), strut).coverage_summary()["conflicts"]
    assert [101 in conflict["rows"] for conflict in listed] == [True]


def test_gaps_name_the_corners_of_the_range_outside_the_hull() -> None:
    scaled = clean_wrenches(40, 1)
    whole = gaps_of(table(smooth, scaled), RANGE)
    assert [len(axis["outside"]) for axis in whole] == [0, 0, 0]
    assert len(whole[0]["hull"]) == 8
    assert len(whole[0]["worst"]) == 5
    without = gaps_of(table(smooth, scaled[1:]), RANGE)
    assert without[0]["outside"] == [{"fx": -1000.0, "my": -500.0, "mz": -200.0}]
    flat = gaps_of(table(smooth, scaled[:40] * [1, 0, 0, 0, 1, 0]), RANGE)
    assert len(flat[0]["hull"]) == 4
    assert flat[2]["hull"] == []


def test_a_compliance_that_is_negative_by_its_own_asymmetry_breaks_no_law() -> None:
    held = MATRIX.copy()
    held[[1, 3]] = held[:, [1, 3]] = 0
    moved = (SCALED * HIGH) @ held.T
    noise = 1e-3 * np.abs(moved).max() * np.random.default_rng(1).uniform(-1, 1, moved.shape)
    reported = checks(moved + noise)["checks"]
    assert reported["positive"]["smallest_over_largest_eigenvalue"] < -1e-6
    assert reported["positive"]["ok"]
    assert not checks(-(moved + noise))["checks"]["positive"]["ok"]


def symmetry_of(count: int, matrix: np.ndarray) -> dict[str, Any]:
    """The check of a linear table whose readings have a noise of 8 %."""
    rng = np.random.default_rng(0)
    wrench = rng.uniform(-1, 1, (count, 6)) * HIGH
    moved = wrench @ matrix.T
    rows = Rows.of(wrench, moved + 0.08 * np.abs(moved).max(axis=0) * rng.normal(size=moved.shape))
    fit = fit_compliance(rows, RANGE, linear=False)
    return check_physics(rows, RANGE, fit)["checks"]["symmetric"]


@pytest.mark.parametrize("count", [6, 10])
def test_an_asymmetry_within_the_uncertainty_of_the_fit_is_not_known_yet(count: int) -> None:
    """Ten noisy rows of a symmetric part were called broken."""
    reported = symmetry_of(count, MATRIX)
    assert reported["asymmetry"] > reported["allowed"]
    assert reported["ok"] is None
    assert "only more rows show" in reported["reason"]


def test_an_asymmetry_beyond_the_uncertainty_of_the_fit_is_broken() -> None:
    crossed = MATRIX.copy()
    crossed[0, 1] += 0.5 * MATRIX[0, 0] * HIGH[0] / HIGH[1]
    assert symmetry_of(20, crossed)["ok"] is False


def zero_of(seed: int, count: int = 24, shift: float = 0.0, unloaded: int = 3) -> dict[str, Any]:
    """The check of a linear table whose readings have a noise of 2 %, shifted by a part."""
    rng = np.random.default_rng(seed)
    wrench = rng.uniform(-1, 1, (count, 6)) * HIGH
    wrench[:unloaded] = 0
    moved = wrench @ MATRIX.T
    noise = 0.02 * rng.normal(size=moved.shape) + shift
    rows = Rows.of(wrench, moved + noise * np.abs(moved).max(axis=0))
    fit = fit_compliance(rows, RANGE, linear=False)
    return check_physics(rows, RANGE, fit)["checks"]["zero_at_zero_load"]


@pytest.mark.parametrize("count", [6, 24])
def test_a_reading_at_zero_load_within_the_noise_is_not_known_yet(count: int) -> None:
    """All tables of readings with a noise of 2 % were called broken."""
    reported = [zero_of(seed, count)["ok"] for seed in range(60)]
    assert sum(ok is False for ok in reported) <= 3
    assert True not in reported
    assert "only more rows show" in zero_of(0, count)["reason"]


def test_a_reading_at_zero_load_beyond_the_noise_is_broken() -> None:
    assert zero_of(0, shift=0.2)["rows"] == [1, 2, 3]


def test_a_shift_that_only_the_mean_of_readings_at_zero_load_shows_is_broken() -> None:
    reported = [zero_of(seed, 50, shift=0.03, unloaded=20)["ok"] for seed in range(10)]
    assert reported == [False] * 10


def test_the_stated_uncertainties_of_many_readings_at_zero_load_hold_together() -> None:
    """A tenth reading beyond its own 95 % bar broke the law."""
    moved, half = LINEAR[:40].copy(), 0.02 * np.abs(LINEAR).max(axis=0)
    scaled = SCALED[:40].copy()
    scaled[:10], moved[:10] = 0, 0
    moved[3] = 1.3 * half
    rows = Rows.of(scaled * HIGH, moved, uncertainty=np.tile(half, (40, 1)))
    fit = fit_compliance(rows, RANGE, linear=False)
    assert check_physics(rows, RANGE, fit)["checks"]["zero_at_zero_load"]["ok"] is None
    moved[3] = 2.0 * half
    rows = replace(rows, displacement=moved)
    assert check_physics(rows, RANGE, fit)["checks"]["zero_at_zero_load"]["rows"] == [4]


def test_a_solve_that_is_displaced_at_zero_load_is_broken_whatever_the_noise() -> None:
    moved = LINEAR * (1 + 0.1 * np.random.default_rng(0).normal(size=LINEAR.shape))
    moved[0] = 0.01 * np.abs(LINEAR).max(axis=0)
    sources = ["fea"] + ["measured"] * (len(SCALED) - 1)
    assert checks(moved, source=sources)["checks"]["zero_at_zero_load"]["rows"] == [1]


def test_laws_of_physics_are_checked_over_all_interfaces() -> None:
    space = space_of(("left", "right"), [Input("temperature", "degC", "scalar", zero=0.5)])
    load_range = range_of(space)
    rng = np.random.default_rng(3)
    half = rng.uniform(-1, 1, (12, 12))
    matrix = np.hstack([half @ half.T, rng.uniform(-1, 1, (12, 1))])
    inputs = spread_wrenches(load_range, 40)
    inputs[0] = space.zero
    rows = Rows.of(inputs, (inputs - space.zero) @ matrix.T, space)
    result = check_physics(rows, load_range, fit_compliance(rows, load_range, linear=False))
    assert result["ok"]
    assert result["checks"]["zero_at_zero_load"]["ok"]
    assert result["checks"]["symmetric"]["asymmetry"] < 1e-9
    assert result["checks"]["work"]["ok"] is None
    wrong = rows.displacement.copy()
    wrong[0, 7] = 1.0
    moved = replace(rows, displacement=wrong, seq=np.arange(40))
    result = check_physics(moved, load_range, fit_compliance(moved, load_range, linear=False))
    assert result["checks"]["zero_at_zero_load"]["rows"] == [0]
    assert result["checks"]["zero_at_zero_load"]["displacement"]["right.uy"] == 1.0


def test_a_row_outside_the_load_range_is_not_checked() -> None:
    rows = Rows.of(np.vstack((SCALED * HIGH, 5 * HIGH)), np.vstack((LINEAR, np.ones((1, 6)))))
    fit = fit_compliance(rows.take(np.arange(len(SCALED))), RANGE, linear=False)
    assert check_physics(rows, RANGE, fit)["rows_checked"] == len(SCALED)
