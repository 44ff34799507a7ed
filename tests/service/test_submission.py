"""Placing wrenches as jobs, by several threads and processes at once."""

from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest

from tests.service.ledger_rows import claim
from wrenchbook.service.ledger import Ledger
from wrenchbook.service.library.library import Library
from wrenchbook.service.query import without_parts
from wrenchbook.service.submission import GRAINS, Submission, spread

NAME = "plate_thin"


@pytest.fixture
def opened(tmp_path):
    """Open the same data directory twice, as two processes would."""
    ledgers = [Ledger(tmp_path / "ledger.sqlite") for _ in range(2)]
    library = Library(tmp_path / "components")
    yield [Submission(ledger, library, queue_limit=10) for ledger in ledgers]
    for ledger in ledgers:
        ledger.close()


def wrenches(submission, count, seed):
    scale = submission.solvable(NAME).load_range.scale
    return scale * np.random.default_rng(seed).uniform(-1, 1, (count, 6))


def test_the_limit_holds_when_many_threads_of_two_processes_queue_at_once(opened):
    def ask(turn):
        submission = opened[turn % 2]
        return [
            submission.queue(NAME, wrench[None])[0] for wrench in wrenches(submission, 20, turn)
        ]

    with ThreadPoolExecutor(8) as pool:
        placed = [result for results in pool.map(ask, range(8)) for result in results]
    assert len(opened[0].pending_wrenches(NAME)) == 10
    assert {item.job.id for item in placed if item.job} == set(range(1, 11))
    assert any(item.job is None for item in placed)


def test_wrenches_that_round_to_the_same_are_one_job_and_its_own(opened):
    submission = opened[0]
    scale = submission.solvable(NAME).load_range.scale
    wrench = 0.25 * scale
    first, second = submission.queue(NAME, np.array([wrench, wrench + 0.4 / GRAINS * scale]))
    assert first.exact
    assert second.exact
    assert first.job == second.job


def test_a_decimal_wrench_is_solved_as_it_was_written(opened):
    wrench = (123.457, -0.003, 1999.998, 33.3333, -0.0001, 7.1)
    job = opened[0].queue(NAME, np.array([wrench]))[0].job
    assert job.wrench == wrench


def test_a_done_job_is_found_again_even_at_the_limit(opened):
    submission, ledger = opened[0], opened[0]._ledger
    wrench = wrenches(submission, 1, 7)
    job = submission.queue(NAME, wrench)[0].job
    claimed = claim(ledger, "test")
    assert claimed.id == job.id
    ledger.commit(job.id, claimed.attempt, [0.0] * 6)
    submission.queue(NAME, wrenches(submission, 50, 8))
    placed = submission.queue(NAME, wrench)[0]
    assert (placed.job.id, placed.job.status, placed.exact) == (job.id, "done", True)


@pytest.mark.parametrize("withdrawn", [False, True])
def test_a_cancelled_job_or_one_of_a_withdrawn_row_is_not_joined_but_asked_for_anew(
    opened, withdrawn
):
    submission, ledger = opened[0], opened[0]._ledger
    wrench = wrenches(submission, 1, 9)
    job = submission.queue(NAME, wrench)[0].job
    if withdrawn:
        row = ledger.commit(job.id, claim(ledger, "test").attempt, [0.0] * 6)
        ledger.withdraw(NAME, row.seq)
    else:
        ledger.cancel(job.id)
    again = submission.queue(NAME, wrench)[0].job
    assert (again.id, again.status, again.asked_by) == (job.id, "waiting", "query")


@pytest.mark.parametrize("reach", [0.0, 0.05, 0.4])
@pytest.mark.parametrize("count", [1, 300, 3000])
def test_picked_points_are_apart_and_near_every_point(reach, count):
    points = np.random.default_rng(count).uniform(-1, 1, (count, 6))
    points[count // 2 :] = 0.01 * points[count // 2 :]
    picked = spread(points, reach, count)
    apart = np.abs(points[picked][:, None] - points[picked]).max(axis=2)
    assert (apart + np.eye(len(picked)) > reach).all()
    nearest = np.abs(points[:, None] - points[picked[:500]]).max(axis=2).min(axis=1)
    if len(picked) <= 500:
        assert (nearest <= reach).all()
    assert spread(points, reach, 5) == picked[:5]


def test_a_loop_on_a_linear_component_queues_one_solve_not_sixty_four(opened):
    submission = opened[0]
    span = submission.solvable("bar").load_range.scale
    some = span * np.random.default_rng(3).uniform(-1, 1, (40, 6))
    placed = [
        *submission.queue("bar", some[:20]),
        *(submission.queue("bar", item[None])[0] for item in some),
    ]
    assert {item.job.id for item in placed} == {1}
    assert [item.exact for item in placed[:20]] == [True] + 19 * [False]


def test_a_load_beyond_the_range_is_stated_once():
    beyond = (
        "fx = 2 N is outside the load range, -1..1 N; fz = 3 N is outside the load range, 0..1 N"
    )
    reason = f"{beyond}; 1 new row is being built; the table answers from them soon"
    rest = "1 new row is being built; the table answers from them soon"
    assert without_parts(reason, beyond) == rest
    assert without_parts(reason, "") == reason
    assert without_parts(beyond, beyond) == ""
