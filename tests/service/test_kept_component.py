"""What a solver keeps of a component gives the same rows, and only ever that component's."""

import json
from dataclasses import replace

import numpy as np
import pytest

from tests.fea.decks import SOFT
from tests.fea.decks import component as deck_component
from tests.service.attempts import asked
from tests.service.test_engine_local import write_table
from tests.service.test_runjob_evidence import BUNDLE
from tests.service.test_warm_solver import until
from wrenchbook.fea import component
from wrenchbook.fea.bundle.read import read_bundle
from wrenchbook.fea.bundle.shipped import SHIPPED
from wrenchbook.service.fields.record import GEOMETRY, ROW
from wrenchbook.service.jobs import solver
from wrenchbook.service.jobs.attempt import Attempt, prepare, read_attempt, read_outcome
from wrenchbook.service.jobs.solver_pool import LocalEngine

LOAD = np.array([2e3, 1e3, 1e3, 50.0, 50.0, 50.0])


class Site:
    """Bundles, attempts on them, and engines that are closed at the end."""

    def __init__(self, folder):
        self.folder = folder
        self.engines = []
        self.attempts = 0

    def block(self, name="block", **changes):
        options = {"height": 0.1, "across": 2, "poisson": 0.3, **changes}
        bundle = self.folder / name
        bundle.mkdir(exist_ok=True)
        (bundle / "component.toml").write_text(BUNDLE.format(**options), encoding="utf-8")
        return bundle

    def engine(self, **options):
        self.engines.append(LocalEngine(1, **options))
        return self.engines[-1]

    def solved(self, engine, bundle, wrench, fingerprint=None):
        """Solve one wrench; the whole outcome but how long it took, and the solver's pid."""
        self.attempts += 1
        folder = self.folder / "jobs" / str(self.attempts)
        wanted = fingerprint or read_bundle(bundle).fingerprint
        spec = Attempt(self.attempts, 1, "block", str(bundle), wanted, tuple(map(float, wrench)))
        prepare(replace(spec, folder=folder))
        engine.submit(asked(folder))
        until(lambda: engine.poll(asked(folder)) == "finished")
        outcome = read_outcome(read_attempt(folder))
        outcome.further.pop("seconds", None)
        if outcome.status == "done":  # its surface and stresses too
            for name in (GEOMETRY, ROW):
                left = folder / name
                outcome.further[name] = left.read_bytes().hex() if left.exists() else None
        return outcome, (folder / "lock").read_text()


@pytest.fixture
def site(tmp_path, monkeypatch):
    monkeypatch.delenv("WRENCHBOOK_SOLVE", raising=False)
    site = Site(tmp_path)
    yield site
    for engine in site.engines:
        engine.close()


def wrenches(count):
    chance = np.random.default_rng(7)
    return LOAD * chance.uniform(-1, 1, (count, 6)) * (chance.random((count, 6)) < 0.7)


@pytest.mark.parametrize("name", ["block", "bar", "plate_thin"])
def test_a_solver_that_lives_gives_the_rows_of_fresh_ones_to_the_last_bit(site, name):
    """In another order too: nothing an earlier attempt did shows in a later one."""
    bundle = site.block() if name == "block" else SHIPPED / name
    loads = wrenches(4)
    if name != "block":
        limits = read_bundle(bundle).range
        loads = loads / LOAD * 0.3 * np.maximum(np.abs(limits.low), np.abs(limits.high))
    fresh = [site.solved(site.engine(max_attempts=1), bundle, wrench) for wrench in loads]
    warm = site.engine()
    kept = [site.solved(warm, bundle, loads[place]) for place in (2, 0, 3, 1)]
    assert len({pid for _, pid in fresh}) == 4
    assert len({pid for _, pid in kept}) == 1
    for place, (outcome, _) in zip((2, 0, 3, 1), kept, strict=True):
        assert outcome.status == "done"
        assert outcome.further[ROW]
        assert json.dumps(vars(outcome)) == json.dumps(vars(fresh[place][0]))


def test_after_a_solve_that_failed_the_next_row_is_that_of_a_fresh_process(site):
    bundle, wrench = site.block(), wrenches(1)[0]
    expected, _ = site.solved(site.engine(max_attempts=1), bundle, wrench)
    warm = site.engine()
    failed, first = site.solved(warm, bundle, (-1e6, 0, 0, 0, 0, 0))
    assert failed.error["kind"] == "snap_through"
    outcome, second = site.solved(warm, bundle, wrench)
    assert (outcome, first) == (expected, second)


def test_a_component_edited_between_two_attempts_is_solved_as_it_is_now(site):
    bundle, wrench, warm = site.block(), wrenches(1)[0], site.engine()
    before, pid = site.solved(warm, bundle, wrench)
    old = read_bundle(bundle).fingerprint
    site.block(height=0.11)
    refused, _ = site.solved(warm, bundle, wrench, fingerprint=old)
    assert refused.error["kind"] == "component_changed"
    after, again = site.solved(warm, bundle, wrench)
    expected, _ = site.solved(site.engine(max_attempts=1), bundle, wrench)
    assert (after, pid) == (expected, again)
    assert after.displacement != before.displacement


def test_two_components_in_turn_on_one_solver_each_get_their_own_rows(site):
    thick, thin = site.block(), site.block("thin", height=0.05)
    wrench, warm = wrenches(1)[0] / 10, site.engine()
    expected = [
        site.solved(site.engine(max_attempts=1), bundle, wrench)[0] for bundle in (thick, thin)
    ]
    results = [site.solved(warm, bundle, wrench) for bundle in (thick, thin, thick, thin)]
    assert [outcome for outcome, _ in results] == expected * 2
    assert len({pid for _, pid in results}) == 1


def test_a_solve_beyond_its_memory_fails_by_name_and_the_next_one_has_a_new_solver(
    site, monkeypatch
):
    bundle, wrench, engine = site.block(across=12), wrenches(1)[0], site.engine()
    monkeypatch.setenv("WRENCHBOOK_MEMORY_MARGIN", "0.001")
    refused, first = site.solved(engine, bundle, wrench)
    error = refused.error
    assert error["kind"] == "out_of_memory"
    assert "0.001 times its estimate" in error["message"]
    assert "WRENCHBOOK_MEMORY_MARGIN" in error["remedy"]
    monkeypatch.delenv("WRENCHBOOK_MEMORY_MARGIN")
    done, second = site.solved(engine, bundle, wrench)
    assert (done.status, first != second) == ("done", True)


def test_a_component_is_built_under_its_own_memory_limit_not_that_of_the_one_before(
    site, monkeypatch
):
    limits = []
    monkeypatch.setattr(solver, "limit_memory", limits.append)
    kept = solver.ComponentSolver()
    for name in ("small", "large"):
        bundle, folder = site.block(name), site.folder / "attempts" / name
        folder.mkdir(parents=True)
        spec = Attempt(
            1, 1, name, str(bundle), read_bundle(bundle).fingerprint, tuple(wrenches(1)[0])
        )
        limits.clear()
        kept.solve(replace(spec, folder=folder, memory=7e9), lambda *_: None)
        assert limits[0] == 7e9


def test_a_margin_that_is_no_number_is_refused_by_name(site, monkeypatch):
    monkeypatch.setenv("WRENCHBOOK_MEMORY_MARGIN", "plenty")
    outcome, _ = site.solved(site.engine(), site.block(), wrenches(1)[0])
    assert outcome.error["kind"] == "bad_setting"
    assert "'plenty'" in outcome.error["message"]


def test_decks_are_solved_one_after_the_other_by_one_solver_without_a_memory_limit(site):
    folder = site.folder / "deck"
    folder.mkdir()
    limit = "import resource; print(resource.getrlimit(resource.RLIMIT_AS))\n"
    bundle = deck_component(folder, limit + SOFT)
    write_table(folder, bundle)
    warm, block = site.engine(), site.block()
    site.solved(warm, block, wrenches(1)[0])
    results = [site.solved(warm, folder, LOAD * factor / 1e3) for factor in (0.5, 1.0)]
    assert {outcome.status for outcome, _ in results} == {"done"}
    assert len({pid for _, pid in results}) == 1
    for outcome, factor in zip((one for one, _ in results), (0.5, 1.0), strict=True):
        assert outcome.displacement == pytest.approx((LOAD * factor * 1e-9).tolist())
    printed = next(site.folder.rglob("jobs/3/deck/wrench/printed.txt")).read_text()
    assert "(-1, -1)" in printed


def test_an_edit_while_the_component_is_built_is_refused(tmp_path, monkeypatch):
    """What was hashed is read again to be built: in between it may have become another."""
    site = Site(tmp_path)
    bundle = site.block()
    fingerprint, wrench = read_bundle(bundle).fingerprint, tuple(wrenches(1)[0])
    attempt = Attempt(1, 1, "block", str(bundle), fingerprint, wrench, folder=tmp_path)
    build = component.build

    def edited(read):
        site.block(height=0.2)
        return build(read)

    monkeypatch.setattr(component, "build", edited)
    kept = solver.ComponentSolver()
    with pytest.raises(solver.SolveRefusedError, match="has changed"):
        kept.solve(attempt, lambda *_: None)
    assert kept.ready is None
