"""An engineer's own files, from bundle to covered table through HTTP alone.

A CalculiX deck with node sets, solved linearly, and a bracket that exists as a STEP file only,
meshed by gmsh into ten-node tetrahedra and solved with large displacements.
"""

import zipfile

import numpy as np
import pytest

from tests.fea.geometry import draw_bracket

YOUNG = 210e9
LENGTH, SIDE = 0.2, 0.02


def set_up(name, mesh, *, poisson, supports, section, nonlinear, load_range, tolerance):
    """The text of a component.toml."""
    return f"""
name = "{name}"
title = "{name}, from the engineer's own file"
{mesh}
[[material]]
region = "all"
youngs_modulus = {YOUNG}
poisson_ratio = {poisson}
[supports]
fixed = ["{supports}"]
[interface]
section = "{section}"
coupling = "distributed"
[analysis]
nonlinear = {str(nonlinear).lower()}
[range]
force = {load_range[:3]}
moment = {load_range[3:]}
[tolerance]
translation = {tolerance[0]}
rotation = {tolerance[1]}
"""


def zipped(path, files):
    with zipfile.ZipFile(path, "w") as archive:
        for name, content in files.items():
            archive.writestr(name, content)
    return path


def cantilever_deck(along=8, across=2):
    """A CalculiX deck of C3D20R with the node sets ROOT and TIP, in mm."""
    shape = (2 * along + 1, 2 * across + 1, 2 * across + 1)
    grid = np.stack(np.meshgrid(*map(np.arange, shape), indexing="ij"), axis=-1).reshape(-1, 3)
    kept = (grid % 2 != 0).sum(axis=1) <= 1  # corners and middles of edges
    number = np.full(shape, 0)
    number[tuple(grid[kept].T)] = np.arange(1, kept.sum() + 1)
    places = grid[kept] / (np.array(shape) - 1) * [1e3 * LENGTH, 1e3 * SIDE, 1e3 * SIDE]
    lines = ["** a clamped bar", "*NODE, NSET=NALL"]
    lines += [f"{i}, {x:.9g}, {y:.9g}, {z:.9g}" for i, (x, y, z) in enumerate(places, start=1)]
    lines.append("*ELEMENT, TYPE=C3D20R, ELSET=BAR")
    digits = "000 200 220 020 002 202 222 022 100 210 120 010 102 212 122 012 001 201 221 021"
    local = np.array([[int(d) for d in word] for word in digits.split()])
    corners = np.argwhere((grid.reshape(*shape, 3) % 2 == 0).all(axis=3))
    corners = corners[(corners < np.array(shape) - 1).all(axis=1)]
    for element, corner in enumerate(corners, start=1):
        nodes = number[tuple((corner + local).T)].tolist()
        lines += [f"{element}, " + ", ".join(map(str, nodes[:10])) + ","]
        lines += [", ".join(map(str, nodes[10:]))]
    for name, end in (("ROOT", 0), ("TIP", shape[0] - 1)):
        lines.append(f"*NSET, NSET={name}")
        lines += [f"{n}," for n in number[end].ravel() if n]
    lines += ["*MATERIAL, NAME=STEEL", "*ELASTIC", "210000, 0.3", "*STEP", "*STATIC", "*END STEP"]
    return "\n".join(lines) + "\n"


def test_a_calculix_deck_with_node_sets_becomes_a_covered_table(server, tmp_path):
    client = server.start()
    deck = cantilever_deck()
    assert len(deck) < 100_000
    text = set_up(
        "cantilever",
        '[mesh]\nfile = "bar.inp"\nunit = "mm"',
        poisson=0.0,  # a clamp then holds no more than beam theory says
        supports="ROOT",
        section="TIP",
        nonlinear=False,
        load_range=[100, 100, 100, 10, 10, 10],
        tolerance=(1e-6, 1e-5),
    )
    bundle = zipped(tmp_path / "a.zip", {"component.toml": text, "bar.inp": deck})
    assert client.add_component(bundle)["rows"] == 0
    first = client.displacement("cantilever", [0, 0, -50.0], [0, 5.0, 0])
    assert first.coverage != "covered"
    assert client.wait(first.job).status == "done"
    assert client.component("cantilever", wait_s=60)["rows"] == 1  # it waits for the row
    reported = client.displacement("cantilever", [20.0, 0, -80.0], [1.0, 2.0, 3.0])
    assert (reported.coverage, reported.source, reported.method) == ("covered", "table", "linear")
    bent = client.displacement("cantilever", [0, 0, 1.0], [0, 0, 0]).translation[2]
    assert bent == pytest.approx(timoshenko(), rel=1e-3)
    stretched = client.displacement("cantilever", [1.0, 0, 0], [0, 0, 0]).translation[0]
    assert stretched == pytest.approx(LENGTH / SIDE**2 / YOUNG, rel=1e-9)


def timoshenko():
    """Tip displacement under 1 N across, m/N, without lateral contraction."""
    return LENGTH**3 / (3 * YOUNG * SIDE**4 / 12) + LENGTH / (5 / 6 * YOUNG / 2 * SIDE**2)


BRACKET_MESH = """
[mesh]
file = "bracket.step"
size = 0.02
[mesh.groups]
wall = {plane = "x", at = 0}
bolt = {radius = 0.008}
"""


def bracket_bundle(folder):
    step = draw_bracket(folder / "bracket.step").read_bytes()
    text = set_up(
        "bracket",
        BRACKET_MESH,
        poisson=0.3,
        supports="wall",
        section="bolt",
        nonlinear=True,
        load_range=[300, 300, 300, 5, 5, 5],
        tolerance=(2e-6, 5e-5),
    )
    return zipped(folder / "bracket.zip", {"component.toml": text, "bracket.step": step})


def test_a_bracket_from_a_step_file_becomes_a_covered_table(server, tmp_path):
    client = server.start()
    client.add_component(bracket_bundle(tmp_path))
    wrench = ([0, 0, -150.0], [0, 2.0, 0])
    first = client.displacement("bracket", *wrench)
    assert (first.coverage, first.translation) == ("outside", None)
    assert client.wait(first.job).status == "done"
    for round_ in client.fill_until("bracket", budget=40, round_size=40):
        assert {job.status for job in round_.jobs} <= {"done"}
    client.component("bracket", wait_s=60)  # until the table has the last round
    reported = client.displacement("bracket", [50.0, 40.0, -120.0], [1.0, 2.0, -1.0])
    assert (reported.coverage, reported.source) == ("covered", "table"), reported.reason
    true = client.solve("bracket", [50.0, 40.0, -120.0], [1.0, 2.0, -1.0], wait_s=60)
    error = np.abs(reported.vector - true.vector)
    assert error[:3].max() <= 2e-6
    assert error[3:].max() <= 5e-5
    # It hangs down under a load downwards, and by far more than the tolerance.
    assert reported.translation[2] < -1e-5
