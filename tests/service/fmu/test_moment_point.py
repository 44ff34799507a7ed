"""An FMU and a C program in a loop with a column, which bends as a beam-column does."""

import subprocess
from pathlib import Path

import numpy as np
import pytest
from fmpy.fmi2 import FMU2Model, FMU2Slave
from scipy.spatial.transform import Rotation

from tests.column import MESH, deflection, packed_column, slope
from tests.service.fmu.made import COVERAGE, LOADS, OUTPUTS, Opened, need_compiler
from wrenchbook.service.fmu.export import make_fmu
from wrenchbook.surrogate.kernel import build as kernel_build
from wrenchbook.surrogate.kernel.format import write_file

FORCE = 5.0  # N, across the column
# N along it, below zero tension; and m from the interface point to the load, along z.
CASES = [(-100.0, 0.01), (50.0, 0.01), (100.0, 0.0), (100.0, 0.01), (150.0, 0.01), (200.0, 0.0)]


@pytest.fixture(scope="module")
def packed():
    return packed_column()


@pytest.fixture(scope="module")
def fmu(packed, tmp_path_factory):
    need_compiler()
    return Opened(make_fmu("column", packed), tmp_path_factory.mktemp("column"), "column")


def lever(push, beside):
    """The moment, N·m, of a load beside the tip, which turns with it."""
    moment = 0.0
    for _ in range(60):
        turned = slope(push, FORCE, moment)
        moment = beside * (push * np.cos(turned) - FORCE * np.sin(turned))
    return moment


@pytest.mark.parametrize("kind", [FMU2Slave, FMU2Model])
@pytest.mark.parametrize(("push", "beside"), CASES)
def test_an_fmu_in_a_loop_bends_as_a_beam_column(fmu, kind, push, beside):
    force, moved = np.array([-push, 0.0, FORCE]), np.zeros(6)
    with fmu.running(kind) as instance:
        for step in range(60):
            turned = Rotation.from_rotvec(moved[3:]).apply([0.0, 0.0, beside])
            on_the_ground = np.cross(moved[:3] + turned, force)  # about the undeformed point
            moment = on_the_ground - np.cross(moved[:3], force)
            instance.setReal(LOADS, [*force, *moment])
            if kind is FMU2Slave:
                instance.doStep(currentCommunicationPoint=0.01 * step, communicationStepSize=0.01)
            moved = np.array(instance.getReal(OUTPUTS))
        assert instance.getInteger(COVERAGE) == [0]
    assert moved[2] == pytest.approx(deflection(push, FORCE, lever(push, beside)), rel=MESH)


@pytest.fixture(scope="module")
def program(tmp_path_factory):
    """The loop in C, linked with the kernel."""
    path = tmp_path_factory.mktemp("program") / "on_the_ground"
    source, library = Path(__file__).with_name("on_the_ground.c"), kernel_build.ready_library()
    command = [*need_compiler(), "-std=c11", "-Wall", "-Werror", f"-I{kernel_build.FOLDER}"]
    command += ["-o", str(path), str(source), str(library), f"-Wl,-rpath,{library.parent}", "-lm"]
    subprocess.run(command, check=True)
    return path


@pytest.mark.parametrize(("push", "beside"), CASES)
def test_a_loop_in_c_with_a_load_cell_on_the_ground_bends_as_a_beam_column(
    packed, program, tmp_path, push, beside
):
    table = tmp_path / "column.wbt"
    write_file(table, [packed.content])
    words = [str(one) for one in (program, table, push, FORCE, beside)]
    ran = subprocess.run(words, capture_output=True, text=True, check=True)
    coverage, told = ran.stdout.split()
    assert coverage == "0"
    assert float(told) == pytest.approx(deflection(push, FORCE, lever(push, beside)), rel=MESH)


def test_every_moment_of_an_fmu_says_about_which_point_it_is(fmu):
    told = {one.name: one.description for one in fmu.description.modelVariables}
    for name in ("Mx", "My", "Mz"):
        assert told[name] == "load, N.m, about the interface point where it is now"
    assert "interface point where it is now" in fmu.description.description
