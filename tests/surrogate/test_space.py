"""Tables of several interfaces and of further inputs."""

from __future__ import annotations

import json
from collections.abc import Callable
from itertools import combinations_with_replacement
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pytest

from wrenchbook.surrogate.build import build
from wrenchbook.surrogate.design import next_wrenches
from wrenchbook.surrogate.packed.writer import packed_of
from wrenchbook.surrogate.table.hdf5 import read_table, write_table
from wrenchbook.surrogate.table.meta import TableMeta
from wrenchbook.surrogate.table.rows import Floats, LoadRange, RowError, Rows, Tolerance
from wrenchbook.surrogate.table.space import DEFAULT, Input, Space, space_of
from wrenchbook.surrogate.table.spread import spread_wrenches

WARM = space_of(scalars=(Input("temperature", "K", "scalar"),))
LINK = space_of(("left", "right"))
SPACES = {"temperature": WARM, "two interfaces": LINK}


class Response(NamedTuple):
    """A smooth response of any space, and its slopes."""

    moved: Callable[[Floats], Floats]
    slopes: Callable[[Floats], Floats]


def response_of(space: Space) -> Response:
    random = np.random.default_rng(7)
    n, m = len(space.inputs), len(space.outputs)
    straight = 0.01 * random.normal(size=(m, n))
    along, bent = random.normal(size=(6, n)), 0.001 * random.normal(size=(6, m))

    def moved(wrench: Floats) -> Floats:
        return wrench @ straight.T + np.sin(0.6 * wrench @ along.T) @ bent

    def slopes(wrench: Floats) -> Floats:
        rates = 0.6 * np.cos(0.6 * wrench @ along.T)
        return straight + np.einsum("kt,tm,tn->kmn", rates, bent, along)

    return Response(moved, slopes)


def range_of(space: Space) -> LoadRange:
    return LoadRange(-np.ones(len(space.inputs)), np.ones(len(space.inputs)), space)


def solved(space: Space, wrenches: Floats) -> Rows:
    own = response_of(space)
    tangents = own.slopes(wrenches)
    source = ["fea"] * len(wrenches)
    moved = own.moved(wrenches)
    return Rows.of(wrenches, moved, space, compliance=tangents, source=source)


def solved_with_second(space: Space, wrenches: Floats) -> Rows:
    """Solves whose displacements, 1e-9 m and rad, turn no moment: (F, mu) is (F, M)."""
    random = np.random.default_rng(8)
    n, m, size = len(space.inputs), len(space.outputs), 1e-9
    along = 0.4 * random.normal(size=(8, n))
    first = np.tanh(wrenches @ along.T)
    second = 1 - first**2
    moved = size * (wrenches + first @ along)[:, :m]
    tangents = size * (np.eye(n) + np.einsum("kt,ta,tb->kab", second, along, along))[:, :m]
    places = np.array(list(combinations_with_replacement(range(n), 3))).T
    third = -2 * size * np.einsum("kt,tp->kp", first * second, along[:, places].prod(axis=1))
    columns = {"compliance": tangents, "curvature": third, "source": ["fea"] * len(wrenches)}
    return Rows.of(wrenches, moved, space, **columns)


@pytest.mark.parametrize("space", SPACES.values(), ids=SPACES)
def test_error_bars_of_a_nonlinear_table_hold(space: Space):
    load_range = range_of(space)
    rows = solved(space, spread_wrenches(load_range, 40))
    table = packed_of(build(rows, load_range, tolerance=Tolerance(0.003, 0.003)))
    queries = np.random.default_rng(2).uniform(-1, 1, (300, len(space.inputs)))
    result = table.batch(queries)
    errors = np.abs(result.outputs - response_of(space).moved(queries))
    known = np.isfinite(result.errors)
    assert known.mean() > 0.85
    assert (errors <= result.errors)[known].mean() > 0.9
    assert np.median(result.errors[known]) < 8 * np.median(errors[known])


@pytest.mark.parametrize("space", SPACES.values(), ids=SPACES)
def test_derivatives_are_those_of_the_answers(space: Space):
    load_range = range_of(space)
    table = packed_of(build(solved(space, spread_wrenches(load_range, 25)), load_range))
    wrench = 0.3 * np.ones(len(space.inputs))
    steps = 1e-5 * np.eye(len(wrench))
    ends = [table.batch(wrench + sign * steps).outputs for sign in (1, -1)]
    by_differences = ((ends[0] - ends[1]) / 2e-5).T
    np.testing.assert_allclose(table.derivative(wrench.tolist()), by_differences, atol=1e-8)


@pytest.mark.parametrize("space", SPACES.values(), ids=SPACES)
def test_a_linear_component_answers_by_its_matrix(space: Space):
    load_range, n = range_of(space), len(space.inputs)
    matrix = 0.01 * np.random.default_rng(0).normal(size=(len(space.outputs), n))
    row = Rows.of(np.ones((1, n)), [matrix.sum(axis=1)], space, compliance=[matrix], source=["fea"])
    table = packed_of(build(row, load_range, linear=True, tolerance=Tolerance(1e-6, 1e-6)))
    queries = np.random.default_rng(1).uniform(-1, 1, (50, n))
    result = table.batch(queries)
    np.testing.assert_allclose(result.outputs, queries @ matrix.T, rtol=1e-13, atol=1e-15)
    assert not result.coverage.any()
    assert table.answer([2.0] * n).coverage == "outside"


@pytest.mark.parametrize("space", SPACES.values(), ids=SPACES)
def test_one_solve_without_a_tolerance_covers_its_own_wrench_alone(space: Space):
    """Any error was within a limit of infinity: the error bar was 16 times the displacement."""
    rows = solved(space, spread_wrenches(range_of(space), 1))
    table = packed_of(build(rows, range_of(space)))
    wrench = rows.wrench[0]
    at_row = table.answer(wrench.tolist())
    assert (at_row.method, at_row.coverage) == ("row", "covered")
    assert at_row.interpolation == (0.0,) * len(space.outputs)
    assert table.answer((0.5 * wrench).tolist()).coverage == "thin"


def test_too_few_rows_give_no_answer_but_at_themselves():
    rows = solved(LINK, spread_wrenches(range_of(LINK), 3))
    rows = Rows.of(rows.wrench, rows.displacement, LINK, source=["measured"] * 3)
    table = packed_of(build(rows, range_of(LINK)))
    result = table.answer([0.5] * 12)
    assert (result.outputs, result.coverage) == (None, "outside")
    assert "too few rows" in result.reason
    at_row = table.answer(rows.wrench[1].tolist())
    assert (at_row.method, at_row.outputs) == ("row", tuple(rows.displacement[1]))


@pytest.mark.parametrize("space", SPACES.values(), ids=SPACES)
def test_a_file_holds_the_space(space: Space, tmp_path: Path):
    load_range = range_of(space)
    rows = solved(space, spread_wrenches(load_range, 5))
    write_table(tmp_path / "t.h5", rows, TableMeta("link", 5, load_range))
    result, meta = read_table(tmp_path / "t.h5")
    assert result.space == meta.load_range.space == space
    np.testing.assert_array_equal(result.compliance, rows.compliance)
    assert Space.read(json.loads(json.dumps(space.as_json()))) == space


@pytest.mark.parametrize("space", SPACES.values(), ids=SPACES)
def test_a_fill_chooses_full_loads_until_the_tolerance_is_met(space: Space):
    load_range, own = range_of(space), response_of(space)
    limit = Tolerance(0.004, 0.004)
    rows, rounds = Rows.empty(space), 0
    while rounds < 12:
        table = build(rows, load_range, tolerance=limit)
        design = next_wrenches(table, 16)
        if design.stage == "met":
            break
        more = solved(space, design.wrenches)
        rows = Rows.of(
            np.concatenate((rows.wrench, more.wrench)),
            np.concatenate((rows.displacement, more.displacement)),
            space,
            compliance=np.concatenate((rows.compliance, more.compliance)),
            source=["fea"] * (len(rows) + len(more)),
        )
        rounds += 1
    assert design.stage == "met"
    queries = np.random.default_rng(5).uniform(-1, 1, (200, len(space.inputs)))
    result = packed_of(table).batch(queries)
    within = (np.abs(result.outputs - own.moved(queries)) <= 0.004).all(axis=1)
    assert within.mean() > 0.95


def test_a_row_names_the_input_that_is_no_number():
    wrench = np.zeros((1, 12))
    wrench[0, 8] = np.inf
    with pytest.raises(RowError, match=r"row 1: right\.fz must be finite"):
        Rows.of(wrench, np.zeros((1, 12)), LINK)


def test_one_interface_alone_is_the_default_space():
    assert space_of() == DEFAULT
    assert DEFAULT.is_default
    assert not WARM.is_default
    assert DEFAULT.as_json()["outputs"][0] == {"name": "ux", "unit": "m"}


def test_inputs_by_name_are_those_that_vector_takes():
    space = space_of(("left", "right"), [Input("temperature", "K", "scalar")])
    inputs = [float(k) for k in range(13)]
    named = space.by_name(inputs)
    loads = {name: [*one["force"], *one["moment"]] for name, one in named["loads"].items()}
    assert space.vector(loads, named["inputs"]) == tuple(inputs)
