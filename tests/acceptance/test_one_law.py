"""One table, one law, one kernel: whoever answers from a table says the same, bit by bit."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack
from functools import cached_property
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.acceptance.callers import (
    Limit,
    Program,
    Question,
    Said,
    assert_same_bits,
    told_by_fmu,
    told_by_kernel,
    told_by_server,
    told_by_table,
)
from tests.acceptance.imported import KINDS, load, prepare
from tests.service.fmu.made import Opened, need_compiler
from tests.service.live import FULL, moved, served, tangents
from tests.service.test_workers import SeveralProcesses, clients_of_each
from tests.surrogate.kernel.kinds import SAME, SIGMA, asked_of, clean, rounding_of, size_of
from tests.surrogate.softening import SOFT, column
from wrenchbook.service.client import Client, Scene, Table
from wrenchbook.service.fmu.export import NotExportableError, make_fmu
from wrenchbook.service.ops.backup import back_up
from wrenchbook.service.ops.restore import restore
from wrenchbook.surrogate.answer import METHODS
from wrenchbook.surrogate.build import Table as BuiltTable
from wrenchbook.surrogate.build import build
from wrenchbook.surrogate.kernel.binding import PackedTable
from wrenchbook.surrogate.packed.writer import pack, packed_of
from wrenchbook.surrogate.solver_error import SolverError
from wrenchbook.surrogate.table.hdf5 import read_table
from wrenchbook.surrogate.table.rows import LoadRange, Rows, Tolerance


class Place(NamedTuple):
    """Where to ask: of a table's range and rows, so that it can be drawn before there is one."""

    sort: str
    parts: tuple[float, ...]  # of half the load range
    number: int

    def of(self, span: np.ndarray, rows: np.ndarray) -> np.ndarray:
        """The wrench (6,), N and N·m, of a load range (2, 6) and rows (r, 6)."""
        parts, scale = np.array(self.parts), (span[1] - span[0]) / 2
        wrench = span.mean(axis=0) + parts * scale
        if self.sort == "beyond":
            return wrench + 4 * parts * scale
        if self.sort == "none":
            return np.zeros(6)
        if self.sort == "none, negative":
            return np.full(6, -0.0)
        if self.sort in ("single", "few"):
            shown = 1 << self.number % 6 if self.sort == "single" else self.number
            acts = [bool(shown >> load & 1) for load in range(6)]
            return np.where(acts, parts * span[1], -0.0 if self.number & 64 else 0.0)
        if len(rows) and self.sort in ("row", "near a row"):
            row = rows[self.number % len(rows)]
            return row + (1.5e-6 * parts * scale if self.sort == "near a row" else 0.0)
        return wrench


SORTS = ("inside", "beyond", "none", "none, negative", "single", "few", "row", "near a row")
places = st.builds(
    Place,
    st.sampled_from(SORTS),
    st.tuples(*[st.floats(-1, 1)] * 6),
    st.integers(0, 127),
)
tolerances = st.none() | st.tuples(
    st.floats(-8, -3).map(lambda x: 10**x), st.floats(-8, -2).map(lambda x: 10**x)
)
seeds = st.integers(0, 2**32 - 1)
methods = st.none() | st.none() | st.sampled_from(METHODS)


class Asked:
    """One kind of table in the hands of all callers."""

    def __init__(self, name: str, client: Client, folder: Path) -> None:
        self.name, self.folder = name, folder / name
        self.folder.mkdir()
        self.table, self.path = client.download(name), self.folder / "table.wbt"
        self.table.save(self.path)
        self.opened, self.packed = Table.open(self.path), PackedTable.open(self.path)
        (self.folder / "rows.h5").write_bytes(client.export_table(name, "hdf5"))

    @cached_property
    def rows(self) -> np.ndarray:
        """The wrenches of its rows, (r, 6), N and N·m."""
        groups = range(len(self.packed.meta["groups"]))
        return np.concatenate([self.packed.arrays[f"g{one}/row/wrench"] for one in groups])

    @cached_property
    def fmu(self) -> Opened | None:
        """Its FMU; None of a table without rows, which has none."""
        try:
            return Opened(make_fmu(self.name, self.packed), self.folder, self.name)
        except NotExportableError:
            return None

    @cached_property
    def again(self) -> BuiltTable:
        """The table made once more of its exported rows."""
        rows, meta = read_table(self.folder / "rows.h5")
        told, own = self.packed.meta["solver_error"], self.table.tolerance
        linear, known = self.packed.arrays["solver/flags"][[2, 4]].tolist()
        table = build(
            rows,
            meta.load_range,
            tolerance=own and Tolerance(**own),
            linear=bool(linear),
            solver_error=SolverError.read(told),
            locked=np.flatnonzero(self.packed.arrays["space/locked"]).tolist(),
        )
        assert table.bars_are_complete == known
        return table

    def question(self, chosen: list[Place], tolerance=None, method=None) -> Question:
        """Ask this table at some places."""
        span = self.packed.arrays["space/range"]
        wrenches = [place.of(span, self.rows) for place in chosen]
        return Question(np.array(wrenches), tolerance, method)


class House(NamedTuple):
    """All callers: servers of one process and of several, tables in this process, a C program."""

    servers: dict[str, Client]
    kinds: dict[str, Asked]
    program: Program

    def told(self, kind: str, asked: Question) -> dict[str, dict[str, Said]]:
        """What each caller was told, by each of its calls."""
        one = self.kinds[kind]
        told = {
            "download": told_by_table(one.table, asked),
            "opened file": told_by_table(one.opened, asked),
            "kernel": told_by_kernel(one.packed, asked),
            "C program": self.program.told(one.path, asked),
        }
        for name, client in self.servers.items():
            told[name] = told_by_server(client, kind, asked)
        if one.fmu is not None and asked.method is None:
            told["FMU"] = told_by_fmu(one.fmu, asked)
        return told


def assert_all_same(told: dict[str, dict[str, Said]]) -> None:
    """Compare all that anybody was told with what the first was told."""
    calls = [(f"{who}, {call}", said) for who, each in told.items() for call, said in each.items()]
    first, expected = calls[0]
    for call, said in calls[1:]:
        try:
            assert_same_bits(expected, said)
        except AssertionError as error:
            raise AssertionError(f"{call} is not {first}: {error}") from None


@pytest.fixture(scope="module")
def program(tmp_path_factory) -> Program:
    """The C program that answers from any table."""
    return Program(need_compiler(), tmp_path_factory.mktemp("program"))


@pytest.fixture(scope="module")
def house(program, tmp_path_factory) -> Iterator[House]:
    """A server, one of several processes on a backup of it, and what is made of their tables."""
    folder = tmp_path_factory.mktemp("law")
    prepare(folder / "one")
    with ExitStack() as stack, ThreadPoolExecutor(1) as pool:
        plain = stack.enter_context(served(folder / "one"))
        load(plain)
        (folder / "kinds").mkdir()
        kinds = {name: Asked(name, plain, folder / "kinds") for name in KINDS}
        pool.submit(make_fmu, "any", kinds["clean"].packed)  # which compiles what all have
        back_up(folder / "one", folder / "whole.backup")
        restore(folder / "whole.backup", folder / "several")
        workers = SeveralProcesses(folder / "several", solvers=0)
        stack.callback(workers.end)
        several = stack.enter_context(clients_of_each(workers))
        for name, one in kinds.items():
            for client in several:
                version = client.component(name)["table_version"]  # it waits for all rows
                assert version == one.table.version
        servers = {"server": plain} | {
            f"process {number} of several": client for number, client in enumerate(several)
        }
        yield House(servers, kinds, program)


@pytest.mark.parametrize("kind", KINDS)
@settings(max_examples=8)
@given(
    chosen=st.lists(places, min_size=1, max_size=6),
    tolerance=tolerances,
    method=methods,
)
def test_whoever_answers_from_a_table_says_the_same_bit_by_bit(
    house, kind, chosen, tolerance, method
):
    asked = house.kinds[kind].question(chosen, tolerance, method)
    assert_all_same(house.told(kind, asked))


@pytest.mark.parametrize("kind", KINDS)
@settings(max_examples=3)
@given(
    seed=seeds,
    span=st.sampled_from([0.4, 1.0, 1.3, 4.0]),
    tolerance=tolerances,
    method=methods,
)
def test_a_table_made_of_a_servers_rows_says_what_the_servers_does_to_rounding(
    house, kind, seed, span, tolerance, method
):
    one = house.kinds[kind]
    asked, limit = asked_of(one.again, 10, seed, span), tolerance and np.repeat(tolerance, 3)
    own, found = (table.batch(asked, limit, method) for table in (packed_of(one.again), one.packed))
    near = SAME * size_of(one.again) + rounding_of(one.again)
    np.testing.assert_array_equal(found.coverage, own.coverage)
    for ours, theirs, part in ((own[0], found[0], SAME), (own[1], found[1], SIGMA)):
        np.testing.assert_array_equal(np.isnan(theirs), np.isnan(ours))
        apart = np.nan_to_num(np.abs(theirs - ours))
        assert (apart <= near + part * np.nan_to_num(np.abs(ours))).all()


@pytest.mark.parametrize("kind", KINDS)
@settings(max_examples=3)
@given(
    part=st.floats(0.1, 1.0),
    loads=st.sets(st.integers(0, 5), min_size=1),
    places=st.lists(st.tuples(*[st.floats(-1, 1)] * 6), min_size=1, max_size=4),
)
def test_a_table_cut_to_a_scene_says_the_same_at_its_wrenches(house, kind, part, loads, places):
    one = house.kinds[kind]
    ends = one.packed.arrays["space/range"] * part * np.isin(np.arange(6), list(loads))
    spans = np.stack((np.minimum(ends[0], 0.0), np.maximum(ends[1], 0.0)), axis=1).tolist()
    scene = Scene({kind: {"force": spans[:3], "moment": spans[3:]}})
    cut = house.servers["server"].download(kind, scene=scene)
    path = one.folder / "scene.wbt"
    cut.save(path)
    opened = Table.open(path)
    for place in places:
        wrench = np.where(np.array(place) < 0, -ends[0], ends[1]) * place
        expected = vars(one.table.answer(wrench)) | {"elapsed_us": None}
        for found in (cut.answer(wrench), opened.answer(wrench)):
            # repr tells a negative zero, and all digits
            assert repr(vars(found) | {"elapsed_us": None}) == repr(expected)


class Made(NamedTuple):
    """A table that is drawn with its rows, and how it was drawn."""

    size: int
    seed: int
    locked: tuple[int, ...]
    tolerance: Limit
    low: float

    def built(self, kind: str) -> BuiltTable:
        """A table of rows of a kind."""
        rows, more = ROWS[kind](self.size, np.random.default_rng(self.seed))
        scale = np.ones(6) if kind == "softening" else FULL
        span = LoadRange(self.low * scale, scale)
        own = None if self.tolerance is None else Tolerance(*self.tolerance)
        return build(rows, span, tolerance=own, locked=self.locked, version=len(rows), **more)


def _spread(count: int, rng: np.random.Generator) -> np.ndarray:
    return rng.uniform(-1, 1, (count, 6)) * FULL


def _clean(count: int, rng: np.random.Generator) -> np.ndarray:
    return clean(count, int(rng.integers(1 << 31)))


def _mixed(count: int, rng: np.random.Generator) -> np.ndarray:
    return np.concatenate((_clean(count, rng), _spread(count, rng)))


def _rows(wrenches: np.ndarray, **columns: object) -> tuple[Rows, dict[str, Any]]:
    return Rows.of(wrenches, moved(wrenches), **columns), {}


def _with_tangents(count: int, rng: np.random.Generator) -> tuple[Rows, dict[str, Any]]:
    wrenches = _spread(1 + count // 3, rng)
    return _rows(wrenches, compliance=tangents(wrenches), source=["fea"] * len(wrenches))


def _partial(count: int, rng: np.random.Generator) -> tuple[Rows, dict[str, Any]]:
    """Some outputs are in no row, some in a part of them."""
    wrenches = _mixed(count, rng)
    told, never = moved(wrenches), rng.integers(6)
    told[:, never] = np.nan
    told[rng.random(len(told)) < 0.4, (never + rng.integers(1, 5)) % 6] = np.nan
    return Rows.of(wrenches, told), {}


def _measured(count: int, rng: np.random.Generator) -> tuple[Rows, dict[str, Any]]:
    wrenches = _mixed(max(1, count // 2), rng)
    doubt = 1e-6 * rng.choice([0.5, 1.0, 30.0], (len(wrenches), 6))
    return Rows.of(wrenches, moved(wrenches) + 3e-5, uncertainty=doubt), {}


def _near(count: int, rng: np.random.Generator) -> tuple[Rows, dict[str, Any]]:
    """Rows of the same wrench, and of wrenches so near that either answers for the other."""
    wrenches = _mixed(count, rng)
    again = wrenches[rng.integers(len(wrenches), size=6)]
    again[3:] += rng.uniform(-2e-6, 2e-6, (3, 6)) * FULL
    sources = ["fea"] * len(wrenches) + ["rig"] * len(again)
    return _rows(np.concatenate((wrenches, again)), source=sources)


def _beyond(count: int, rng: np.random.Generator) -> tuple[Rows, dict[str, Any]]:
    return _rows(np.concatenate((_clean(count, rng), 3 * _spread(4, rng))))


def _linear(count: int, rng: np.random.Generator) -> tuple[Rows, dict[str, Any]]:
    loads = np.eye(6)[: count % 7] * FULL
    told = {"mesh": (1e-8 * np.eye(6)).tolist(), "linearity": [1e-6] * 6, "loads": FULL.tolist()}
    moves = loads @ (rng.normal(size=(6, 6)) * 1e-6).T
    rows = Rows.of(loads, moves, source=["fea"] * len(loads))
    return rows, {"linear": True, "solver_error": SolverError(told)}


def _softening(count: int, rng: np.random.Generator) -> tuple[Rows, dict[str, Any]]:
    pushed = np.sort(rng.uniform(0.0, 0.85, 2 + count // 2))
    return column(pushed), {"solver_error": SolverError(SOFT)}


ROWS: dict[str, Callable[[int, np.random.Generator], tuple[Rows, dict[str, Any]]]] = {
    "clean": lambda count, rng: _rows(_clean(count, rng)),
    "full": lambda count, rng: _rows(_spread(2 * count, rng)),
    "clean and full": lambda count, rng: _rows(_mixed(count, rng)),
    "with tangents": _with_tangents,
    "partial": _partial,
    "measured": _measured,
    "near each other": _near,
    "beyond": _beyond,
    "linear": _linear,
    "softening": _softening,
}
made_tables = st.builds(
    Made,
    st.integers(1, 20),
    seeds,
    st.sampled_from([(), (), (1,), (0, 4, 5)]),
    tolerances,
    st.sampled_from([-1.0, -0.9]),
)


@pytest.mark.parametrize("kind", ROWS)
@settings(max_examples=5)
@given(
    made=made_tables,
    chosen=st.lists(places, min_size=1, max_size=8),
    tolerance=tolerances,
    method=methods,
)
def test_a_table_of_any_rows_has_the_same_bits_in_every_form(
    program, tmp_path_factory, kind, made, chosen, tolerance, method
):
    table, path = made.built(kind), tmp_path_factory.mktemp("made") / "made.wbt"
    packed = PackedTable.from_bytes(b"".join(pack(table, component="made")))
    here = Table(packed)
    here.save(path)
    opened = PackedTable.open(path)
    span, rows = packed.arrays["space/range"], table.rows.wrench
    asked = Question(np.array([one.of(span, rows) for one in chosen]), tolerance, method)
    assert_all_same(
        {
            "kernel": told_by_kernel(packed, asked),
            "opened file": told_by_kernel(opened, asked),
            "table": told_by_table(here, asked),
            "opened table": told_by_table(Table.open(path), asked),
            "C program": program.told(path, asked),
        }
    )


def test_one_bit_a_zeros_sign_or_a_word_is_a_difference():
    """Else the properties above would say nothing."""
    said = Said(np.array([[0.0, 1.0, np.nan]]), ["thin"], [False], reasons=["few rows"])
    assert_all_same({"one": {"answer": said}, "other": {"answer": said}})
    for other in (
        said._replace(numbers=np.array([[-0.0, 1.0, np.nan]])),
        said._replace(numbers=np.array([[0.0, np.nextafter(1.0, 2.0), np.nan]])),
        said._replace(numbers=np.array([[0.0, 1.0, 0.0]])),
        said._replace(coverage=["covered"]),
        said._replace(held=[True]),
        said._replace(reasons=["no rows"]),
    ):
        with pytest.raises(AssertionError, match="batch is not one, answer"):
            assert_all_same({"one": {"answer": said}, "other": {"batch": other}})
