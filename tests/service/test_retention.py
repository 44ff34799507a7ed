"""Nothing grows without bound, and nothing that is needed goes."""

import threading
import time

from wrenchbook.service.ledger import Ledger
from wrenchbook.service.settings import Settings
from wrenchbook.service.workers.builder import DAY, prune, shorten_log

NONE = Settings(keep_days=0, keep_count=0, keep_failed_days=0, keep_failed_count=0)


def end_job(ledger, number, *, good=True):
    ledger.accept("rig", "f", [float(number)] * 6)
    job = ledger.claim("me")
    folder = ledger.path.parent / "jobs" / str(job.id) / str(job.attempt)
    folder.mkdir(parents=True)
    (folder / "result.json").write_text("{}")
    if good:
        ledger.commit(job.id, job.attempt, [number * 1e-6] * 6)
    else:
        error = {"kind": "k", "message": "m", "remedy": "r"}
        ledger.fail(job.id, job.attempt, error)
    return job.id


def pruned(ledger, settings, *, stopping=False):
    stop = threading.Event()
    if stopping:
        stop.set()
    return prune(ledger, ledger.path.parent / "jobs", settings, stop)


def left(ledger):
    return sorted(int(one.name) for one in (ledger.path.parent / "jobs").iterdir())


def test_the_newest_folders_are_kept_and_failed_ones_longer(ledger):
    done = [end_job(ledger, n) for n in range(6)]
    failed = [end_job(ledger, 10 + n, good=False) for n in range(3)]
    assert pruned(ledger, Settings(keep_count=2, keep_failed_count=2)) == 5
    assert left(ledger) == sorted([*done[-2:], *failed[-2:]])
    assert ledger.counts() | {"done": 6, "failed": 3} == ledger.counts()


def test_folders_are_removed_by_age_and_a_clock_set_back_removes_none(ledger, monkeypatch):
    jobs = [end_job(ledger, n) for n in range(3)]
    now = time.time()
    monkeypatch.setattr(time, "time", lambda: now - 1000 * DAY)
    assert pruned(ledger, Settings()) == 0
    monkeypatch.setattr(time, "time", lambda: now + 29 * DAY)
    assert pruned(ledger, Settings()) == 0
    monkeypatch.setattr(time, "time", lambda: now + 31 * DAY)
    assert pruned(ledger, Settings()) == len(jobs)


def test_what_waits_runs_or_is_unknown_is_left_alone(ledger):
    folder = ledger.path.parent / "jobs"
    reopened = end_job(ledger, 1, good=False)
    ledger.retry(reopened)
    (folder / "owners").mkdir()
    (folder / "4711" / "1").mkdir(parents=True)
    assert pruned(ledger, NONE) == 0
    assert {one.name for one in folder.iterdir()} == {str(reopened), "owners", "4711"}


def test_pruning_ends_when_it_is_told_to(ledger):
    end_job(ledger, 1)
    assert pruned(ledger, NONE, stopping=True) == 0


def test_a_long_log_is_brought_in_and_emptied(ledger):
    ledger.accept_many("rig", "f", [[float(n)] * 6 for n in range(2000)])
    assert ledger.sizes()["log"] > 0
    assert shorten_log(ledger, longest=0)
    assert ledger.sizes()["log"] == 0
    assert ledger.counts()["waiting"] == 2000


def test_a_log_that_somebody_reads_is_left_before_the_reading_ends(ledger):
    ledger.accept("rig", "f", [1.0] * 6)
    with ledger.reading() as db:
        db.execute("SELECT count(*) FROM jobs").fetchone()
        ledger.accept("rig", "f", [2.0] * 6)
        assert not shorten_log(ledger, longest=0)
    assert ledger.accept("rig", "f", [3.0] * 6)[1]


def test_acknowledged_jobs_that_a_cut_log_has_lost_are_told_and_never_renumbered(tmp_path):
    """Half of the log cut off: SQLite opens it without a word."""
    path, log = tmp_path / "l.sqlite", tmp_path / "l.sqlite-wal"
    ledger = Ledger(path)
    for number in range(20):
        ledger.accept("rig", "f", [float(number)] * 6)
    whole, content = path.read_bytes(), log.read_bytes()
    ledger.close()
    path.write_bytes(whole)
    log.write_bytes(content[: len(content) // 2])
    again = Ledger(path)
    kept = again.counts()["waiting"]
    assert 0 < kept < 20
    (said,) = again.losses()
    assert f"jobs {kept + 1} to 20 were acknowledged" in said
    assert again.accept("rig", "f", [99.0] * 6)[0].id == 21
    again.close()
    third = Ledger(path)
    assert len(third.losses()) == 1  # told until somebody settles it, and once
    third.close()


def test_a_note_that_is_damaged_missing_or_unwritable_is_no_loss(tmp_path):
    ledger = Ledger(tmp_path / "l.sqlite")
    ledger.accept("rig", "f", [1.0] * 6)
    ledger.close()
    note = tmp_path / "l.sqlite-acknowledged"
    for content in (b"", b"99 99\n12345678", b"\xff" * 40):
        note.write_bytes(content)
        ledger = Ledger(tmp_path / "l.sqlite")
        assert ledger.losses() == []
        ledger.close()
    note.unlink()
    note.mkdir()
    ledger = Ledger(tmp_path / "l.sqlite")
    assert ledger.accept("rig", "f", [2.0] * 6)[1]
    ledger.close()
