"""A solve beyond the yield strength says how much of the part is, or fails."""

from dataclasses import replace

import numpy as np
import pytest

from tests.fea.boxes import box
from tests.fea.components import component
from tests.fea.supports import TABLE
from wrenchbook.fea.bundle.read import bundle_of
from wrenchbook.fea.failure import SolveFailed
from wrenchbook.fea.recovery.stress import yielding
from wrenchbook.fea.solve import Solver
from wrenchbook.fea.spec.material import Material
from wrenchbook.fea.spec.problems import BundleError
from wrenchbook.fea.spec.schema import Analysis

STRENGTH = 100e6
AREA, MODULUS = 0.02 * 0.03, 0.03 * 0.02**2 / 6  # of a section 0.02 by 0.03 m, about y


def bar(on_yield="warn", strength=STRENGTH, nonlinear=False):
    mesh = box("hex20", (4, 4, 6), (0.02, 0.03, 0.2))
    one = component(mesh, poisson=0.0)
    material = replace(Material("all", 210e9, 0.0), yield_strength=strength)
    return Solver(
        replace(one, materials=(material,), analysis=Analysis(nonlinear, on_yield=on_yield))
    )


def of_yielding(solution):
    return [note for note in solution.notes if "yield strength" in note]


@pytest.mark.parametrize("nonlinear", [False, True])
def test_a_bar_that_is_pulled_yields_as_a_whole(nonlinear):
    (note,) = of_yielding(bar(nonlinear=nonlinear).solve([0, 0, 1.2 * STRENGTH * AREA, 0, 0, 0]))
    assert note.startswith("1e+02 % of the part's volume is beyond its yield strength")
    assert "up to 1.2 times that of all (1e+08 Pa)" in note


def test_a_bar_that_is_bent_yields_at_its_faces():
    moment = 1.5 * STRENGTH * MODULUS
    (note,) = of_yielding(bar().solve([0, 0, 0, 0, moment, 0]))
    # Of four layers the two outer ones are beyond 2/3 of the half depth at one point of two.
    assert note.startswith("25 % of the part's volume")


@pytest.mark.parametrize("strength", [STRENGTH, None])
def test_a_bar_that_does_not_yield_has_no_note(strength):
    assert not of_yielding(bar(strength=strength).solve([0, 0, 0.9 * STRENGTH * AREA, 0, 0, 0]))


def test_stresses_of_an_answer_are_found_only_where_the_loads_may_make_it_yield(monkeypatch):
    solver, found = bar(), []
    monkeypatch.setattr("wrenchbook.fea.solve.yielding", lambda *_: found.append(1) or "")
    for share in (0.4, 0.49, 0.51, 1.2):
        force, moment = share * STRENGTH * AREA, share * STRENGTH * MODULUS
        solver.solve([0, 0, force, 0, moment, 0])
    assert 1 <= len(found) <= 2


def test_loads_that_show_no_yielding_have_none():
    solver, chance = bar(), np.random.default_rng(3)
    scale = STRENGTH * np.array([2e-5, 2e-5, AREA, MODULUS, MODULUS, MODULUS])
    for wrench in chance.uniform(-0.7, 0.7, (40, 6)) * scale:
        found = solver.solve(wrench)
        assert bool(of_yielding(found)) == bool(yielding(solver.component, solver.body, found))


def test_a_component_that_must_not_yield_has_no_answer_where_it_does():
    solver = bar("fail")
    with pytest.raises(SolveFailed, match="1e\\+02 % of the part's volume") as caught:
        solver.solve([0, 0, 1.2 * STRENGTH * AREA, 0, 0, 0])
    assert caught.value.kind == "yields"
    assert "on_yield" in caught.value.remedy
    assert solver.solve([0, 0, 0.9 * STRENGTH * AREA, 0, 0, 0]).displacement[2] > 0


def bundle(folder, **analysis):
    material = {"region": "all", "youngs_modulus": 1e9, "poisson_ratio": 0.3}
    table = TABLE | {
        "supports": {"fixed": ["z0"]},
        "material": [material],
        "interface": {"section": "z1", "coupling": "rigid"},
        "analysis": {"nonlinear": False} | analysis,
    }
    return bundle_of(table, folder)


def test_the_bundle_says_what_becomes_of_a_solve_that_yields(tmp_path):
    assert bundle(tmp_path).analysis.on_yield == "warn"
    assert bundle(tmp_path, on_yield="fail").analysis.on_yield == "fail"


def test_another_word_is_refused(tmp_path):
    with pytest.raises(BundleError, match="on_yield"):
        bundle(tmp_path, on_yield="stop")
