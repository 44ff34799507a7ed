"""STEP files: faces named, groups chosen, one and the same mesh every time."""

import copy
import shutil
import subprocess
import sys
import tomllib

import numpy as np
import pytest

from tests.fea.boxes import volumes
from tests.fea.geometry import draw_bracket, draw_two_bars, require_gmsh, start
from tests.refusals import GOOD
from wrenchbook.fea.bundle.read import BundleError, bundle_of
from wrenchbook.fea.check.reporting import report
from wrenchbook.fea.component import build
from wrenchbook.fea.inspection import unit_warnings
from wrenchbook.fea.mesh.cad.child import open_geometry
from wrenchbook.fea.mesh.cad.meshing import list_shape, mesh_geometry
from wrenchbook.fea.mesh.mapping import area_weights
from wrenchbook.fea.mesh.sources import mesh_of
from wrenchbook.fea.solve import Solver
from wrenchbook.fea.spec.mesh_source import BodySelector, GeometryMeshing

BRACKET = tomllib.loads((GOOD / "bracket" / "component.toml").read_text("utf-8"))


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    created = tmp_path_factory.mktemp("geometry")
    draw_bracket(created / "bracket.step")
    draw_two_bars(created / "bars.step")
    draw_two_bars(created / "apart.stp", space=1.0)
    (created / "broken.step").write_text("ISO-10303-21; nothing")
    return created


def with_mesh(**keys):
    table = copy.deepcopy(BRACKET)
    table["mesh"] = {k: v for k, v in (table["mesh"] | keys).items() if v is not None}
    return table


def test_faces_are_listed_in_metres_with_area_centre_and_outward_normal(folder):
    faces, (body,) = list_shape(folder / "bracket.step")
    assert len(faces) == 9
    assert body["volume"] == pytest.approx(
        80e-3 * 60e-3 * 8e-3 + 8e-3 * 60e-3 * 50e-3 - area(8) * 8e-3
    )
    (hole,) = (face for face in faces if face["kind"] == "Cylinder")
    assert hole["radius"] == pytest.approx(0.008, rel=1e-9)
    assert hole["normal"] is None
    assert hole["centre"] == pytest.approx((0.055, 0.03, 0.004), abs=1e-9)
    (below,) = (face for face in faces if face["normal"] == [0.0, 0.0, -1.0])
    assert below["centre"][2] == pytest.approx(0, abs=1e-9)
    assert below["area"] == pytest.approx(80e-3 * 60e-3 - area(8))
    closed = sum(f["area"] * np.array(f["normal"]) for f in faces if f["normal"])
    assert closed == pytest.approx(0, abs=1e-12)


def area(radius):
    return np.pi * (radius * 1e-3) ** 2


def test_the_mesh_has_the_volume_of_the_body_and_the_areas_of_the_faces(folder):
    mesh = mesh_of(bundle_of(with_mesh(), folder).mesh)
    assert list(mesh.cell_counts) == ["tet10"]
    _, (body,) = list_shape(folder / "bracket.step")
    assert volumes(mesh.points, mesh.blocks[0]).sum() == pytest.approx(body["volume"], rel=1e-3)
    areas = {n: area_weights(mesh.points, g)[1].sum() for n, g in mesh.facet_groups.items()}
    assert areas["wall"] == pytest.approx(0.06 * 0.058, rel=1e-12)
    assert areas["top"] == pytest.approx(0.06 * 0.008, rel=1e-12)
    assert areas["hole"] == pytest.approx(2 * np.pi * 0.008 * 0.008, rel=1e-3)


def test_midside_nodes_lie_on_the_curved_faces(folder):
    mesh = mesh_of(bundle_of(with_mesh(curvature=16), folder).mesh)
    hole = mesh.points[mesh.facet_groups["hole"].node_ids]
    np.testing.assert_allclose(np.hypot(hole[:, 0] - 0.055, hole[:, 1] - 0.03), 0.008, rtol=1e-6)
    assert len(np.unique(hole[np.abs(hole[:, 2]) < 1e-9].round(9), axis=0)) >= 2 * 16


def test_another_process_makes_the_same_mesh_to_the_last_bit(folder):
    code = (
        "import hashlib, sys; from pathlib import Path;"
        "from wrenchbook.fea.mesh.cad.meshing import mesh_geometry;"
        "from wrenchbook.fea.spec.mesh_source import GeometryMeshing;"
        "m = mesh_geometry(Path(sys.argv[1]), GeometryMeshing(0.015));"
        "print(hashlib.sha256(m.points.tobytes() + m.blocks[0].nodes.tobytes()).hexdigest())"
    )
    command = [sys.executable, "-c", code, str(folder / "bracket.step")]
    reported = {subprocess.run(command, capture_output=True, check=True).stdout for _ in range(2)}
    assert len(reported) == 1
    assert len(reported.pop()) == 65


def test_a_size_in_millimetres_is_warned_of(folder):
    component = build(bundle_of(with_mesh(size=0.2), folder))
    warning = next(unit_warnings(component))
    assert warning.where == "mesh.size"
    assert "is 0.2 m, more than the part's" in warning.message


def test_the_fingerprint_covers_the_file_and_every_key_of_its_meshing(folder):
    def print_of(**keys):
        return bundle_of(with_mesh(**keys), folder).fingerprint

    groups = BRACKET["mesh"]["groups"]
    prints = [
        print_of(),
        print_of(size=0.016),
        print_of(curvature=12),
        print_of(groups=groups | {"top": {"near": [0.004, 0.02, 0.058]}}),
        print_of(regions={"b": {"bodies": [1]}}),
        print_of(file="bars.step"),
    ]
    assert len(set(prints)) == len(prints)
    assert print_of(order=2) == print_of(size=15e-3) == print_of()


def test_mistakes_of_the_bundle_are_told_beside_a_geometry_that_cannot_be_read(folder, tmp_path):
    """The file's mistake took the place of all others."""
    shutil.copy(folder / "broken.step", tmp_path)
    text = 'name = "bad"\nnonsense = 3\n[mesh]\nfile = "broken.step"\nsize = 2\n'
    (tmp_path / "component.toml").write_text(text)
    places = [problem["where"] for problem in report(tmp_path)["problems"]]
    assert {"mesh.file", "nonsense"} <= set(places)


def refusal(path):
    """The message of gmsh's own process, which this one takes the place of."""
    with pytest.raises(BundleError) as caught, open_geometry(path):
        pass
    return str(caught.value)


def test_without_the_extra_the_message_says_what_to_install(folder, monkeypatch):
    monkeypatch.setitem(sys.modules, "gmsh", None)
    assert 'pip install "wrenchbook[cad]"' in refusal(folder / "bracket.step")


def test_a_missing_system_library_is_named(folder, monkeypatch):
    class Broken:
        def find_spec(self, name, path=None, target=None):
            if name == "gmsh":
                raise OSError("libGLU.so.1: cannot open shared object file")

    monkeypatch.delitem(sys.modules, "gmsh", raising=False)
    monkeypatch.setattr(sys, "meta_path", [Broken(), *sys.meta_path])
    said = refusal(folder / "bracket.step")
    assert "libGLU.so.1" in said
    assert "apt install libgl1 libglu1-mesa" in said


def test_a_file_of_surfaces_only_is_refused(tmp_path):
    gmsh = require_gmsh()
    start(gmsh)
    try:
        gmsh.option.setNumber("General.Terminal", 0)
        gmsh.model.occ.addRectangle(0, 0, 0, 1, 1)
        gmsh.model.occ.synchronize()
        gmsh.write(str(tmp_path / "flat.step"))
    finally:
        gmsh.finalize()
    with pytest.raises(BundleError, match="no solid body"):
        mesh_geometry(tmp_path / "flat.step", GeometryMeshing(0.1))


def two_bars(file, folder, **interface):
    table = with_mesh(
        file=file,
        size=0.01,
        groups={"a": {"plane": "x", "at": 0}, "b": {"near": [0.1, 0.005, 0.005]}},
        regions={"soft": {"near": [0.09, 0.005, 0.005]}},
    )
    table["supports"]["fixed"] = ["a"]
    table["interface"] = {"section": "b", "coupling": "distributed"} | interface
    table["material"] = [
        {"region": "all", "youngs_modulus": 200e9, "poisson_ratio": 0.0},
        {"region": "soft", "youngs_modulus": 50e9, "poisson_ratio": 0.0},
    ]
    return build(bundle_of(table, folder))


def test_touching_bodies_are_glued_and_their_materials_told_apart(folder):
    built = two_bars("bars.step", folder)
    for number, nodes in zip(built.material_of_cells[0], built.mesh.blocks[0].nodes, strict=True):
        assert number == (built.mesh.points[nodes].mean(axis=0)[0] > 0.05)
    compliance = Solver(built).compliance
    area = 1e-4
    assert compliance[0, 0] == pytest.approx(0.05 / area * (1 / 200e9 + 1 / 50e9), rel=1e-9)


def test_a_region_is_found_by_a_point_inside_its_body(folder):
    choice = {"soft": BodySelector(near=((0.075, 0.005, 0.005),))}
    mesh = mesh_geometry(folder / "bars.step", GeometryMeshing(0.02, regions=choice))
    (cells,) = mesh.regions["soft"]
    middles = mesh.points[mesh.blocks[0].nodes].mean(axis=1)[:, 0]
    np.testing.assert_array_equal(np.sort(cells), np.flatnonzero(middles > 0.05))


def test_a_broken_pipe_stays_an_error_once_a_geometry_was_read(tmp_path):
    """gmsh set its signal back to ending the program: the next pipe that broke was its end."""
    import signal

    draw_bracket(tmp_path / "bracket.step")
    list_shape(tmp_path / "bracket.step")
    assert signal.getsignal(signal.SIGPIPE) == signal.SIG_IGN
