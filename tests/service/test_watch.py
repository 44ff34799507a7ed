"""The watcher: commits of this and of another process, files watched along, listeners that fail."""

import threading

import pytest

from tests.until import until
from wrenchbook.service import workspace
from wrenchbook.service.ledger import Ledger, LedgerUnavailableError
from wrenchbook.service.workspace import Watcher

WRENCH = (1.0, 0, 0, 0, 0, 0)


@pytest.fixture
def watcher(ledger):
    watching = Watcher(ledger)
    watching.start()
    yield watching
    watching.stop()


def test_a_commit_of_this_and_of_another_process_is_noticed_within_a_moment(
    ledger, watcher, tmp_path
):
    noticed = threading.Event()
    watcher.on_change(noticed.set)
    ledger.accept("bar", "f", WRENCH)
    assert noticed.wait(60)
    noticed.clear()
    other = Ledger(tmp_path / "ledger.sqlite")
    other.claim("another")
    assert noticed.wait(60)
    other.close()


def test_nothing_is_noticed_without_a_commit(ledger, watcher):
    calls = []
    watcher.on_change(lambda: calls.append(1))
    ledger.jobs()
    looks = []
    watcher.on_change(lambda: None, lambda: looks.append(1))
    until(lambda: len(looks) > 5)
    assert not calls


def test_a_file_is_watched_along_until_its_subscription_ends(watcher, tmp_path):
    file = tmp_path / "note"
    noticed = threading.Event()
    end = watcher.on_change(noticed.set, file.exists)
    file.touch()
    assert noticed.wait(60)
    end()
    noticed.clear()
    file.unlink()
    looks = []
    watcher.on_change(lambda: None, lambda: looks.append(1))
    until(lambda: len(looks) > 5)
    assert not noticed.is_set()


def test_a_listener_that_fails_is_called_again_and_keeps_no_other_from_it(
    ledger, watcher, monkeypatch
):
    monkeypatch.setattr(workspace, "TROUBLE_S", 0.05)
    calls, noticed = [], threading.Event()

    def fails():
        calls.append(1)
        if len(calls) < 3:
            raise RuntimeError("no memory")

    watcher.on_change(fails)
    watcher.on_change(noticed.set)
    ledger.accept("bar", "f", WRENCH)
    assert noticed.wait(60)
    until(lambda: len(calls) == 3)


def test_a_ledger_that_cannot_be_read_and_then_can_is_noticed(ledger, watcher, monkeypatch):
    def unreadable():
        raise LedgerUnavailableError("the disk is gone")

    noticed = threading.Event()
    watcher.on_change(noticed.set)
    with monkeypatch.context() as broken:
        broken.setattr(ledger, "version", unreadable)
        assert noticed.wait(60)
        noticed.clear()
    assert noticed.wait(60)
