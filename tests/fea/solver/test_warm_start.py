"""Starting from the state of a nearby solve: the same answer, whatever the start."""

from dataclasses import replace

import numpy as np
import pytest

from tests.fea.solver.test_nonlinear import PLATE_WRENCH, plate
from tests.fea.test_failures import arch
from wrenchbook.fea.bundle.read import read_bundle
from wrenchbook.fea.component import build
from wrenchbook.fea.failure import SolveFailed
from wrenchbook.fea.solve import Solver, solve
from wrenchbook.fea.solver.arc_length import ArcPath
from wrenchbook.fea.solver.newton import Equilibrium, find_equilibrium
from wrenchbook.fea.solver.warm_start import MOST_FILES, WarmFolder

SCALE = np.array([300.0, 150, 25, 2, 4, 3])


@pytest.mark.parametrize("coupling", ["rigid", "distributed"])
def test_a_start_changes_no_digit_that_counts(coupling):
    built = Solver(plate(coupling))
    near = built.solve(0.9 * PLATE_WRENCH)
    cold = built.solve(PLATE_WRENCH)
    warm = built.solve(PLATE_WRENCH, start=near.state)
    np.testing.assert_allclose(warm.displacement, cold.displacement, rtol=1e-6, atol=1e-10)
    np.testing.assert_allclose(warm.compliance, cold.compliance, rtol=1e-5, atol=1e-12)
    assert warm.strain_energy == pytest.approx(cold.strain_energy, rel=1e-6)
    assert len(warm.history) <= len(cold.history)


def test_a_chain_of_starts_ends_where_one_solve_does():
    built = Solver(plate())
    state = None
    turned = PLATE_WRENCH * np.array([1, -1, 0.5, 1, -1, 1])
    for share in (0.3, 0.6, 0.8, 1.0):
        wrench = share * PLATE_WRENCH + (1 - share) * turned
        found = built.solve(wrench, start=state)
        state = found.state
    cold = built.solve(PLATE_WRENCH)
    np.testing.assert_allclose(found.displacement, cold.displacement, rtol=1e-6, atol=1e-10)


@pytest.fixture(scope="module")
def snapped():
    """An arch that only sinks, and its stable state under 4000 N with the crown snapped through."""
    built = Solver(arch(locked=("ux", "uy", "rx", "ry", "rz")))
    system, down = built._system, np.array([0, 0, -1.0, 0, 0, 0])
    rest = Equilibrium(system.balance_at_rest, system.undeformed, 0)
    path = ArcPath(system, down, 4e4, 0.0, rest, 1 / 64, lambda _: lambda *_: None)
    sign, sunk = 1.0, 0.0
    while sunk > -0.065:  # the arc as it is, but past the limit with less load
        point = path._point
        ahead = sign * path._length / point.speed
        normal = path._field(point) / point.speed
        rate = (ahead * part for part in point.rate)
        found = path._correct(*rate, point.size + ahead, normal)
        if found is None:
            path._length *= 0.5
            continue
        path._point, before = path._point_at(*found), point
        moved = path._point.found.balance.state.nodes - before.found.balance.state.nodes
        sign = np.sign(np.vdot(path._field(path._point), moved))
        sunk = path._point.found.balance.state.interface[2]
        path._length *= 1.4 if path._point.found.iterations < 6 else 1.0
    far = path._point.found
    far = find_equilibrium(
        system, system.reload(far.balance, 4000 * down), far.tangent, lambda *_: None
    )
    assert far.tangent.stable
    assert far.balance.state.interface[2] < -0.06
    return built, far.balance.state


def test_a_start_on_a_far_branch_does_not_lead_there(snapped):
    built, state = snapped
    wrench = [0, 0, -4000, 0, 0, 0]
    cold = built.solve(wrench)
    warm = built.solve(wrench, start=state)
    assert cold.displacement[2] == pytest.approx(-7.75e-3, rel=1e-2)
    np.testing.assert_allclose(warm.displacement, cold.displacement, rtol=1e-6, atol=1e-9)


def test_past_the_limit_a_start_on_the_far_branch_is_no_excuse(snapped):
    built, state = snapped
    with pytest.raises(SolveFailed, match=r"snaps through at 0\.8") as caught:
        built.solve([0, 0, -5000, 0, 0, 0], start=state)
    assert caught.value.kind == "snap_through"


@pytest.fixture(scope="module")
def solved():
    built = Solver(plate())
    return [built.solve(share * PLATE_WRENCH) for share in (0.5, 0.9)]


def test_the_nearest_state_is_found_and_none_that_is_far(tmp_path, solved):
    folder = WarmFolder(tmp_path / "warm", "f00d", SCALE)
    points = len(solved[0].nodes)
    assert folder.nearest(PLATE_WRENCH, points) is None
    for solution in solved:
        folder.keep(solution)
    near = folder.nearest(PLATE_WRENCH, points)
    np.testing.assert_array_equal(near.nodes, solved[1].state.nodes)
    np.testing.assert_array_equal(
        folder.nearest(0.55 * PLATE_WRENCH, points).interface, solved[0].state.interface
    )
    assert folder.nearest(-PLATE_WRENCH, points) is None
    assert folder.nearest(PLATE_WRENCH, points + 1) is None
    assert WarmFolder(tmp_path / "warm", "beef", SCALE).nearest(PLATE_WRENCH, points) is None


@pytest.mark.parametrize("damage", ["empty", "cut", "noise", "nan"])
def test_a_damaged_file_is_passed_over(tmp_path, solved, damage):
    folder = WarmFolder(tmp_path, "f00d", SCALE)
    for solution in solved:
        folder.keep(solution)
    path = folder._files()[0]
    whole = path.read_bytes()
    if damage == "nan":
        spoilt = replace(solved[1].state, nodes=np.full_like(solved[1].nodes, np.nan))
        folder.keep(replace(solved[1], state=spoilt))
    else:
        path.write_bytes({"empty": b"", "cut": whole[:5000], "noise": b"x" * 5000}[damage])
    near = folder.nearest(0.8 * PLATE_WRENCH, len(solved[0].nodes))
    np.testing.assert_array_equal(near.nodes, solved[0].state.nodes)


def test_only_the_newest_states_are_kept(tmp_path, solved):
    folder = WarmFolder(tmp_path, "f00d", SCALE)
    for number in range(MOST_FILES + 3):
        folder.keep(replace(solved[0], wrench=PLATE_WRENCH + number))
    assert len(list(tmp_path.iterdir())) == MOST_FILES


def test_a_bundle_solved_with_a_warm_folder_keeps_and_uses_states(tmp_path):
    bundle = read_bundle("data/components/spring")
    assert build(bundle).analysis.nonlinear
    first = solve(bundle, [0, 0, 1.0, 0, 0, 0], warm=tmp_path)
    assert [path.name[:16] for path in tmp_path.iterdir()] == [bundle.fingerprint]
    again = solve(bundle, [0, 0, 1.05, 0, 0, 0], warm=tmp_path)
    cold = solve(bundle, [0, 0, 1.05, 0, 0, 0])
    assert len(again.history) < len(cold.history)
    np.testing.assert_allclose(again.displacement, cold.displacement, rtol=1e-6, atol=1e-10)
    assert again.displacement[2] > first.displacement[2]
