"""Findings name the cause of a systematic error, and are silent on clean measurements."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from tests.slow import slow
from tests.surrogate.findings.rigs import CAUSES, DIRECTED, Rig
from wrenchbook.surrogate.findings.contract import named_unit
from wrenchbook.surrogate.findings.find import find
from wrenchbook.surrogate.findings.origin import slopes_at_zero
from wrenchbook.surrogate.findings.response import response_of
from wrenchbook.surrogate.table.rows import LoadRange, Rows
from wrenchbook.surrogate.table.space import LOADS

# In `make test` one seed, which must have its finding, and five clean ones.
TEN = pytest.mark.parametrize("seeds", [range(4200, 4201), slow(range(4200, 4210))])
FIFTY = pytest.mark.parametrize("seeds", [range(4300, 4305), slow(range(4305, 4350))])


def rig_of(error, seed):
    return Rig(seed, ("sweeps", "motion") if error in DIRECTED else ("random", "sweeps", "motion"))


def causes_of(rows, rig, **more):
    return [finding.cause for finding in find(rows, rig.range, **more)]


@TEN
@pytest.mark.parametrize("error", CAUSES)
def test_the_cause_is_named_in_nine_of_ten_measurements(error, seeds):
    rigs = [rig_of(error, seed) for seed in seeds]
    named = [CAUSES[error] in causes_of(rig.measured(error), rig) for rig in rigs]
    assert sum(named) >= 0.9 * len(seeds)


@FIFTY
def test_fifty_clean_measurements_have_no_finding(seeds):
    result = {seed: causes_of(Rig(seed).measured(), Rig(seed)) for seed in seeds}
    assert {seed: causes for seed, causes in result.items() if causes} == {}


@pytest.mark.parametrize("load", [1, 5])
def test_a_load_that_is_not_varied_has_a_wide_slope_and_makes_no_asymmetry(load):
    rig = Rig(4300)
    wrench = rig.measured().wrench.copy()
    wrench[:, load] = 0.0
    moved = rig.respond(wrench)
    moved += rig.rng.normal(size=moved.shape) * 0.003 * np.ptp(moved, axis=0)
    rows = Rows.of(wrench, moved, source=["measured"] * len(wrench))
    slopes = slopes_at_zero(rows, rig.range, response_of(rows, rig.range))
    assert not slopes.matrix[:, load].any()
    widths = np.sqrt(slopes.covariance[:, load, load]) * rig.range.scale[load]
    assert (widths > np.ptp(moved, axis=0)).all()
    assert slopes.jump_deviation[load] > np.ptp(moved[:, load])
    assert find(rows, rig.range) == []


def test_a_linear_response_measured_at_few_loads_has_no_clearance():
    span = np.full(6, 100.0)
    for rng in map(np.random.default_rng, range(25)):
        load = np.sort(rng.uniform(-100, 100, 8))
        moved = np.full((8, 6), np.nan)
        moved[:, 2] = 1e-6 * load + 1e-6 * rng.normal(size=8)
        rows = Rows.of(np.outer(load, np.eye(6)[2]), moved)
        assert find(rows, LoadRange(-span, span)) == []


def test_readings_of_a_hold_with_a_common_error_are_correlated():
    rig = Rig(12, ("sweeps",))
    loads = np.concatenate((np.linspace(-1, 1, 12), np.linspace(1, -1, 12)))
    wrench = np.outer(loads, np.eye(6)[2] * rig.high)
    moved = rig.respond(wrench)
    moved += rig.rng.normal(size=moved.shape) * 0.003 * np.ptp(moved, axis=0)
    wrench, moved = wrench.repeat(15, axis=0), moved.repeat(15, axis=0)
    moved += rig.rng.normal(size=moved.shape) * 0.0006 * np.ptp(moved, axis=0)
    assert "correlated" in causes_of(Rows.of(wrench, moved, source=["measured"] * 360), rig)


def test_the_rows_of_outliers_are_the_wrong_ones():
    rig = Rig(7, ("random",))
    rows = rig.measured()
    rows.displacement[[11, 80], 2] += [2 * rig.size[2], -rig.size[2]]
    (result,) = find(rows, rig.range)
    assert result.rows == (rows.seq[11], rows.seq[80])  # the worst first
    assert result.body()["count"] == 2


def test_the_lever_is_that_of_the_measurement():
    rig = Rig(8, ("random",))
    rows, lever = rig.measured(), np.array([0.12, -0.05, 0.08])
    turned = rows.wrench.copy()
    turned[:, 3:] += np.cross(lever, turned[:, :3])
    moved = Rows.of(turned, rows.displacement, source=rows.source)
    (result,) = find(moved, rig.range)
    np.testing.assert_allclose(result.numbers["lever"], lever, atol=0.01)


@pytest.mark.parametrize(
    ("columns", "factor", "quantity"),
    [
        (slice(0, 3), 1000, "translations"),
        (slice(3, 6), 57.3, "rotations"),
    ],
)
def test_solves_name_the_quantity_whose_unit_is_wrong(columns, factor, quantity):
    rig = Rig(9, ("random",))
    rows = rig.measured()
    rows.displacement[:, columns] *= factor
    results = [
        finding for finding in find(rows, rig.range, rig.compliance) if finding.cause == "unit"
    ]
    assert quantity in [result.numbers["quantity"] for result in results]


def test_measurements_of_the_translations_alone_are_looked_at_too():
    rig = Rig(10, ("random",))
    rows = rig.measured()
    rows.displacement[:, 3:] = np.nan
    assert causes_of(rows, rig) == []
    rows.displacement[5, 1] = 40 * rig.size[1]
    assert causes_of(rows, rig) == ["outlier"]


def test_a_handful_of_rows_and_none_have_no_finding():
    rig = Rig(11, ("random",))
    rows = rig.measured()
    assert causes_of(rows.take(np.arange(5)), rig) == []
    assert causes_of(rows.take(np.arange(0)), rig) == []


@TEN
@pytest.mark.parametrize("factor", [1.8, 0.5])
def test_solves_name_a_load_cell_with_another_scale(factor, seeds):
    rigs = [Rig(seed) for seed in seeds]
    named = 0
    for rig in rigs:
        rows = rig.measured()
        rows.wrench[:, :3] *= factor
        results = [
            finding for finding in find(rows, rig.range, rig.compliance) if finding.cause == "unit"
        ]
        named += [result.numbers["quantity"] for result in results] == ["forces"]
    assert named >= 0.9 * len(seeds)


@TEN
@pytest.mark.parametrize("load", range(6))
def test_solves_name_the_load_or_displacement_with_the_wrong_sign(load, seeds):
    named = 0
    for rig in (Rig(seed) for seed in seeds):
        rows = rig.measured()
        rows.wrench[:, load] *= -1
        results = [
            finding for finding in find(rows, rig.range, rig.compliance) if finding.cause == "sign"
        ]
        named += [result.numbers.get("quantities") for result in results] == [[LOADS[load]]]
    assert named >= 0.9 * len(seeds)


@FIFTY
def test_fifty_clean_measurements_agree_with_their_solves(seeds):
    result = {
        seed: causes_of(Rig(seed).measured(), Rig(seed), solved=Rig(seed).compliance)
        for seed in seeds
    }
    assert {seed: causes for seed, causes in result.items() if causes} == {}


def test_the_message_of_a_lever_has_its_length():
    rig = Rig(8, ("random",))
    rows, lever = rig.measured(), np.array([0.12, -0.05, 0.08])
    rows.wrench[:, 3:] += np.cross(lever, rows.wrench[:, :3])
    (result,) = find(rows, rig.range)
    length = float(result.message.split("and displacements are ")[1].split(" m")[0])
    assert abs(length - np.linalg.norm(lever)) < 0.02


@TEN
def test_loads_in_another_frame_than_displacements_are_an_asymmetry(seeds):
    named = []
    for rig in (Rig(seed) for seed in seeds):
        rows = rig.measured()
        axis = rig.rng.normal(size=3)
        turn = Rotation.from_rotvec(np.radians(40) * axis / np.linalg.norm(axis)).as_matrix()
        rows.wrench[:] = rows.wrench @ np.kron(np.eye(2), turn).T
        named += [causes_of(rows, rig)]
    assert sum("asymmetry" in causes for causes in named) >= 0.9 * len(seeds), named


@pytest.mark.parametrize(("share", "cause"), [(0.8, "clipped"), (None, "stuck")])
def test_a_load_cell_at_the_end_of_its_range_or_stuck_is_named_with_its_rows(share, cause):
    rig = Rig(7, ("random",), rows=(200, 300), noises=(0.001,))
    rows = rig.measured()
    load = rows.wrench[:, np.argmax(np.diag(rig.compliance) * rig.high / rig.size)]
    true, held = load.copy(), slice(0, len(load) // 4)
    if share:
        load.clip(share * load.min(), share * load.max(), out=load)
    else:
        load[held] = load[0]
    results = [finding for finding in find(rows, rig.range) if finding.cause == cause]
    named = np.isin(rows.seq, np.concatenate([result.rows for result in results]))
    assert named[load != true].all()
    assert named[load == true].sum() <= 2  # the first of those held, and the largest within


def test_a_load_cell_that_is_clipped_in_half_the_rows_is_named_with_its_rows():
    load = 4500 * np.sin(np.arange(400) / 40)
    wrench, displacement = np.zeros((400, 6)), np.full((400, 6), np.nan)
    wrench[:, 2] = load.clip(-3000, 3000)
    noise = np.random.default_rng(1).normal(size=400)
    displacement[:, 2] = load / 2e6 + 5e-5 * (load / 5000) ** 3 + 1e-6 * noise
    rows = Rows.of(wrench, displacement)
    bound = np.array([5000.0] * 3 + [200.0] * 3)
    results = find(rows, LoadRange(-bound, bound))
    named = np.concatenate([result.rows for result in results if result.cause == "clipped"])
    assert set(named) == set(rows.seq[np.abs(load) >= 3000])


def test_a_factorial_test_has_no_clipped_load_cell():
    """18 of 27 rows were named, with the advice to withdraw them."""
    levels = np.stack(np.meshgrid(*[[-1.0, 0, 1]] * 3), axis=-1).reshape(-1, 3)
    wrench, displacement = np.zeros((27, 6)), np.full((27, 6), np.nan)
    wrench[:, :3] = 500 * levels
    noise = 3e-7 * np.random.default_rng(1).normal(size=27)
    displacement[:, 0] = 1e-4 * levels[:, 0] * (1 + 0.08 * np.tanh(2 * levels[:, 2])) + noise
    rows = Rows.of(wrench, displacement)
    bound = np.array([600.0] * 3 + [60.0] * 3)
    assert find(rows, LoadRange(-bound, bound)) == []


def test_an_offset_is_named_where_no_row_is_at_rest():
    rig = Rig(12, ("random",), rows=(200, 300), noises=(0.001,))
    rows = rig.measured()
    assert np.abs(rows.wrench / rig.high).max(axis=1).min() > 0.05
    rows.displacement[:] += 0.03 * rig.size
    assert causes_of(rows, rig) == ["zero"]
    one_sided = rows.take(rows.wrench[:, 2] < -0.05 * rig.high[2])
    assert "zero" not in causes_of(one_sided, rig)  # the force of the other side may have a play


@pytest.mark.parametrize(("factor", "name"), [(10, "centimetres"), (9.8, "kilograms"), (3, "")])
def test_a_factor_has_the_name_of_the_nearest_unit(factor, name):
    said = named_unit(1 / factor)
    assert name in said
    assert bool(said) == bool(name)


@pytest.mark.parametrize(
    ("factor", "quantity", "name"),
    [(57, "rotations", "degrees for radians"), (57, "forces", ""), (25, "rotations", "")],
)
def test_a_factor_has_the_name_of_a_unit_of_its_own_quantity(factor, quantity, name):
    """A force 57 times too large was called one in degrees."""
    remark = named_unit(factor, (quantity,))
    assert (name in remark) if name else not remark


@pytest.mark.filterwarnings("error")
def test_a_channel_at_one_value_has_no_share_of_a_range():
    """A finding said that it was inf % of its range."""
    wrenches, moved = np.zeros((60, 6)), np.zeros((60, 6))
    wrenches[:, 2] = 900 * np.sin(np.linspace(0, 12, 60))
    noise = np.random.default_rng(0).normal(0, 1e-9, 60)
    moved[:, 2], moved[:, 5] = 1e-7 * wrenches[:, 2] + noise, 1e-3
    load_range = LoadRange(np.array([0, 0, -900.0, 0, 0, 0]), np.array([0, 0, 900.0, 0, 0, 0]))
    found = find(Rows.of(wrenches, moved, source=["rig"] * 60), load_range)
    assert not [one for one in found if "inf" in one.message]
