"""The acceleration as three inputs: closed forms, gravity, CalculiX, tangents and mistakes."""

import tomllib

import numpy as np
import pytest

from tests.fea.boxes import box
from tests.fea.calculix import require_ccx
from tests.fea.supports import TABLE, largest
from tests.fea.two_interfaces import LINK
from tests.validation import calculix
from wrenchbook.fea.bundle.read import bundle_of
from wrenchbook.fea.component import build
from wrenchbook.fea.solve import Solver
from wrenchbook.fea.spec.problems import BundleError

YOUNG, DENSITY, LENGTH, SIDE = 70e9, 2700.0, 1.0, 0.02
ALUMINIUM = {
    "region": "all",
    "youngs_modulus": YOUNG,
    "poisson_ratio": 0.3,
    "density": DENSITY,
    "thermal_expansion": 23e-6,
}
TURNED = [[0.0, 1.0, 0.0], [0.6, 0.0, 0.8], [0.8, 0.0, -0.6]]
PULLED = {"acceleration": {"range": [20, 20, 20]}}
WARM = {"temperature": {"range": [-40, 120], "reference": 20}}
LOADS = np.array([50.0, -20.0, 30.0, 2.0, -3.0, 1.0])
DOWN = np.array([3.0, -12.0, 7.0])


def table(inputs=PULLED, *, nonlinear=False, gravity=None, coupling="rigid", **material):
    analysis = {"nonlinear": nonlinear} | ({"gravity": gravity} if gravity else {})
    return TABLE | {
        "supports": {"fixed": ["z0"]},
        "material": [ALUMINIUM | material],
        "interface": {"section": "z1", "coupling": coupling, "axes": TURNED},
        "analysis": analysis,
        "inputs": inputs,
    }


def solver(folder, inputs=PULLED, cells=(2, 2, 20), **options):
    mesh = box("hex20", cells, (SIDE, SIDE, LENGTH))
    return Solver(build(bundle_of(table(inputs, **options), folder), mesh))


@pytest.mark.parametrize("axis", [0, 1])
def test_a_clamped_beam_sags_under_an_acceleration_as_the_closed_form_has_it(tmp_path, axis):
    own = solver(tmp_path, poisson_ratio=0.0)
    pull = 9.81 * np.eye(3)[axis]
    moved = own.solve([*np.zeros(6), *pull]).displacement[:3] @ np.array(TURNED)
    inertia, line = SIDE**4 / 12, DENSITY * 9.81 * SIDE**2
    shear = line * LENGTH**2 / (2 * (YOUNG / 2) * SIDE**2 * 5 / 6)
    expected = line * LENGTH**4 / (8 * YOUNG * inertia) + shear
    assert moved[axis] == pytest.approx(expected, rel=1e-3)
    assert np.abs(np.delete(moved, axis)).max() < 1e-9 * expected


@pytest.mark.parametrize(("nonlinear", "most"), [(False, 1e-9), (True, 1e-6)])
@pytest.mark.parametrize("coupling", ["rigid", "distributed"])
def test_gravity_is_an_acceleration_that_never_changes(tmp_path, coupling, nonlinear, most):
    way = {"nonlinear": nonlinear, "coupling": coupling}
    inputs = solver(tmp_path, **way).solve([*LOADS, *DOWN])
    fixed = solver(tmp_path, {}, gravity=DOWN.tolist(), **way).solve(LOADS)
    both = solver(tmp_path, gravity=(0.25 * DOWN).tolist(), **way).solve([*LOADS, *(0.75 * DOWN)])
    for other in (fixed, both):
        assert largest(other.nodes - inputs.nodes, inputs.nodes) < most
        assert largest(other.compliance[:, :6] - inputs.compliance[:, :6], inputs.compliance) < most
        assert other.strain_energy == pytest.approx(inputs.strain_energy, rel=10 * most)


def test_a_linear_answer_is_the_sum_of_those_of_its_inputs(tmp_path):
    own = solver(tmp_path, PULLED | WARM)
    result = own.solve([*LOADS, 70.0, *DOWN])
    parts = [[*LOADS, 20.0, 0, 0, 0], [*np.zeros(6), 70.0, 0, 0, 0], [*np.zeros(6), 20.0, *DOWN]]
    total = sum(own.solve(part).displacement for part in parts)
    np.testing.assert_allclose(result.displacement, total, rtol=1e-11, atol=1e-18)


@pytest.mark.parametrize("temperature", [20.0, 70.0])
@pytest.mark.parametrize("gravity", [None, [2.0, -3.0, -9.81]])
def test_the_work_of_all_inputs_of_a_linear_answer_is_the_strain_energy(
    tmp_path, temperature, gravity
):
    way = {} if gravity is None else {"gravity": gravity}
    result = solver(tmp_path, PULLED | WARM, **way).solve([*LOADS, temperature, *DOWN])
    assert result.work == pytest.approx(result.strain_energy, rel=1e-9)


@pytest.mark.parametrize(("nonlinear", "most"), [(False, 1e-6), (True, 1e-4)])
def test_calculix_has_the_same_answer_on_the_same_mesh(tmp_path, nonlinear, most):
    require_ccx()
    how = {"nonlinear": nonlinear, "gravity": [2.0, -3.0, -9.81], "youngs_modulus": 7e9}
    own = solver(tmp_path, PULLED | WARM, (1, 2, 4), **how)
    inputs = [*(0.3 * LOADS), 70.0, *DOWN]
    result = own.solve(inputs).displacement
    reply = calculix.solve_rigid(own.component, inputs, result[3:] if nonlinear else None)
    assert calculix.worst_gap(result, reply.displacement) < most


def test_the_work_of_loads_and_acceleration_is_the_strain_energy(tmp_path):
    own = solver(tmp_path, nonlinear=True, youngs_modulus=2e9)
    result = own.solve([*(0.2 * LOADS), *DOWN])
    assert result.work == pytest.approx(result.strain_energy, rel=1e-2)


def link(nonlinear):
    """Return the text of a bundle of a link between two joints with all four further inputs."""
    further = "[inputs]\ntemperature = {range = [-40, 120], reference = 20}\n"
    further += "acceleration = {range = [20, 20, 10]}\n[analysis]"
    text = LINK.replace("[analysis]", further)
    text = text.replace("density", "thermal_expansion = 23e-6\ndensity")
    return text.replace("nonlinear = false", f"nonlinear = {str(nonlinear).lower()}")


@pytest.mark.parametrize("nonlinear", [False, True])
def test_a_link_between_two_joints_takes_temperature_and_acceleration(tmp_path, nonlinear):
    own = Solver(bundle_of(tomllib.loads(link(nonlinear)), tmp_path))
    pulled = {"temperature": 80.0, "ax": 5.0, "ay": -12.0, "az": 7.0}
    result = own.solve({"right": LOADS} | pulled)
    assert result.compliance.shape == (12, 16)
    assert not result.displacement[:6].any()
    stresses = own.fields(result).stress_slopes
    for number, step in ((8, 1.0), (12, 0.05), (13, 0.5), (15, 0.5)):
        ahead, behind = (own.solve(result.wrench + s * np.eye(16)[number]) for s in (step, -step))
        slope = (ahead.displacement - behind.displacement) / (2 * step)
        assert largest(slope - result.compliance[:, number], slope) < 1e-5
        slope = (own.stresses(ahead) - own.stresses(behind)) / (2 * step)
        assert largest(slope - stresses[:, :, number], slope) < 1e-5


def test_inputs_without_the_acceleration_are_refused(tmp_path):
    own = solver(tmp_path, cells=(1, 1, 2))
    with pytest.raises(ValueError, match=r"9 finite numbers.*then ax, ay, az"):
        own.solve(LOADS)
    with pytest.raises(ValueError, match='"az" is missing'):
        own.solve({"": LOADS, "ax": 0.0, "ay": 0.0})


def test_the_fingerprint_changes_with_the_density_and_not_with_the_range(tmp_path):
    def digits(inputs, density=DENSITY):
        return bundle_of(table(inputs, density=density), tmp_path).fingerprint

    wider = {"acceleration": {"range": [30, 30, 30]}}
    assert digits(PULLED) == digits(wider)
    assert len({digits(PULLED), digits(PULLED, 7800.0), digits({}), digits(PULLED | WARM)}) == 4
    assert digits({}) == digits({}, 7800.0)


def test_more_inputs_than_there_are_corners_to_look_at_are_refused(tmp_path):
    whole = table(WARM | PULLED)
    del whole["interface"], whole["range"]
    whole["interface"] = [
        {"name": name, "section": name, "coupling": "rigid", "range": TABLE["range"]}
        for name in ("x1", "y1", "z1")
    ]
    with pytest.raises(BundleError, match="22 inputs vary, more than 18"):
        bundle_of(whole, tmp_path)


def test_a_load_of_one_interface_of_several_may_be_zero(tmp_path):
    whole = table(WARM | PULLED)
    del whole["interface"], whole["range"]
    span = {"force": [0, 100, 100], "moment": [0, 0, 5]}
    whole["interface"] = [
        {"name": name, "section": name, "coupling": "rigid", "range": span} for name in ("x1", "y1")
    ]
    result = bundle_of(whole, tmp_path).range
    assert result.high.tolist() == [0, 100, 100, 0, 0, 5] * 2
