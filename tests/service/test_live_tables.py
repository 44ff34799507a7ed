"""Tables that are built beside each other and beside the answers."""

import threading
import time

import pytest

from tests.service.ledger_rows import NewRow, insert
from wrenchbook.service.ledger import Ledger
from wrenchbook.service.library.library import Library
from wrenchbook.service.tables import builders, live
from wrenchbook.service.tables.builders import Builders
from wrenchbook.service.tables.live import Tables
from wrenchbook.service.tables.served import TableBehindError

RANGE = [[-10.0, 10.0]] * 3


def new_rows(count, first=0):
    return [
        NewRow((i % 10, 0, 0, 0, 0, i // 10), (i * 1e-6, 0, 0, 0, 0, 1e-7))
        for i in range(first, first + count)
    ]


@pytest.fixture
def open_tables(tmp_path):
    opened = []

    def start(rows, *, before=lambda tables: None):
        ledger = Ledger(tmp_path / "ledger.sqlite")
        library = Library(tmp_path / "components", tmp_path / "none")
        for name, count in rows.items():
            if name not in library.names():
                library.add_table_only(
                    name=name, title=name, range={"force": RANGE, "moment": RANGE}
                )
            insert(ledger, name, "", new_rows(count))
        tables = Tables(ledger, library, tmp_path / "tables")
        before(tables)
        tables.start()
        opened.append((tables, ledger))
        return tables, ledger

    yield start
    for tables, ledger in opened:
        tables.stop()
        ledger.close()


@pytest.fixture
def slow_build(monkeypatch):
    """Hold the builds of the table `big` back until the event is set."""
    may_build, build = threading.Event(), live.make
    built = []

    def held(component, *rest):
        if component.name == "big":
            assert may_build.wait(30)
        built.append(component.name)
        return build(component, *rest)

    monkeypatch.setattr(live, "make", held)
    monkeypatch.setattr(builders, "LARGE", 50)
    monkeypatch.setattr(live, "LARGE", 50)
    yield may_build, built
    may_build.set()


def test_small_tables_answer_before_a_large_one_is_built_at_the_start(open_tables, slow_build):
    may_build, _ = slow_build
    small = {f"small{number}": 3 for number in range(5)}
    tables, _ = open_tables({"big": 60, **small})
    for name in small:
        assert len(tables.surrogate(name).rows) == 3
    assert tables.building() == ["big"]
    with pytest.raises(TableBehindError, match="cannot answer yet"):
        tables.surrogate("big")
    may_build.set()
    assert tables.catch_up("big", 20)
    assert (len(tables.surrogate("big").rows), tables.building()) == (60, [])


def test_a_row_of_one_table_does_not_wait_for_the_build_of_another(open_tables, slow_build):
    """A row of another component showed after 29.8 s."""
    may_build, _ = slow_build
    may_build.set()
    tables, ledger = open_tables({"big": 60, "small": 3})
    assert tables.catch_up("big", 20)
    may_build.clear()
    insert(ledger, "big", "", new_rows(1, first=60))
    insert(ledger, "small", "", new_rows(1, first=3))
    assert tables.catch_up("small", 5)
    assert len(tables.surrogate("big").rows) == 60
    may_build.set()
    assert tables.catch_up("big", 20)
    assert len(tables.surrogate("big").rows) == 61


def test_rows_that_come_during_a_build_are_built_together_after_it(open_tables, slow_build):
    may_build, built = slow_build
    may_build.set()
    tables, ledger = open_tables({"big": 60})
    assert tables.catch_up("big", 20)
    may_build.clear()
    before = len(built)
    for number in range(20):
        insert(ledger, "big", "", new_rows(1, first=60 + number))
        time.sleep(0.03)
    may_build.set()
    assert tables.catch_up("big", 20)
    assert len(tables.surrogate("big").rows) == 80
    assert len(built) - before <= 3


def test_two_large_tables_are_built_one_after_the_other_and_small_ones_beside_them():
    running, most, done = [], [], threading.Semaphore(0)
    may_end = threading.Event()

    def bring_up(name):
        running.append(name)
        most.append(sorted(running))
        if name.startswith("large"):
            may_end.wait(20)
        running.remove(name)
        done.release()

    lanes = Builders(bring_up)
    for name in ("large1", "large2"):
        lanes.ask(name, builders.LARGE + 1)
    lanes.start()
    for number in range(4):
        lanes.ask(f"small{number}", 10)
    for _ in range(4):
        assert done.acquire(timeout=10)
    assert lanes.busy() == ["large1", "large2"]
    may_end.set()
    assert done.acquire(timeout=10)
    assert done.acquire(timeout=10)
    lanes.stop()
    assert not any({"large1", "large2"} <= set(names) for names in most)
