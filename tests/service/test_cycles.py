"""Cycles of a test at an import, and the stiffness of measured rows between two loads."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import t as student

from tests.service.test_import_findings import CALL, csv_of, send
from tests.surrogate.findings.rigs import cantilever
from wrenchbook.service.formats.cycles import MAX_CYCLE_ROWS, with_cycles
from wrenchbook.service.formats.options import Options, ParsedTable, ReadReport
from wrenchbook.surrogate.findings.cycles import line_through, passes_of
from wrenchbook.surrogate.findings.find import find
from wrenchbook.surrogate.table.rows import LoadRange, Rows

FORCE, MOMENT = 500.0, 50.0
SEEDS = (911, 922, 933)
SETTLING = 0.04  # of the load's range: friction turns over behind a turning point
COUNTS = ("loaded", "refused", "tare", "unmatched", "skipped", "branch", "averaged")


def cycles(low, count, points=30):
    """Return a load that goes `count` times from `low` to 1 and back."""
    up = np.linspace(low, 1.0, points)
    return np.concatenate([np.concatenate((up, up[-2:0:-1])) for _ in range(count)] + [[low]])


class Loop:
    """A cantilever under cycles of one load, with friction in the rig and noise."""

    def __init__(self, seed, axis=2, loop=0.05, noise=0.003, low=-1.0, count=4):
        rng = np.random.default_rng(seed)
        self.column = cantilever(rng)[0][:, axis] * (FORCE if axis < 3 else MOMENT)
        self.axis, self.low, share = axis, low, cycles(low, count)
        self.size = np.ptp(self.true(np.linspace(low, 1, 50)), axis=0)
        self.half = loop / 2 * self.size * np.sign(self.column)
        state, states = 1.0, []
        for step in np.diff(share, prepend=low):
            state = np.clip(state + 2 * step / (SETTLING * (1 - low)), -1, 1)
            states.append(state)
        moved = self.true(share) - np.outer(states, self.half)
        moved += noise * self.size * rng.normal(size=moved.shape)
        self.rows = Rows.of(self.wrench(share), moved)

    def true(self, share):
        return np.outer(share - 0.15 * share**3, self.column)

    def wrench(self, share):
        wrench = np.zeros((len(share), 6))
        wrench[:, self.axis] = share * (FORCE if self.axis < 3 else MOMENT)
        return wrench

    def held(self, http, sign):
        """Return the part of the bars that hold a branch: sign -1 of loading, 1 of unloading."""
        share = np.random.default_rng(1).uniform(max(self.low, -0.95), 0.95, 60)
        body = {"wrenches": self.wrench(share).tolist(), "on_thin": "estimate"}
        reply = http.post(CALL.replace("table", "displacements"), json=body).json()
        moved, error = np.array(reply["displacements"]), np.array(reply["errors"], dtype=float)
        return (np.abs(moved - self.true(share) - sign * self.half) <= error).mean()


def add(http):
    spans = {"force": [FORCE] * 3, "moment": [MOMENT] * 3}
    http.post("/v1/components", json={"name": "rig", "title": "R", "range": spans})


def load(http, rows, **query):
    reply = send(http, csv_of(rows), load_cell="moving", wait_s=120, **query)
    assert reply.status_code == 200, reply.text
    counts = reply.json()["rows"]
    assert counts["read"] == sum(counts.get(name, 0) for name in COUNTS)
    return counts


@pytest.mark.parametrize(("loop", "noise"), [(0.02, 0.01), (0.05, 0.003), (0.08, 0.001)])
@pytest.mark.parametrize("seed", SEEDS)
def test_bars_of_a_loaded_branch_hold_it_in_nine_of_ten(http, seed, loop, noise):
    add(http)
    created = Loop(seed, loop=loop, noise=noise)
    counts = load(http, created.rows, branch="unloading", skip_cycles=1)
    assert counts["branch"] > counts["skipped"] > 0
    assert created.held(http, 1) >= 0.9


def test_a_line_without_a_slope_has_no_displacement_at_zero_load():
    assert line_through(np.array([-1.0, 0.0, 1.0, 0.0]), np.array([1.0, 0.0, 1.0, 2.0])) is None


@pytest.mark.parametrize("seed", SEEDS)
def test_of_tests_of_several_axes_in_one_table_bars_hold_both_branches(http, seed):
    add(http)
    for created in (tests := [Loop(seed, axis, noise=0.01) for axis in (2, 1, 4)]):
        load(http, created.rows)
    assert min(created.held(http, sign) for created in tests for sign in (-1, 1)) >= 0.9


def left(rows, **options):
    report = ReadReport(read=len(rows))
    parts = (rows.take(at) for at in np.array_split(np.arange(len(rows)), 3))
    pieces = [ParsedTable(**vars(part), note=["a"] * len(part)) for part in parts]
    result = list(with_cycles(iter(pieces), Options(**options), report))
    return (result[0] if result else rows.take(np.arange(0))), report


@pytest.mark.parametrize("seed", SEEDS)
def test_soft_preload_cycles_that_are_skipped_leave_the_rows_of_the_others(seed):
    clean = Loop(seed, low=0.0).rows
    soft, first = clean.displacement.copy(), np.arange(len(clean)) < 58 * 2
    soft[first] = 1.4 * soft[first] + 1e-4
    rows, report = left(replace(clean, displacement=soft), skip_cycles=2)
    # The lowest row between two cycles is of the one before.
    assert (rows.displacement == clean.displacement[58 * 2 + 1 :]).all()
    assert report.omitted["skipped"] + len(rows) == len(clean)


@pytest.mark.parametrize("sign", [1, -1])
def test_skipped_cycles_of_a_test_to_both_sides_end_at_the_load_of_its_first_row(sign):
    phase = np.linspace(0.02, 8 * np.pi, 160)
    load = sign * np.sin(phase)
    rows = Rows.of(load[:, None] * [0, 0, 500, 0, 0, 0], load[:, None] * np.ones(6) * 1e-3)
    rows, report = left(rows, skip_cycles=2)
    kept = phase > phase[0] + 4 * np.pi
    np.testing.assert_allclose(rows.wrench[:, 2], 500 * load[kept], rtol=1e-14)
    assert report.omitted["skipped"] == (~kept).sum()


def test_the_mean_of_cycles_is_numpys_with_the_half_width_of_the_scatter():
    rows = Loop(5, count=6, low=0.0, noise=0.01).rows
    results, report = left(rows, mean_cycles=True)
    up = rows.displacement[:-1].reshape(6, 58, 6)[1:, 1:30]  # the lowest row is of the pass before
    mean = results.displacement[np.searchsorted(results.wrench[:30, 2], 100.0) : 29]
    np.testing.assert_allclose(mean[-1], [*up[:, 27].mean(axis=0)], atol=0.01 * np.ptp(up))
    scatter = np.sqrt(up.var(axis=0, ddof=1).mean(axis=0))
    half = student.ppf(0.975, 29 * 4) * scatter / np.sqrt(5)
    np.testing.assert_allclose(np.median(results.uncertainty[:30], axis=0), half, rtol=0.3)
    assert report.omitted["averaged"] == len(rows) - len(results)


@pytest.mark.parametrize("deviation", [0.0, 0.1])  # of the load, in N of 10
@pytest.mark.parametrize(
    ("start", "options", "means"),
    [
        (0, {}, [(0, 1), (10, 4), (0, 4)]),
        (0, {"skip_cycles": 1}, [(10, 3), (0, 3)]),
        (1, {"branch": "loading"}, [(10, 3)]),
    ],
)
def test_passes_of_one_row_are_averaged(start, options, means, deviation):
    load = np.array([0, 10, 0, 10, 0, 10, 0, 10, 0.0])[start:]
    load += deviation * np.random.default_rng(7).uniform(-0.5, 0.5, len(load))
    noise = 1e-6 * np.random.default_rng(8).normal(size=(len(load), 6))
    wrench = np.zeros((len(load), 6))
    wrench[:, 2] = load
    rows, report = left(Rows.of(wrench, wrench * 1e-4 + noise), mean_cycles=True, **options)
    assert not report.mistakes.listed()
    np.testing.assert_allclose(rows.wrench[:, 2], [at for at, _ in means], atol=deviation)
    last, count = means[-1]
    of_last = np.flatnonzero(np.abs(load - last) <= deviation)[-count:]
    mean = (wrench * 1e-4 + noise)[of_last].mean(axis=0)
    np.testing.assert_allclose(rows.displacement[-1], mean, rtol=1e-12)
    assert np.isfinite(rows.uncertainty[-1]).all()


@pytest.mark.parametrize("count", [1, 2])
def test_too_many_skipped_cycles_are_refused_with_how_many_can_be_left_out(count):
    wrench = np.zeros((4 * count + 1, 6))
    wrench[:, 2] = [0, *[5, 10, 5, 0] * count]
    rows = Rows.of(wrench, wrench * 1e-6)
    _, report = left(rows, skip_cycles=count)
    (mistake,) = report.mistakes.listed()
    words = f"is {count}, but at most {count - 1} cycles of the main load fz can be left out"
    if count == 1:
        words = "the file has no cycle of fz to leave out; leave out skip_cycles"
    assert words in mistake.message
    retained, report = left(rows, skip_cycles=count - 1)
    assert len(retained)
    assert not report.mistakes.listed()


def test_too_many_skipped_cycles_of_a_test_to_both_sides_are_refused_with_the_right_number():
    """The message of 5 gave 4, and that of 4 gave 3."""
    wrench = np.outer(300 * np.sin(np.linspace(0, 8 * np.pi, 400)), np.eye(6)[2])
    rows = Rows.of(wrench, wrench * 1e-6)
    _, report = left(rows, skip_cycles=5)
    (mistake,) = report.mistakes.listed()
    most = int(mistake.message.split("give at most ")[1])
    assert [
        bool(left(rows, skip_cycles=count)[1].mistakes.listed()) for count in (most, most + 1)
    ] == [
        False,
        True,
    ]


def test_the_mean_of_cycles_with_a_loop_has_a_finding_of_hysteresis_alone():
    """It had findings of a drift, a scale and a zero."""
    turns = np.linspace(0, 8 * np.pi, 400)
    load = 300 * np.sin(turns)
    moved = np.full((400, 6), np.nan)
    moved[:, 2] = load / 2e6 - np.sign(np.cos(turns)) * 3e-6 * np.cos(turns) ** 2
    rows, _ = left(Rows.of(np.outer(load, np.eye(6)[2]), moved), mean_cycles=True)
    bound = np.array([300.0] * 3 + [30.0] * 3)
    findings = find(Rows.of(rows.wrench, rows.displacement), LoadRange(-bound, bound))
    assert [finding.cause for finding in findings] == ["hysteresis"]


def test_passes_of_one_row_at_different_loads_have_no_mean():
    wrench = np.zeros((8, 6))
    wrench[:, 2] = [10, 0, 6, 0, 8, 0, 4, 0]
    rows, report = left(Rows.of(wrench, wrench * 1e-6), mean_cycles=True, branch="loading")
    (mistake,) = report.mistakes.listed()
    assert len(rows) == 0
    assert "fz have no load in common: their first rows differ by up to 4 N" in mistake.message


def test_rows_of_a_pass_within_one_place_become_their_mean():
    wrench = np.zeros((9, 6))
    wrench[:, 2] = [0, 10, 11, 12, 20, 100, 11, 10, 0]
    moved = wrench / 1e6
    result, report = left(Rows.of(wrench, moved), thin=0.05)
    np.testing.assert_allclose(result.wrench[:, 2], [0, 11, 20, 100, 10.5, 0])
    np.testing.assert_allclose(result.displacement, result.wrench / 1e6)
    assert report.omitted["averaged"] == 3


@pytest.mark.parametrize("sign", [1, -1])
def test_loading_leads_away_from_no_load_and_a_held_load_keeps_its_branch(sign):
    load = sign * np.array([0, 0, 40, 100, 100, 99.5, 60, 0, 0, 5, 50, 100.0])
    passes = passes_of(load)
    assert passes.loading.tolist() == [True] * 5 + [False] * 4 + [True] * 3
    assert passes.number.tolist() == [0] * 5 + [1] * 4 + [2] * 3
    assert np.flatnonzero(~passes.sure).tolist() == [5]


def other_load(rows):
    wrench = rows.wrench.copy()
    wrench[60:120, 3] = MOMENT / 2
    return replace(rows, wrench=wrench)


@pytest.mark.parametrize(
    ("change", "options", "words"),
    [
        (other_load, {"mean_cycles": True}, "mx changes by up to 25"),
        (lambda rows: rows.take(np.arange(30)), {"branch": "unloading"}, "no unloading branch"),
        (lambda rows: replace(rows, source=np.full(len(rows), "fea")), {"thin": 0.1}, "solves"),
    ],
)
def test_cycles_that_do_not_allow_an_option_are_refused(change, options, words):
    rows, report = left(change(Loop(5, low=0.0).rows), **options)
    (mistake,) = report.mistakes.listed()
    assert (len(rows), report.mistakes.is_ruined, words in mistake.message) == (0, True, True)


def test_parsed_tables_are_equal_to_themselves_only():
    first, second = (ParsedTable(**vars(Loop(5).rows), note=[]) for _ in range(2))
    assert first != second


def test_a_file_of_more_rows_than_cycles_take_is_refused():
    report = ReadReport(read=MAX_CYCLE_ROWS + 1)
    piece = ParsedTable(**vars(Loop(5).rows), note=[])
    assert list(with_cycles(iter([piece]), Options(thin=0.1), report)) == []
    assert "send it in parts" in report.mistakes.listed()[0].message


@pytest.mark.parametrize("seed", SEEDS)
def test_the_stiffness_between_two_loads_is_numpys_polyfit_of_each_branch(http, seed):
    add(http)
    created = Loop(seed, loop=0.06, noise=0.002)
    load(http, created.rows)
    query = {"between": "100,400", "axis": "fz", "of": "uz", "import": 1}
    body = http.get(CALL.replace("table", "stiffness"), params=query).json()
    force, moved = created.rows.wrench[:, 2], created.rows.displacement[:, 2]
    between, rising = (force >= 100) & (force <= 400), passes_of(force).loading
    parts = {"all": between, "loading": between & rising, "unloading": between & ~rising}
    parts["opposite"] = (force <= -100) & (force >= -400)
    unloaded = {}
    for name, part in parts.items():
        slope, offset = np.polyfit(moved[part], force[part], 1)
        unloaded[name] = -offset / slope
        line = body["lines"][name]
        assert line["rows"] == part.sum()
        assert line["slope"] == pytest.approx(slope, rel=1e-9)
        r2 = np.corrcoef(moved[part], force[part])[0, 1] ** 2
        assert line["r2"] == pytest.approx(r2, rel=1e-9)
    play = abs(unloaded["unloading"] - unloaded["loading"])
    assert body["play"]["branches"]["value"] == pytest.approx(play, rel=1e-9)
    play = unloaded["all"] - unloaded["opposite"]
    assert body["play"]["signs"]["value"] == pytest.approx(play, rel=1e-9)
    assert (body["unit"], body["other_loads"]) == ("N/m", {})
