"""Tables that are built beside each other and beside the answers."""

import threading

import pytest

from tests.service.ledger_rows import insert, new_rows
from tests.service.test_durable_tables import RANGE, Site
from tests.until import until
from wrenchbook.service.ledger import Ledger
from wrenchbook.service.library.library import Library
from wrenchbook.service.tables import build, store
from wrenchbook.service.tables.mapped import TableBehindError


@pytest.fixture
def open_tables(tmp_path):
    opened = []

    def start(rows):
        ledger, library = Ledger(tmp_path / "ledger.sqlite"), Library(tmp_path / "components")
        for name, count in rows.items():
            library.add_table_only(name=name, title=name, range={"force": RANGE, "moment": RANGE})
            insert(ledger, name, "", new_rows(count))
        ledger.close()
        site = Site(tmp_path)
        site.open()
        opened.append(site)
        return site.tables, site.ledger

    yield start
    for site in opened:
        site.close()


@pytest.fixture
def slow_build(monkeypatch):
    """Hold the builds of tables named `big` back until the event is set."""
    may_build, build_table = threading.Event(), build.build_table
    built = []

    def held(component, *rest):
        built.append((component.name, "starts"))
        if component.name.startswith("big"):
            assert may_build.wait(60)
        built.append((component.name, "ends"))
        return build_table(component, *rest)

    monkeypatch.setattr(build, "build_table", held)
    monkeypatch.setattr(store, "LARGE", 50)
    yield may_build, built
    may_build.set()


def test_small_tables_answer_before_a_large_one_is_built_at_the_start(open_tables, slow_build):
    may_build, _ = slow_build
    small = {f"small{number}": 3 for number in range(5)}
    tables, _ = open_tables({"big": 60, **small})
    for name in small:
        assert len(tables.surrogate(name).rows) == 3
    assert "big" in tables.building()
    with pytest.raises(TableBehindError, match="cannot answer yet"):
        tables.surrogate("big")
    may_build.set()
    assert tables.catch_up("big", 60)
    assert len(tables.surrogate("big").rows) == 60
    assert "big" not in tables.building()


def test_a_row_of_one_table_does_not_wait_for_the_build_of_another(open_tables, slow_build):
    """A row of another component showed after 29.8 s."""
    may_build, _ = slow_build
    may_build.set()
    tables, ledger = open_tables({"big": 60, "small": 3})
    assert tables.catch_up("big", 60)
    may_build.clear()
    insert(ledger, "big", "", new_rows(1, first=60))
    insert(ledger, "small", "", new_rows(1, first=3))
    assert tables.catch_up("small", 60)
    assert len(tables.surrogate("big").rows) == 60
    may_build.set()
    assert tables.catch_up("big", 60)
    assert len(tables.surrogate("big").rows) == 61


def test_rows_that_come_during_a_build_are_built_together_after_it(open_tables, slow_build):
    may_build, built = slow_build
    may_build.set()
    tables, ledger = open_tables({"big": 60})
    assert tables.catch_up("big", 60)
    may_build.clear()
    before = len(built)
    insert(ledger, "big", "", new_rows(1, first=60))
    until(lambda: len(built) > before)
    for number in range(1, 20):
        insert(ledger, "big", "", new_rows(1, first=60 + number))
    may_build.set()
    assert tables.catch_up("big", 60)
    assert len(tables.surrogate("big").rows) == 80
    assert len(built) - before == 4


def test_two_large_tables_are_built_one_after_the_other_and_small_ones_beside_them(
    open_tables, slow_build
):
    may_build, built = slow_build
    may_build.set()
    tables, ledger = open_tables({"big1": 60, "big2": 60, "small": 3})
    assert all(tables.catch_up(name, 60) for name in ("big1", "big2", "small"))
    may_build.clear()
    built.clear()
    for name in ("big1", "big2"):
        insert(ledger, name, "", new_rows(1, first=60))
    insert(ledger, "small", "", new_rows(1, first=3))
    assert tables.catch_up("small", 60)
    may_build.set()
    assert all(tables.catch_up(name, 60) for name in ("big1", "big2"))
    large = [step for step in built if step[0] != "small"]
    assert large in (
        [(name, step) for name in order for step in ("starts", "ends")]
        for order in (("big1", "big2"), ("big2", "big1"))
    )
