"""STEP files for tests, drawn with gmsh's geometry kernel; lengths in mm as CAD writes them."""

from __future__ import annotations

import os
import signal
from contextlib import contextmanager

import pytest


def require_gmsh():
    """Return gmsh; without it skip, or fail where everything must run (the variable CI is set)."""
    try:
        import gmsh
    except (ImportError, OSError) as error:
        if os.environ.get("CI"):
            raise
        pytest.skip(f'gmsh cannot be imported ({error}); pip install "wrenchbook[cad]"')
    return gmsh


def start(gmsh):
    """Start gmsh, and have a broken pipe stay an error: gmsh lets it end the whole program."""
    before = signal.getsignal(signal.SIGPIPE)
    gmsh.initialize(readConfigFiles=False, interruptible=False)
    signal.signal(signal.SIGPIPE, before)


@contextmanager
def drawing(path):
    """Draw with the kernel that this yields; written to `path` at the end."""
    gmsh = require_gmsh()
    start(gmsh)
    try:
        gmsh.option.setNumber("General.Terminal", 0)
        gmsh.model.add("drawing")
        yield gmsh.model.occ
        gmsh.model.occ.synchronize()
        gmsh.write(str(path))
    finally:
        gmsh.finalize()


def draw_bracket(path):
    """An L of 80 x 60 x 58 mm from 8 mm plate, a hole of radius 8 mm in the foot at (55, 30)."""
    with drawing(path) as occ:
        foot = occ.addBox(0, 0, 0, 80, 60, 8)
        wall = occ.addBox(0, 0, 8, 8, 60, 50)
        (solid,), _ = occ.fuse([(3, foot)], [(3, wall)])
        hole = occ.addCylinder(55, 30, -1, 0, 0, 10, 8)
        occ.cut([solid], [(3, hole)])
    return path


def draw_two_bars(path, space=0.0):
    """Two bars of 50 x 10 x 10 mm in a row along x, `space` mm apart."""
    with drawing(path) as occ:
        occ.addBox(0, 0, 0, 50, 10, 10)
        occ.addBox(50 + space, 0, 0, 50, 10, 10)
    return path


_ABORTING = """
import importlib.machinery, importlib.util, os, sys
places = [place for place in sys.path if place != os.path.dirname(__file__)]
spec = importlib.machinery.PathFinder.find_spec("gmsh", places)
gmsh = sys.modules["gmsh"] = importlib.util.module_from_spec(spec)
spec.loader.exec_module(gmsh)
generate = gmsh.model.mesh.generate

def aborting(dimension):
    size = gmsh.option.getNumber("Mesh.MeshSizeMax")
    optimised = gmsh.option.getNumber("Mesh.HighOrderOptimize") == 1
    if {condition}:
        os.write(2, b"  what():  Failed to reach critical value\\n")
        os.abort()
    generate(dimension)

gmsh.model.mesh.generate = aborting
"""


def abort_gmsh(monkeypatch, folder, condition):
    """Have gmsh's processes abort where `condition` holds of ``size`` (mm) and ``optimised``."""
    require_gmsh()
    folder.mkdir()
    (folder / "gmsh.py").write_text(_ABORTING.format(condition=condition))
    monkeypatch.setenv("PYTHONPATH", str(folder))
