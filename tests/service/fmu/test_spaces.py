"""FMUs of tables of several interfaces and further inputs."""

from __future__ import annotations

import subprocess
import zipfile
from io import BytesIO

import numpy as np
import pytest

from tests.service.fmu.made import need_compiler, packed
from tests.surrogate.test_space import range_of, solved
from wrenchbook.service.fmu.export import make_library
from wrenchbook.surrogate.build import build
from wrenchbook.surrogate.table.rows import Tolerance
from wrenchbook.surrogate.table.space import Input, space_of
from wrenchbook.surrogate.table.spread import spread_wrenches

SPACE = space_of(("left", "right"), [Input("temperature", "degC", "scalar")])
N, M = len(SPACE.inputs), len(SPACE.outputs)
INPUTS, OUTPUTS, BARS = range(N), range(N, N + M), range(N + M, N + 2 * M)
COVERAGE, TOLERANCE = N + 2 * M, [N + 2 * M + 1, N + 2 * M + 2]


@pytest.fixture(scope="module")
def table():
    load_range = range_of(SPACE)
    return build(solved(SPACE, spread_wrenches(load_range, 40)), load_range)


def test_variables_have_the_names_and_units_of_the_space(fmu):
    variables = fmu.description.modelVariables
    inputs = [(one.name, one.unit) for one in variables if one.causality == "input"]
    assert inputs[0] == ("left.fx", "N")
    assert inputs[11:] == [("right.mz", "N.m"), ("temperature", "degC")]
    names = [one.name for one in variables]
    assert names[N : N + M] == list(SPACE.output_names)
    assert names[N + M] == "error_left.ux"
    assert [one.name for one in fmu.description.unitDefinitions][-1] == "degC"


def test_answers_have_the_bits_of_the_table(fmu, table):
    asked, own = np.random.default_rng(3).uniform(-1, 1, (30, N)), packed(table)
    expected = own.batch(asked)
    slopes = own.derivatives(asked)
    direction = np.arange(1.0, N + 1)
    with fmu.running(references=TOLERANCE) as instance:
        for place, wrench in enumerate(asked):
            instance.setReal(list(INPUTS), wrench)
            np.testing.assert_array_equal(instance.getReal(list(OUTPUTS)), expected.outputs[place])
            np.testing.assert_array_equal(instance.getReal(list(BARS)), expected.errors[place])
            assert instance.getInteger([COVERAGE]) == [expected.coverage[place]]
            along = instance.getDirectionalDerivative(list(OUTPUTS), list(INPUTS), direction)
            np.testing.assert_allclose(along, slopes[place] @ direction, rtol=1e-12)


def test_each_tolerance_judges_the_outputs_of_its_kind_at_every_interface(fmu, table):
    limit = Tolerance(2e-3, 3e-3)
    limits = [2e-3, 2e-3, 2e-3, 3e-3, 3e-3, 3e-3] * 2
    asked, own = np.random.default_rng(4).uniform(-1, 1, (30, N)), packed(table)
    values = (limit.translation, limit.rotation)
    with fmu.running(tolerance=values, references=TOLERANCE) as instance:
        for wrench in asked:
            instance.setReal(list(INPUTS), wrench)
            expected = own.batch(wrench[None], limits).coverage
            assert instance.getInteger([COVERAGE]) == expected.tolist()


def test_the_exported_librarys_example_answers_all_inputs(table, tmp_path):
    known = packed(table)
    with zipfile.ZipFile(BytesIO(make_library("ends", known))) as archive:
        archive.extractall(tmp_path)
    lines = [line.strip() for line in (tmp_path / "README.txt").read_text().splitlines()]
    build_line, run_line = (
        next(line for line in lines if line.startswith(word)) for word in ("cc ", "./example ")
    )
    line = " ".join([*need_compiler(), build_line.removeprefix("cc ")])
    subprocess.run(line, shell=True, cwd=tmp_path, check=True, timeout=200)
    ran = subprocess.run(
        run_line, shell=True, cwd=tmp_path, check=True, timeout=60, capture_output=True, text=True
    )
    reply = known.answer([*[1.0] * (N - 1), SPACE.inputs[-1].zero])
    answered = [float(line.split()[0]) for line in ran.stdout.splitlines()[1:]]
    assert tuple(answered) == reply.outputs
