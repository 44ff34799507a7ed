"""What every engine promises a dispatcher, tried on each of them."""

import shutil

from tests.until import until
from wrenchbook.service.jobs.attempt import (
    ALIVE,
    OUTCOME,
    EngineError,
    Outcome,
    last_output,
    read_progress,
    solver_began,
    write_outcome,
)


def test_a_submitted_attempt_ends_finished_with_its_answer_which_stays_once_it_is_forgotten(bench):
    engine, attempt = bench.engine(), bench.attempt("quick")
    engine.submit(attempt)
    assert engine.poll(attempt) in (*ALIVE, "finished")
    assert bench.end(engine, attempt) == "finished"
    assert bench.outcome(attempt).displacement == [1e-6, 2e-6, 3e-6, 0, 0, 0]
    engine.forget(attempt)
    assert engine.poll(attempt) == "finished"


def test_an_attempt_that_a_solver_is_at_is_running_and_shows_its_progress(bench):
    engine = bench.engine()
    attempt = bench.started("reports_until_go", engine)
    said = until(lambda: read_progress(attempt.folder))
    assert (said.fraction, said.message) == (0.25, "still going")
    until(lambda: engine.poll(attempt) == "running")
    assert solver_began(attempt.folder)
    bench.go(attempt)
    bench.end(engine, attempt)


def test_a_solve_that_fails_is_finished_with_its_reason_log_and_files(bench):
    engine, attempt = bench.engine(), bench.attempt("leaves_files")
    engine.submit(attempt)
    assert bench.end(engine, attempt) == "finished"
    error = bench.outcome(attempt).error
    assert (error["kind"], error["remedy"]) == ("not_converged", "use smaller load steps")
    assert "NotConvergedError: no equilibrium" in last_output(attempt.folder)
    assert (attempt.folder / "deck" / "part.dat").read_text() == "a number: 7"
    assert (attempt.folder / "failed.vtu").read_bytes() == bytes(range(256))


def test_the_solver_finds_the_files_of_its_component_as_they_are_now(bench):
    engine = bench.engine()
    for text in ("before", "after it"):
        (bench.bundle / "meshes" / "part.msh").write_text(text)
        attempt = bench.attempt("reads_its_bundle")
        engine.submit(attempt)
        bench.end(engine, attempt)
        seen = {"component.toml": 'name = "part"', "part.msh": text}
        assert bench.outcome(attempt).further["seen"] == seen


def test_a_solver_that_dies_is_lost_for_good(bench):
    engine = bench.engine()
    attempt = bench.started("endless", engine)
    bench.kill_solver(attempt)
    assert bench.end(engine, attempt) == "lost"
    assert solver_began(attempt.folder)  # so its death counts
    other = bench.attempt("quick")
    engine.submit(other)
    bench.end(engine, other)
    assert engine.poll(attempt) == "lost"
    assert not (attempt.folder / OUTCOME).exists()


def test_a_cancelled_solver_ends(bench):
    engine = bench.engine()
    attempt = bench.started("endless", engine)
    engine.cancel(attempt)
    engine.cancel(attempt)  # as often as one likes
    bench.end(engine, attempt)
    until(lambda: bench.pid(attempt) is None)
    assert bench.outcome(attempt) == Outcome("cancelled")


def test_a_solver_that_does_not_hear_ends_all_the_same(bench):
    engine = bench.engine()
    attempt = bench.started("deaf", engine)
    until(lambda: any(map(read_progress, bench.solver_folders(attempt))))
    engine.cancel(attempt)
    bench.end(engine, attempt)
    until(lambda: bench.pid(attempt) is None)
    assert bench.outcome(attempt) in (None, Outcome("cancelled"))


def test_an_attempt_cancelled_before_it_begins_ends(bench):
    engine, attempt = bench.engine(), bench.attempt("endless")
    engine.submit(attempt)
    engine.cancel(attempt)
    bench.end(engine, attempt)
    until(lambda: bench.pid(attempt) is None)


def test_a_solver_past_its_deadline_fails_by_that_name(bench):
    engine = bench.engine()
    attempt = bench.started("endless", engine, deadline=0.5)
    assert bench.end(engine, attempt) == "finished"
    assert bench.outcome(attempt).error["kind"] == "deadline"
    assert bench.pid(attempt) is None


def test_an_attempt_handed_in_twice_is_one(bench):
    engine = bench.engine()
    attempt = bench.started("counted_until_go", engine)
    try:
        engine.submit(attempt)
    except EngineError as error:
        assert "already works in" in str(error)  # noqa: PT017
    bench.go(attempt)
    assert bench.end(engine, attempt) == "finished"
    assert bench.starts(attempt) == 1


def test_another_dispatcher_goes_on_with_what_one_that_closed_left(bench):
    engine = bench.engine()
    attempt = bench.started("counted_until_go", engine)
    engine.close()
    assert bench.pid(attempt)
    after = bench.engine()
    after.attach(attempt)
    bench.go(attempt)
    assert bench.end(after, attempt) == "finished"
    assert bench.starts(attempt) == 1


def test_another_dispatcher_goes_on_beside_one_that_hangs(bench):
    first, second = bench.engine(), bench.engine()
    attempt = bench.started("counted_until_go", first)
    second.attach(attempt)
    bench.go(attempt)
    assert bench.end(second, attempt) == "finished"
    assert bench.starts(attempt) == 1
    assert bench.outcome(attempt).displacement == [1e-6, 2e-6, 3e-6, 0, 0, 0]


def test_another_dispatcher_can_cancel_what_it_took_over(bench):
    first, second = bench.engine(), bench.engine()
    attempt = bench.started("endless", first)
    first.forget(attempt)
    second.attach(attempt)
    second.cancel(attempt)
    bench.end(second, attempt)
    until(lambda: bench.pid(attempt) is None)


def test_what_was_cancelled_while_no_dispatcher_lived_ends(bench):
    engine = bench.engine()
    attempt = bench.started("endless", engine)
    engine.close()
    bench.engine().cancel(attempt)
    until(lambda: bench.pid(attempt) is None)


def test_an_attempt_that_ended_while_nobody_looked_is_found_ended(bench):
    engine = bench.engine()
    attempt = bench.started("waits_for_a_word", engine)
    engine.close()
    bench.go(attempt)
    until(lambda: bench.pid(attempt) is None)
    after = bench.engine()
    after.attach(attempt)
    assert bench.end(after, attempt) == "finished"
    assert bench.outcome(attempt).status == "done"


def test_an_outcome_that_is_there_already_is_not_asked_for_again(bench):
    engine, attempt = bench.engine(), bench.attempt("quick")
    write_outcome(attempt, Outcome("done"))
    engine.attach(attempt)
    assert engine.poll(attempt) == "finished"


def test_an_attempt_without_a_folder_is_lost(bench):
    engine, attempt = bench.engine(), bench.attempt("quick")
    shutil.rmtree(attempt.folder)
    engine.attach(attempt)
    assert bench.end(engine, attempt) == "lost"


def test_an_attempt_nobody_handed_in_is_lost(bench):
    engine, attempt = bench.engine(), bench.attempt("quick")
    assert engine.poll(attempt) == "lost"
    engine.cancel(attempt)
    engine.forget(attempt)


def test_what_ends_is_told(bench):
    engine, attempt = bench.engine(), bench.attempt("quick")
    reported = []
    stop = engine.listen(reported.append)
    engine.submit(attempt)
    bench.end(engine, attempt)
    until(lambda: attempt.task in reported)
    stop()
    again = bench.attempt("quick")
    engine.submit(again)
    bench.end(engine, again)
    assert again.task not in reported


def test_many_attempts_at_once_each_have_their_own_end(bench):
    engine = bench.engine()
    ends = {"quick": "finished", "diverges": "finished", "dies": "lost"}
    attempts = [(bench.attempt(solver), end) for _ in range(3) for solver, end in ends.items()]
    for attempt, _ in attempts:
        engine.submit(attempt)
    for attempt, end in attempts:
        assert bench.end(engine, attempt) == end
