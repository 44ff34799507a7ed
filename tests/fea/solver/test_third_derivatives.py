"""Second derivatives of a solve's displacements are those of the tangents of solves around it."""

from dataclasses import replace
from functools import cache
from itertools import permutations

import numpy as np
import pytest

from tests.fea.boxes import box
from tests.fea.components import component
from tests.fea.pairs import TIE, pair, tied
from tests.fea.supports import TABLE
from tests.fea.third_derivatives import asymmetry, error, range_of, state_of, strain_part, unpacked
from tests.fea.two_interfaces import column
from tests.validation.clamped import shipped
from wrenchbook.fea.bundle.read import bundle_of
from wrenchbook.fea.component import build
from wrenchbook.fea.solve import Solver
from wrenchbook.fea.solver.third_derivatives import third_derivatives
from wrenchbook.fea.tensors import rotation

SHIPPED = {
    "plate_thin": ({"cells": 2, "rings": 2, "layers": 1}, 0.02),
    "plate": ({"cells": 2, "rings": 2, "layers": 1}, 0.03),
    "spring": ({"cells_per_turn": 12, "active_turns": 1.5, "free_length": 0.024}, 0.15),
    "hot_bracket": ({}, 0.15),
    "link": ({}, 0.15),
}
"""Shipped nonlinear components: what makes their meshes coarse, and the step of differences.

Tangents of slender parts have roundoff of 1e-8, which takes a step of 0.1 of the range.
`make bench NAME=third` has their own meshes.
"""

STEP = 0.03
EPS = np.finfo(float).eps

TURN = rotation(np.array([0.4, -0.7, 0.3]))
LOADS = np.array([1.5e-3, 1.5e-3, 4e-3, 4e-3, 4e-3, 4e-3])  # N, N·m: turn it by up to 15 degrees
SOFT = {"region": "all", "youngs_modulus": 3e8, "poisson_ratio": 0.33, "density": 2e4}
PLY = {
    "region": "all",
    "law": "orthotropic",
    "youngs_modulus": [10e8, 1e8, 8e7],
    "poisson_ratio": [0.3, 0.25, 0.35],
    "shear_modulus": [5e7, 4e7, 3e7],
    "axes": TURN.tolist(),
}
HEAT = {"temperature": {"range": [-40, 120], "reference": 20}}
PULL = {"acceleration": {"range": [20, 20, 20]}}
SPRING = (np.diag([1e5, 2e5, 3e5, 2e3, 3e3, 1e3]) + 200.0).tolist()
BUSHING = {"group": "z0", "coupling": "distributed", "stiffness": SPRING, "axes": TURN.tolist()}
SLIDING = {"group": "x0", "directions": ["x"]}  # a symmetry plane
GUIDED = ["ux", "ry", "rz"]


def tall(law="isotropic", poisson=0.3, **options):
    mesh = box("hex20", (2, 2, 6), (1.0, 1.2, 4.0))
    part = component(mesh, young=1.0, nonlinear=True, **options)
    return replace(part, materials=(replace(part.materials[0], law=law, poisson_ratio=poisson),))


def post(material=SOFT, supports=None, inputs=None, gravity=None, **interface):
    mesh = box("hex20", (2, 2, 4), (0.1, 0.06, 0.4))
    table = TABLE | {
        "supports": supports or {"fixed": ["z0"]},
        "material": [material],
        "interface": {"section": "z1", "coupling": "rigid"} | interface,
        "analysis": {"nonlinear": True} | ({"gravity": gravity} if gravity else {}),
        "range": {"force": [300, 300, 3e3], "moment": [50, 50, 30]},
    }
    return build(bundle_of(table | ({"inputs": inputs} if inputs else {}), "."), mesh)


OTHERS = {
    "rigid, locked": lambda: tall(locked=("uy", "rx"), axes=TURN),
    "distributed": lambda: tall(coupling="distributed", point=[0.3, 0.2, 4.5], axes=TURN),
    "distributed, locked": lambda: tall(coupling="distributed", locked=("ux", "rz")),
    "neo-Hookean": lambda: tall("neo-hookean", coupling="distributed"),
    "neo-Hookean, projected": lambda: tall("neo-hookean", 0.49),
    "projected": lambda: tall(poisson=0.49, coupling="distributed"),
    "two interfaces": lambda: column("rigid", "distributed", nonlinear=True, axes=TURN),
    "two rigid interfaces": lambda: column("rigid", "rigid", nonlinear=True, axes=TURN),
    "two distributed interfaces": lambda: column(*2 * ["distributed"], nonlinear=True, axes=TURN),
    "orthotropic": lambda: post(PLY, coupling="distributed"),
    "bushing": lambda: post(supports={"bushing": [BUSHING]}),
    "rigid bushing": lambda: post(
        supports={"bushing": [BUSHING | {"coupling": "rigid"}]}, coupling="distributed"
    ),
    "temperature": lambda: post(SOFT | {"thermal_expansion": 2e-4}, inputs=HEAT),
    "orthotropic, temperature": lambda: post(
        PLY | {"thermal_expansion": [1e-6, 30e-6, 25e-6]},
        inputs=HEAT,
        coupling="distributed",
        locked=["ux"],
    ),
    "bushing and sliding, temperature": lambda: post(
        PLY | {"thermal_expansion": [1e-6, 30e-6, 25e-6]},
        supports={"bushing": [BUSHING], "sliding": [SLIDING]},
        inputs=HEAT,
        locked=GUIDED,
        point=[0.0, 0.03, 0.4],
    ),
    "tie": lambda: tied(pair(("hex20", "tet10"), 0.01), TIE, analysis={"nonlinear": True}),
    "acceleration": lambda: post(inputs=PULL),
    "acceleration, temperature": lambda: post(
        SOFT | {"thermal_expansion": 2e-4}, inputs=PULL | HEAT, coupling="distributed"
    ),
    "self-weight": lambda: post(gravity=[3, 4, -9], coupling="distributed"),
    "sliding, self-weight": lambda: post(
        supports={"fixed": ["z0"], "sliding": [SLIDING]},
        gravity=[3, 4, -9],
        locked=GUIDED,
        point=[0.0, 0.03, 0.4],
    ),
}


@cache
def solver_of(name):
    return Solver(OTHERS[name]() if name in OTHERS else shipped(name, **SHIPPED[name][0]))


def case(name, share):
    """Return a solver, inputs at a share of its range, and the range's half widths."""
    solver = solver_of(name)
    whole = solver.component
    is_shipped = np.isfinite(whole.bundle.range.high).all()
    scale = range_of(solver) if is_shipped else np.tile(LOADS, len(whole.interfaces))
    random = np.random.default_rng(7).uniform(-1, 1, len(scale))
    return solver, whole.reference_inputs + share * scale * random, scale


@pytest.mark.parametrize("name", OTHERS)
def test_tangents_are_the_derivatives_of_answers_of_all_nodes_and_of_stresses(name):
    solver, inputs, scale = case(name, 0.9)
    result = solver.solve(inputs)
    fields = solver.fields(result)
    direction = 2e-4 * scale * np.random.default_rng(9).uniform(-1, 1, len(scale))
    ahead, behind = (solver.solve(inputs + s * direction, start=result.state) for s in (1, -1))
    for reported, ends in (
        (result.compliance, (ahead.displacement, behind.displacement)),
        (result.tangents, (ahead.nodes, behind.nodes)),
        (fields.stress_slopes, (solver.stresses(ahead), solver.stresses(behind))),
    ):
        slope = (ends[0] - ends[1]) / 2
        assert np.abs(reported @ direction - slope).max() <= 1e-5 * np.abs(slope).max()


@pytest.mark.parametrize("share", [0.3, 0.9])
@pytest.mark.parametrize("name", OTHERS)
def test_second_derivatives_are_those_of_tangents(name, share):
    solver, inputs, scale = case(name, share)
    direction = scale * np.random.default_rng(8).uniform(-1, 1, len(scale))
    assert error(solver, inputs, direction, scale, STEP) <= 1e-6


@pytest.mark.parametrize("name", SHIPPED)
def test_second_derivatives_of_shipped_components_are_those_of_tangents(name):
    solver, inputs, scale = case(name, 0.9)
    direction = scale * np.random.default_rng(8).uniform(-1, 1, len(scale))
    assert error(solver, inputs, direction, scale, SHIPPED[name][1]) <= 1e-6


@pytest.mark.parametrize("name", [*SHIPPED, *OTHERS])
def test_the_tangent_by_the_loads_of_the_energy_is_symmetric(name):
    solver, inputs, _ = case(name, 0.9)
    assert asymmetry(solver, inputs) <= 1e-9


@pytest.mark.parametrize("name", [*SHIPPED, *OTHERS])
def test_third_derivatives_are_symmetric_under_permutations(name):
    """The part by strains, up to 8,000 times the sum that heat leaves of it, rounds the sum.

    Sums over some hundred cells lose the root of their number times the rounding of one.
    """
    solver, inputs, scale = case(name, 0.9)
    state = state_of(solver, inputs)
    tensor = third_derivatives(solver._system, *state)
    strains, active = strain_part(solver, *state)
    sizes = scale[:, None, None] * scale[:, None] * scale
    tensor, strains = tensor * sizes, strains * sizes[np.ix_(active, active, active)]
    largest = max(np.abs(tensor).max(), np.abs(strains).max())
    for order in permutations(range(3)):
        assert np.abs(tensor - tensor.transpose(order)).max() <= 32 * EPS * largest


def test_a_solution_has_the_entries_of_ascending_indices():
    solver, inputs, _ = case("orthotropic", 0.9)
    tensor = third_derivatives(solver._system, *state_of(solver, inputs))
    result = solver.solve(inputs).curvature
    assert result is not None
    assert result.shape == (56,)
    gap = np.abs(unpacked(result) - tensor).max()
    assert gap <= 1e-7 * np.abs(tensor).max()  # of a state that Newton's method takes further


@pytest.mark.parametrize("name", ["plate_thin", "temperature", "neo-Hookean"])
def test_an_unloaded_solution_has_its_second_derivatives(name):
    solver, inputs, scale = case(name, 0.0)
    assert not solver.solve(inputs).displacement.any()
    tensor = unpacked(solver.solve(inputs).curvature)[:6]
    step = 0.02 * scale
    step[3:6] = 0.0  # without a moment the loads of the energy are the inputs
    ends = [solver.solve(inputs + sign * step).displacement for sign in (1, -1)]
    second = np.einsum("abc,b,c->a", tensor, step, step)
    size = np.abs(second).reshape(2, 3).max(axis=1).repeat(3)
    assert (np.abs(sum(ends) - second) <= 2e-3 * size).all()


def test_locked_freedoms_have_no_second_derivatives():
    solver, inputs, _ = case("distributed, locked", 0.9)
    tensor = unpacked(solver.solve(inputs).curvature)
    assert not tensor[[0, 5]].any()


def test_a_linear_solution_has_no_second_derivatives():
    part = tall()
    solver = Solver(replace(part, analysis=replace(part.analysis, nonlinear=False)))
    assert solver.solve(LOADS).curvature is None


def test_a_solution_of_more_than_eight_inputs_has_no_second_derivatives():
    solver, inputs, _ = case("two interfaces", 0.3)
    assert solver.solve(inputs).curvature is None
