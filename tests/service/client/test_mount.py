"""The mount by itself: poses, coverage, modes, and what it refuses."""

from __future__ import annotations

import itertools
import re
import time
import warnings

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.integrate import solve_ivp
from scipy.spatial.transform import Rotation

from tests.service.client.answers import (
    TOLERANCE,
    LinearTable,
    ScriptedTable,
    answer,
    bar_compliance,
    client_with,
)
from tests.service.client.joint_scenes import linear_table
from wrenchbook.service.client import Displacement, ServerTimeout, ServerUnreachable, conventions
from wrenchbook.service.client.job import SHORTEST_POLL_S
from wrenchbook.service.client.mount import (
    CouplingDiverged,
    DisplacementUnknown,
    Mount,
    MountWarning,
    SensorError,
)
from wrenchbook.service.client.mount.mount import Coverage, from_world, require_weight
from wrenchbook.service.client.mount.ringing import first_frequency

TURNED = Rotation.from_rotvec([0.3, -0.8, 1.1]).as_matrix()
POINT = np.array([0.4, -0.2, 1.5])
WEIGHT = np.array([0.0, 0.0, -100.0, 0.0, 0.0, 0.0])
vectors = st.lists(st.floats(-3, 3), min_size=3, max_size=3).map(np.array)


def mounted(source=None, **options) -> Mount:
    source = source or LinearTable()
    return Mount(
        source, source.name if hasattr(source, "name") else "plate", TURNED, POINT, **options
    )


def test_the_pose_is_the_undeformed_one_moved_in_its_own_frame_and_turned_after_it():
    moved = np.array([1e-3, 2e-3, -3e-3, 0.1, -0.05, 0.2])
    R, p = mounted(ScriptedTable(answer(moved))).step(WEIGHT)
    assert np.allclose(p, POINT + TURNED @ moved[:3], rtol=0, atol=1e-15)
    turn = Rotation.from_rotvec(moved[3:]).as_matrix()
    assert np.allclose(R, TURNED @ turn, rtol=0, atol=1e-15)
    assert not np.allclose(R, turn @ TURNED, atol=1e-3)


@given(vectors, vectors, vectors, vectors)
def test_a_wrench_read_in_the_world_is_what_the_conventions_make_of_it(force, moment, point, turn):
    axes = Rotation.from_rotvec(turn).as_matrix()
    result = from_world(force, moment, point, (axes, POINT))
    there = np.concatenate([force, moment])
    lever = axes.T @ (point - POINT)
    expected = conventions.moved(there, rotation=axes.T, point=lever)
    assert np.allclose(result, expected, rtol=0, atol=1e-12)


def test_a_moment_is_about_the_interface_point_where_it_is_now():
    mount = mounted()
    _, present = mount.step(WEIGHT)
    assert np.abs(present - POINT).max() > 1e-4
    result = mount.wrench_of([0, 0, -100.0], [0, 0, 0], present + np.array([0.01, 0.0, 0.0]))
    assert np.allclose(TURNED @ result[3:], [0, 1.0, 0], rtol=0, atol=1e-12)
    on_the_ground = mount.wrench_of([0, 0, -100.0], [0, 0, 0], POINT)
    lever = np.cross(POINT - present, [0, 0, -100.0])
    assert np.allclose(TURNED @ on_the_ground[3:], lever, rtol=0, atol=1e-12)
    assert mount.wrench_of([0, 0, -100.0], [0, 0, 0], present)[3:].tolist() == [0.0, 0.0, 0.0]


def test_while_a_scene_is_evaluated_the_mount_stands_in_the_pose_of_the_evaluation():
    mount, stood = mounted(), []

    def scene(R, p):
        stood.append(bool((mount.pose[0] == R).all() and (mount.pose[1] == p).all()))
        if len(stood) == 3:
            raise ZeroDivisionError
        return mount.wrench_of([0, 0, -40.0], [0, 0, 0], p + R @ [0.3, 0.1, 0.05])

    with pytest.raises(ZeroDivisionError):
        mount.settle(scene, accuracy=1e-9)
    assert stood == [True] * 3
    assert not mount.displacement.any()


def test_a_moving_base_takes_the_displacement_along():
    mount = mounted()
    _, p = mount.step(WEIGHT)
    moved = mount.displacement[:3]
    assert np.allclose(p, POINT + TURNED @ moved, atol=1e-15)
    with pytest.warns(MountWarning, match="joint"):
        mount.place(np.eye(3), [1.0, 2.0, 3.0])
    assert np.allclose(mount.pose[1], np.array([1.0, 2.0, 3.0]) + moved, rtol=0, atol=1e-15)
    assert np.allclose(mount.step(WEIGHT)[1], np.array([1.0, 2.0, 3.0]) + moved, rtol=0, atol=1e-15)


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
def test_a_reading_that_is_not_finite_is_named_and_moves_nothing(bad):
    table = LinearTable()
    mount = mounted(table)
    before = mount.step(WEIGHT)
    with pytest.raises(SensorError, match=r"my must be finite, .*diverged before this step"):
        mount.step([0, 0, -100.0], [0, bad, 0])
    assert len(table.asked) == 1
    assert np.array_equal(mount.pose[1], before[1])


def test_thin_and_outside_are_warned_of_once_and_counted():
    reasons = {"thin": "too few rows", "outside": "fz is beyond -2000"}
    kinds = ["covered", "thin", "thin", "outside", "covered", "outside"]
    reported = [answer(np.zeros(6), WEIGHT, kind, reason=reasons.get(kind, "")) for kind in kinds]
    mount = mounted(ScriptedTable(*reported))
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        for _ in kinds:
            mount.step(WEIGHT)
    assert [str(item.message).count("too few rows") for item in caught] == [1, 0]
    assert [item.filename for item in caught] == [__file__] * 2  # the caller's line, not ours
    seen = mount.coverage
    assert (seen.covered, seen.thin, seen.outside, seen.unknown) == (2, 2, 2, 0)
    assert seen.first["outside"].step == 4
    assert "6 answers: 2 covered, 2 thin, 2 outside" in str(seen)
    assert seen.widest.tolist() == [1e-6] * 6


def test_an_error_bar_that_no_answer_has_is_unknown_and_not_zero():
    seen = Coverage()
    error = {"translation": [1e-6, None, 1e-6], "rotation": [1e-6] * 3}
    body = {"component": "plate", "translation": [0.0] * 3, "rotation": [0.0] * 3, "error": error}
    seen.add(Displacement.read({**body, "coverage": "covered"}, WEIGHT), known=True)
    assert np.isnan(seen.widest).tolist() == [False, True, False, False, False, False]


def test_where_a_table_knows_nothing_the_pose_stays_and_it_is_said():
    nothing = answer(None, WEIGHT, "outside", reason="the table has no rows")
    mount = mounted(ScriptedTable(answer(np.full(6, 1e-3)), nothing))
    before = mount.step(WEIGHT)
    with pytest.warns(MountWarning, match=r"no rows.*appears once"):
        after = mount.step(2 * WEIGHT)
    assert np.array_equal(before[1], after[1])
    assert mount.coverage.unknown == 1


def test_a_pose_of_an_extrapolation_does_not_stay_where_the_table_has_no_more_answers():
    """A coupling that runs away: no answer limits the load that its own pose causes."""
    far = answer(np.full(6, 0.01), WEIGHT, "outside", reason="beyond the range")
    nothing = [answer(None, WEIGHT, "outside", reason="beyond its limits")] * 17
    mount = mounted(ScriptedTable(answer(np.full(6, 1e-3)), far, *nothing))
    with pytest.warns(MountWarning):
        poses = [mount.step(WEIGHT)[1] for _ in range(18)]
    assert np.array_equal(poses[1], poses[-1])
    with pytest.raises(CouplingDiverged, match=r"17 wrenches in a row.*extrapolation"):
        mount.step(WEIGHT)


def test_a_pose_within_the_table_stays_however_long_the_table_has_no_answer():
    nothing = [answer(None, WEIGHT, "outside", reason="no such rows")] * 30
    mount = mounted(ScriptedTable(answer(np.full(6, 1e-3)), *nothing))
    with pytest.warns(MountWarning):
        poses = [mount.step(WEIGHT)[1] for _ in range(31)]
    assert np.array_equal(poses[0], poses[-1])


def test_a_static_loop_does_not_go_on_without_an_answer():
    mount = mounted(ScriptedTable(answer(None, WEIGHT, "outside", reason="no rows")))
    with (
        pytest.warns(MountWarning),
        pytest.raises(DisplacementUnknown, match="mode='solve'"),
    ):
        mount.settle(lambda R, p: WEIGHT)


def test_a_measured_table_without_all_outputs_is_refused_or_taken_as_rigid_there():
    partial = answer([1e-3, None, 0, 0, None, 0.1])
    with pytest.raises(DisplacementUnknown, match=r"has no value of uy, ry .*unmeasured='rigid'"):
        mounted(ScriptedTable(partial)).step(WEIGHT)
    mount = mounted(ScriptedTable(partial), unmeasured="rigid")
    mount.step(WEIGHT)
    assert mount.displacement.tolist() == [1e-3, 0, 0, 0, 0, 0.1]


def test_a_measured_component_is_estimated_instead_of_queued():
    asked = []

    def displacement(name, wrench, **how):
        asked.append(how["on_thin"])
        return answer(np.zeros(6))

    measured = {"has_fea": False, "tolerance": None}
    client = client_with(component=lambda _: measured, displacement=displacement)
    mounted(client).step(WEIGHT)
    mounted(client_with(displacement=displacement)).step(WEIGHT)
    assert asked == ["estimate", "queue"]


def test_with_the_server_away_the_step_can_be_made_again():
    away = ServerUnreachable("no answer")
    mount = mounted(ScriptedTable(answer(np.full(6, 1e-3)), away, answer(np.full(6, 2e-3))))
    before = mount.step(WEIGHT)
    with pytest.raises(ServerUnreachable):
        mount.step(WEIGHT)
    assert np.array_equal(mount.pose[1], before[1])
    assert mount.coverage.answers == 1
    mount.step(WEIGHT)
    assert mount.displacement.tolist() == [2e-3] * 6


def test_solve_waits_until_the_solve_has_answered():
    waits = [answer(None, WEIGHT, "thin"), answer(np.full(6, 1e-3), WEIGHT)]
    asked = []

    def solve(name, wrench, **how):
        asked.append(how)
        return waits[len(asked) - 1]

    mount = mounted(client_with(solve=solve), mode="solve")
    mount.step(WEIGHT)
    assert mount.displacement.tolist() == [1e-3] * 6
    assert len(asked) == 2
    assert all(how["wait_s"] > 0 for how in asked)


def test_a_server_that_answers_at_once_is_asked_again_after_a_pause(monkeypatch):
    answers = [answer(None, WEIGHT, "thin"), answer(np.full(6, 1e-3), WEIGHT)]
    pauses = []
    monkeypatch.setattr(time, "sleep", pauses.append)
    solve = lambda *_, **__: answers.pop(0)  # noqa: E731
    mounted(client_with(solve=solve), mode="solve").step(WEIGHT)
    assert pauses == [SHORTEST_POLL_S]


def test_a_solve_that_takes_too_long_is_named():
    client = client_with(solve=lambda *_, **__: answer(None, WEIGHT, "thin"))
    with pytest.raises(ServerTimeout, match="longer solve_timeout"):
        mounted(client, mode="solve", solve_timeout=0.0).step(WEIGHT)


@pytest.mark.parametrize(("mode", "kind"), [("record", "recording"), ("envelope", "envelope")])
def test_wrenches_are_saved_while_the_component_stays_rigid(monkeypatch, mode, kind):
    created = {}

    class Recorder:
        def __init__(self, client, component, kind, block):
            created.update(component=component, kind=kind, block=block, added=[], self=self)

        def add(self, wrench):
            created["added"].append(wrench.tolist())

        def start(self):
            return {"jobs": [1]}

        def close(self):
            created["closed"] = True

    monkeypatch.setattr("wrenchbook.service.client.mount.mount.Recorder", Recorder)
    mount = mounted(client_with(), mode=mode, block=7)
    R, p = mount.step(WEIGHT)
    assert np.array_equal(R, TURNED)
    assert np.array_equal(p, POINT)
    assert (created["kind"], created["block"], created["added"]) == (kind, 7, [WEIGHT.tolist()])
    assert mount.start() == {"jobs": [1]}
    mount.close()
    assert created["closed"]
    with pytest.raises(ValueError, match="does not move the component"):
        mount.settle(lambda R, p: WEIGHT)


MASKED = np.ma.masked_greater([1.0, 2.0, 900.0, 0.0, 0.0, 0.0], 100.0)
OPTIONS = [
    *(
        ({"mode": mode}, "needs a Client as source, not LinearTable")
        for mode in ("solve", "record")
    ),
    ({"mode": "envelope"}, "needs a Client as source, not LinearTable"),
    ({"mode": "tabel"}, "mode must be one of table, solve, record, envelope"),
    ({"relaxation": "aitkin"}, "relaxation must be one of aitken, newton, off"),
    ({"relaxation": None}, "relaxation must be one of aitken, newton, off, or a factor above 0"),
    ({"relaxation": 0.0}, "above 0 and at most 1"),
    ({"relaxation": 1.5}, "above 0 and at most 1"),
    ({"on_thin": "ask"}, "on_thin must be one of"),
    ({"unmeasured": 0}, "unmeasured must be one of"),
    ({"mode": np.zeros(3)}, r"mode must be one of .*, not array\(\[0., 0., 0.\]\)"),
    ({"stiffness": np.eye(3)}, r"shape \(6, 6\)"),
    ({"tolerance": (0.0, 1.0)}, "tolerance: translation must be finite and above 0 m"),
    ({"natural_frequency": 27.0}, "belong together; give both"),
    ({"source": linear_table(), "method": "krigging"}, "krigging"),
]
CALLS = [
    (lambda on: Mount(LinearTable(), "bar", np.eye(3), POINT), "pass the table of 'bar'"),
    (
        lambda on: Mount(LinearTable(), "plate", "x", POINT),
        "R0 must be numbers of shape .* not 'x'",
    ),
    (lambda on: on.place(np.eye(4), POINT), "shape"),
    (lambda on: on.place(2 * np.eye(3), POINT), "rotation"),
    (lambda on: on.place(np.diag([1.0, 1.0, -1.0]), POINT), "right-handed"),
    (lambda on: on.place(np.full((3, 3), np.nan), POINT), "finite"),
    (lambda on: on.settle(lambda R, p: WEIGHT, most=0), "most at least 1"),
    (lambda on: on.settle(lambda R, p: WEIGHT, accuracy=0.0), "must be above 0"),
    (lambda on: on.wrench_of([0, 0, 1, 2], [0, 0, 0], [0, 0, 1]), "force must be three numbers"),
    (lambda on: on.step(MASKED), "masked"),
    (lambda on: on.step(MASKED[:3], MASKED[3:]), "masked"),
    (lambda on: mounted(relaxation="newton").step(WEIGHT), "with stiffness="),
]


@pytest.mark.parametrize(("options", "words"), OPTIONS)
def test_a_slip_in_an_option_is_named(options, words):
    with pytest.raises((ValueError, TypeError), match=words):
        mounted(**options)


@pytest.mark.parametrize(("call", "words"), CALLS)
def test_what_is_no_pose_load_or_number_is_refused_and_the_mount_stays(call, words):
    mount = mounted()
    with pytest.raises(ValueError, match=words):
        call(mount)
    assert np.array_equal(mount.undeformed[0], TURNED)
    assert mount.coverage.answers == 0


def test_rounding_at_a_resting_load_does_not_slow_what_follows():
    ups = [1e-3 + (-1) ** step * 1e-17 for step in range(40)]
    scripted = [answer(np.full(6, item)) for item in (*ups, 2e-3)]
    mount = mounted(ScriptedTable(*scripted))
    for _ in scripted:
        mount.step(WEIGHT)
    assert np.allclose(mount.displacement, 2e-3, rtol=1e-12)


def test_a_load_between_a_row_and_its_neighbourhood_does_not_slow_what_follows():
    row, beside = 1e-3, 1e-3 + 4e-4 * 1e-6  # m: 4e-4 of the tolerance beside the row
    scripted = [answer(np.full(6, item)) for item in (*[row, beside] * 10, 2e-3)]
    mount = mounted(ScriptedTable(*scripted), tolerance=(1e-6, 1e-6))
    for _ in scripted:
        mount.step(WEIGHT)
    assert np.allclose(mount.displacement, 2e-3, rtol=1e-12)


def test_a_sign_turned_round_is_told_from_a_sensor_that_reads_nothing():
    require_weight([0, 0, -98.1], 10.0)
    require_weight(TURNED.T @ [0, 0, -98.1], 10.0, axes=TURNED)
    require_weight([0, 0, 0], 10.0, gravity=[0, 0, 0])
    with pytest.raises(SensorError, match="wrench has the opposite sign"):
        require_weight([0, 0, 98.1], 10.0)
    with pytest.raises(SensorError, match="free joint reads 0"):
        require_weight([0, 0, 0.0], 10.0)
    with pytest.raises(SensorError, match="contradicts the scene's weight"):
        require_weight([0, 0, -9810.0], 10.0)
    with pytest.raises(SensorError):
        require_weight([0, 0, np.nan], 10.0)


def test_the_callers_own_array_may_be_written_to_again():
    mount, buffer = mounted(), WEIGHT.copy()
    mount.step(buffer)
    buffer[:] = 0.0
    assert mount.last is not None
    assert mount.last.wrench.tolist() == WEIGHT.tolist()


def test_a_restart_forgets_what_was():
    mount = mounted()
    mount.step(WEIGHT)
    mount.restart()
    assert mount.coverage.answers == 0
    assert mount.last is None
    assert np.array_equal(mount.pose[1], POINT)


def ramped(frequency=27.0, **options):
    """A mount on a server that tells the first natural frequency, if there is one."""
    vibration = frequency and {"first_frequency": frequency}
    facts = {"has_fea": True, "tolerance": TOLERANCE, "vibration": vibration}
    compliance = {"matrix": bar_compliance().tolist()}
    source = client_with(component=lambda _: facts, compliance=lambda _: compliance)
    return mounted(source, **options)


def test_a_mass_on_a_weightless_bar_swings_as_in_closed_form():
    compliance, mass = bar_compliance(), np.diag([7.0, 7.0, 7.0, 0.0, 0.0, 0.0])
    expected = 1 / (2 * np.pi * np.sqrt(7.0 * compliance[2, 2]))
    assert first_frequency(None, compliance, mass) == pytest.approx(expected, rel=1e-12)


SHORT = "2.7 periods of its first natural frequency, 27 Hz"


@pytest.mark.parametrize(
    ("make", "options", "words"),
    [
        (mounted, {"natural_frequency": 27.0, "ramp_time": 0.1}, SHORT),
        (mounted, {"natural_frequency": 27.0, "ramp_time": 0.3}, None),
        (ramped, {"ramp_time": 0.1}, SHORT),
        (ramped, {"ramp_time": 0.3}, None),
        (ramped, {"ramp_time": 0.3, "carried": 10.0}, "rings"),
        (ramped, {"frequency": None, "ramp_time": 0.1}, "no density"),
    ],
)
def test_loads_that_build_up_within_eight_periods_are_warned_of(make, options, words):
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        make(**options)
    assert [words in str(item.message) for item in caught] == ([] if words is None else [True])


@pytest.mark.parametrize("periods", [0.7, 2.5, 6.0, 7.5])
def test_an_undamped_oscillator_vibrates_by_no_more_than_the_warning_says(periods):
    """Displacement over that at rest, of an oscillator of 1 Hz after a linear rise in `periods`."""
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        mounted(natural_frequency=1.0, ramp_time=periods)
    share = float(re.search(r"up to (\S+) %", str(caught[0].message))[1]) / 100.0

    def motion(t, state):
        return [state[1], (2 * np.pi) ** 2 * (min(t / periods, 1.0) - state[0])]

    ends = [0.0, periods, periods + 1.0]
    state = np.zeros(2)
    for start, end in itertools.pairwise(ends):  # a kink at the end of the rise
        span = np.linspace(start, end, 2001)
        solved = solve_ivp(motion, (start, end), state, t_eval=span, rtol=1e-9, atol=1e-12)
        state = solved.y[:, -1]
    amplitude = np.abs(solved.y[0] - 1.0).max()
    if periods % 1.0 == 0.5:  # where the bound is reached
        assert f"up to {100.0 * amplitude:.2g} %" in str(caught[0].message)
    else:
        assert amplitude < share
