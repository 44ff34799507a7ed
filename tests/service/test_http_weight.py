"""Components under their own weight: every answer is the sag and what the wrench adds."""

from __future__ import annotations

import numpy as np
import pytest

from tests.service.live import served
from wrenchbook.fea.bundle.read import read_bundle
from wrenchbook.fea.solve import Solver
from wrenchbook.service.client import WrenchbookError

BUNDLE = """
name = "{name}"
title = "A bar that hangs"
[mesh]
generator = "bar"
length = 1.0
width = 0.02
height = 0.02
cells_along = 8
[[material]]
region = "all"
youngs_modulus = 70e9
poisson_ratio = 0.33
{density}
[supports]
fixed = ["start"]
[interface]
section = "end"
coupling = "rigid"
[analysis]
nonlinear = {nonlinear}
{gravity}
[range]
force = [100, 100, 100]
moment = [5, 5, 5]
[tolerance]
translation = 1e-6
rotation = 1e-6
"""
HANGS = {"density": "density = 2700.0", "gravity": "gravity = [0, 0, -9.81]"}
FORCE, MOMENT = (20.0, -10.0, 30.0), (1.0, 2.0, -3.0)
WRENCH = np.array(FORCE + MOMENT)


def add(client, folder, name="hanging", *, nonlinear=False, density="", gravity=""):
    """Add the bar to a server; return its solver."""
    place = folder / name
    place.mkdir(parents=True)
    text = BUNDLE.format(
        name=name, density=density, gravity=gravity, nonlinear=str(nonlinear).lower()
    )
    (place / "component.toml").write_text(text, "utf-8")
    client.add_component(place)
    return Solver(read_bundle(place))


@pytest.fixture(scope="module")
def hanging(tmp_path_factory):
    """A client of a server whose linear component was solved once, and the component's solver."""
    folder = tmp_path_factory.mktemp("weight")
    with served(folder / "data", solvers=1) as client:
        solver = add(client, folder, **HANGS)
        client.displacement("hanging", FORCE, MOMENT, on_thin="wait", wait_s=120)
        client.component("hanging", wait_s=60)  # which waits for the row
        yield client, solver


def six(answer):
    return np.concatenate([answer.translation, answer.rotation])


@pytest.mark.parametrize("part", [0.0, 1.0, -0.7])
def test_a_linear_component_answers_the_sag_and_the_matrix(hanging, part):
    client, solver = hanging
    result = client.displacement("hanging", part * WRENCH[:3], part * WRENCH[3:])
    expected = solver.linear.sag_displacement + solver.compliance @ (part * WRENCH)
    assert six(result) == pytest.approx(expected, rel=1e-9, abs=1e-13)
    assert result.coverage == "covered"
    reported = client.component("hanging")["interface"]
    assert reported["gravity"] == [0, 0, -9.81]
    assert "without its weight" in reported["displacement"]


def test_the_surface_hangs_at_zero_load(hanging):
    client, solver = hanging
    result = client.deformed("hanging", (0, 0, 0))
    lowest = solver.linear.sag[:, 2].min()
    assert np.asarray(result.displacement)[:, 2].min() == pytest.approx(lowest, rel=1e-6)


def test_the_own_weight_that_is_left_out_is_a_warning(hanging, tmp_path):
    client, _ = hanging
    add(client, tmp_path, "light", density=HANGS["density"])
    (one,) = (w for w in client.component("light")["warnings"] if "gravity" in w["where"])
    assert "more than the tolerance" in one["message"]
    assert "gravity = [0, 0, -9.81]" in one["message"]


def test_gravity_without_a_density_is_refused(hanging, tmp_path):
    client, _ = hanging
    with pytest.raises(WrenchbookError, match=r"material\[0\].density"):
        add(client, tmp_path, "massless", gravity=HANGS["gravity"])


def test_a_nonlinear_component_answers_its_sag_at_zero_load(hanging, tmp_path):
    client, _ = hanging
    solver = add(client, tmp_path, "bent", nonlinear=True, **HANGS)
    result = client.displacement("bent", (0, 0, 0), on_thin="wait", wait_s=120)
    assert six(result) == pytest.approx(solver.solve(np.zeros(6)).displacement, rel=1e-7, abs=1e-12)
