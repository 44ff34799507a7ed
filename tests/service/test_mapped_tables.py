"""Tables that one part of a server builds and another maps: what is seen, when, and what if not."""

import errno
import os
import threading
from contextlib import contextmanager

import pytest

from tests.service.ledger_rows import insert, new_rows, stored
from tests.service.test_durable_tables import Site
from tests.until import until
from wrenchbook.service.files import lock
from wrenchbook.service.ledger import Ledger
from wrenchbook.service.library.library import Library
from wrenchbook.service.tables import build, mapped, store
from wrenchbook.service.tables import build as builds
from wrenchbook.service.tables.build import TableBuilder
from wrenchbook.service.tables.coordinator_state import CoordinatorState, PublishedTable, Status
from wrenchbook.service.tables.mapped import MappedTables, TableBehindError
from wrenchbook.service.tables.store import TableStore, is_of
from wrenchbook.service.workspace import Watcher
from wrenchbook.surrogate.kernel.binding import PackedTable
from wrenchbook.surrogate.solver_error import SolverError
from wrenchbook.surrogate.table.rows import Rows

RANGE = [[-10.0, 10.0]] * 3


class Part:
    """A ledger, a library and tables of their own on one folder, as a process has them."""

    def __init__(self, folder, kind):
        self.ledger = Ledger(folder / "ledger.sqlite")
        self.library = Library(folder / "components", folder / "none")
        self.state = CoordinatorState(folder / "shared")
        if kind is TableBuilder:
            assert self.state.take()
        self.tables = kind(TableStore(folder / "tables", self.ledger), self.library, self.state)
        self.watcher = Watcher(self.ledger)
        if isinstance(self.tables, MappedTables):
            self.watcher.on_change(self.tables.wake, self.tables.stamp)

    def add(self, name, count):
        self.library.add_table_only(name=name, title=name, range={"force": RANGE, "moment": RANGE})
        insert(self.ledger, name, "", new_rows(count))


@contextmanager
def part(folder, kind, *, leave=True):
    one = Part(folder, kind)
    one.watcher.start()
    one.tables.start()
    try:
        yield one
    finally:
        one.watcher.stop()
        one.tables.stop()
        if kind is TableBuilder and leave:
            one.state.release()
        one.ledger.close()


def trouble_of(one):
    assert isinstance(one.tables, MappedTables)
    return one.tables.trouble()


@pytest.fixture
def both(tmp_path):
    """A builder and a part that maps a table of four rows, `new`."""
    with part(tmp_path, TableBuilder) as builder, part(tmp_path, MappedTables) as reader:
        reader.add("new", 4)
        assert reader.tables.catch_up("new", 600)
        yield builder, reader


def test_a_file_without_an_origin_is_published_as_of_no_setup(both):
    table = both[1].tables.surrogate("new")
    del table.packed.meta["provenance"]["origin"]
    assert mapped.published_table(table) == (table.version, "")


def test_a_version_replaces_the_one_before_and_its_file(both, tmp_path):
    _, reader = both
    insert(reader.ledger, "new", "", new_rows(2, 4))
    assert reader.tables.catch_up("new", 600)
    assert len(reader.tables.surrogate("new").rows) == 6
    assert len(list((tmp_path / "tables").glob("new-*.wbt"))) == 1


def test_a_table_that_was_replaced_still_gives_its_bytes_to_a_request_that_has_it(both):
    _, reader = both
    old = reader.tables.surrogate("new")
    content, checksum = old.packed.content, old.packed.checksum
    insert(reader.ledger, "new", "", new_rows(2, 4))
    assert reader.tables.catch_up("new", 600)
    assert (old.packed.content, old.packed.checksum) == (content, checksum)
    assert len(old.rows) == 4
    assert old.surrogate().version == old.version


def test_a_component_edited_on_the_disk_answers_by_its_new_range(both, tmp_path):
    _, reader = both
    file = tmp_path / "components" / "new" / "component.toml"
    edited = file.with_suffix(".new")
    edited.write_text(file.read_text().replace("10.0", "20.0"))
    edited.replace(file)  # a half-written file is a broken component meanwhile
    assert reader.tables.catch_up("new", 600)
    assert reader.tables.surrogate("new").load_range.high[0] == 20.0


def answer_of(one, name="new"):
    return one.tables.surrogate(name).packed.answer((2.5, 0, 0, 0, 0, 0.5))


def wait_for(one, condition):
    """Wait until a part that maps tables has looked, and something holds."""
    with one.tables._changed:
        assert one.tables._changed.wait_for(condition, 20)


@pytest.mark.parametrize("content", ["another component", b"nonsense"])
def test_a_foreign_or_damaged_file_is_told_and_answers_nothing(both, tmp_path, content):
    """A copy of another component's file answered for it as soon as it was there."""
    _, reader = both
    reader.add("other", 9)
    assert reader.tables.catch_up("other", 600)
    before, folder = answer_of(reader), tmp_path / "tables"
    stray = folder / "new-999.wbt"
    other = next(folder.glob("other-*.wbt")).read_bytes()
    stray.write_bytes(content if isinstance(content, bytes) else other)
    wait_for(reader, lambda: "new" in reader.tables.faults())
    assert answer_of(reader) == before
    stray.unlink()
    wait_for(reader, lambda: "new" not in reader.tables.faults())
    assert answer_of(reader) == before


def test_an_older_version_that_is_written_last_answers_nothing(both, tmp_path):
    _, reader = both
    old = next((tmp_path / "tables").glob("new-*.wbt"))
    content = old.read_bytes()
    insert(reader.ledger, "new", "", new_rows(2, 4))
    assert reader.tables.catch_up("new", 600)
    newest = reader.tables.surrogate("new").version
    old.write_bytes(content)
    reader.add("other", 3)
    assert reader.tables.catch_up("other", 600)  # which looks at the folder after that
    assert reader.tables.surrogate("new").version == newest


def test_files_of_no_component_and_of_other_versions_go_at_a_start(tmp_path):
    with part(tmp_path, TableBuilder), part(tmp_path, MappedTables) as reader:
        reader.add("new", 4)
        assert reader.tables.catch_up("new", 600)
    folder = tmp_path / "tables"
    own = next(folder.glob("new-*.wbt"))
    for name in ("new-999.wbt", "gone-4.wbt"):
        (folder / name).write_bytes(own.read_bytes())
    with part(tmp_path, TableBuilder):
        assert [path.name for path in folder.glob("*.wbt")] == [own.name]


def test_a_component_that_was_unreadable_for_a_moment_is_built_again(both, tmp_path, monkeypatch):
    """Only what answers looked at it again; the building process never did."""
    monkeypatch.setattr("wrenchbook.service.library.library.POLL_SECONDS", 0.0)
    _, reader = both
    setup, away = tmp_path / "components" / "new" / "component.toml", tmp_path / "away"
    setup.rename(away)
    for item in both:
        assert "new" not in item.library.names()
    away.rename(setup)
    insert(reader.ledger, "new", "", new_rows(2, 4))
    assert reader.tables.catch_up("new", 600)
    assert len(reader.tables.surrogate("new").rows) == 6


def test_a_stale_file_is_gone_once_the_builder_has_started(tmp_path, monkeypatch):
    """Its table takes long to build; no process may answer from the old one meanwhile."""
    with part(tmp_path, TableBuilder) as builder, part(tmp_path, MappedTables) as reader:
        reader.add("new", 4)
        assert reader.tables.catch_up("new", 600)
        reader.ledger.withdraw("new", stored(reader.ledger, "new")[0].seq)
        assert reader.tables.catch_up("new", 600)
        builder.tables.stop()
        reader.ledger.withdraw("new", 1, withdrawn=False)
    may_build, build = threading.Event(), builds.build_table

    def slow(*given):
        assert may_build.wait(600)
        return build(*given)

    monkeypatch.setattr(builds, "build_table", slow)
    monkeypatch.setattr(store, "LARGE", 0)
    with part(tmp_path, TableBuilder), part(tmp_path, MappedTables) as reader:
        assert not list((tmp_path / "tables").glob("new-*.wbt"))
        with pytest.raises(TableBehindError, match="cannot answer yet"):
            reader.tables.surrogate("new")
        may_build.set()
        assert reader.tables.catch_up("new", 600)
        assert len(reader.tables.surrogate("new").rows) == 4


def test_without_a_builder_the_last_version_answers_until_the_next_builder_goes_on(tmp_path):
    with part(tmp_path, MappedTables) as reader:
        with part(tmp_path, TableBuilder, leave=False) as builder:
            builder.add("new", 4)
            assert reader.tables.catch_up("new", 600)
            os.close(builder.state._lock)  # as the kernel does for a process that is killed
            builder.state._lock = None
        insert(reader.ledger, "new", "", new_rows(2, 4))
        assert len(reader.tables.surrogate("new").rows) == 4
        with pytest.raises(TableBehindError, match="has ended and is started again"):
            reader.tables.caught_up("new", 0.05)
        assert "has ended" in (trouble_of(reader) or "")
        with part(tmp_path, TableBuilder):
            assert reader.tables.catch_up("new", 600)
            assert len(reader.tables.surrogate("new").rows) == 6
            assert trouble_of(reader) is None


def test_an_empty_table_is_built_once_and_only_shown_for_rows_without_a_table(tmp_path):
    """The list of components built it anew in each call: 30 ms for each component."""
    with part(tmp_path, MappedTables) as reader:
        reader.add("new", 0)
        empty = reader.tables.surrogate("new", or_empty=True)
        assert reader.tables.surrogate("new", or_empty=True) is empty
        reader.add("behind", 4)
        assert reader.tables.surrogate("behind", or_empty=True).row_count == 0
        with pytest.raises(TableBehindError):
            reader.tables.surrogate("behind")


def test_a_second_builder_is_refused(tmp_path):
    one, other = CoordinatorState(tmp_path), CoordinatorState(tmp_path)
    assert one.take()
    assert not other.take()


def test_a_builder_that_waits_while_another_ends_is_the_only_one(tmp_path, monkeypatch):
    """The end removed the lock file, so that a third process locked a new one."""
    one, waiting, third = (CoordinatorState(tmp_path / "shared") for _ in range(3))
    assert one.take()
    monkeypatch.setattr(lock.time, "sleep", lambda _: one.release())
    assert waiting.take()
    monkeypatch.undo()
    assert not third.take()


def test_a_builder_can_take_the_place_of_one_that_has_ended(tmp_path):
    one, other = (CoordinatorState(tmp_path / "shared") for _ in range(2))
    assert one.take()
    one.release()
    assert other.take()


def test_a_process_of_another_user_is_one_of_the_others(tmp_path, monkeypatch):
    one, other = CoordinatorState(tmp_path), CoordinatorState(tmp_path)
    one.publish({"new": PublishedTable(3, "setup")})

    def refuse(process, signal):
        raise PermissionError

    monkeypatch.setattr(os, "kill", refuse)
    assert list(other.others()) == [{"new": (3, "setup")}]


def test_a_file_of_published_tables_that_was_cut_off_is_passed_over(tmp_path):
    (tmp_path / f"{os.getpid()}-1.mapped").write_text('{"new": [3,')
    assert list(CoordinatorState(tmp_path).others()) == []


def test_what_the_builder_says_is_wrong_is_known_to_all(tmp_path, monkeypatch):
    monkeypatch.setattr(mapped, "START_S", 0.2)
    state = CoordinatorState(tmp_path / "shared")
    assert state.take()
    with part(tmp_path, MappedTables) as reader:
        state.write(Status("the disk is full", {"new": "damaged"}))
        until(reader.tables.faults)
        assert reader.tables.faults() == {"new": "damaged"}
        assert trouble_of(reader) == "the disk is full"
    state.release()


def test_rows_are_in_use_only_once_every_web_worker_answers_from_them(both, tmp_path, monkeypatch):
    """A query right after an import was answered by another worker's older table."""
    _, reader = both
    with part(tmp_path, MappedTables) as late:
        assert isinstance(late.tables, MappedTables)
        assert late.tables.catch_up("new", 600)
        waits, may_map, map_new = threading.Event(), threading.Event(), late.tables._map_new

        def slow():
            waits.set()
            assert may_map.wait(600)
            map_new()

        monkeypatch.setattr(late.tables, "_map_new", slow)
        late.tables.wake()
        assert waits.wait(600)  # no earlier call is still mapping
        insert(reader.ledger, "new", "", new_rows(2, 4))
        until(lambda: len(reader.tables.surrogate("new").rows) == 6)
        assert not reader.tables.catch_up("new", 0)
        may_map.set()
        assert reader.tables.catch_up("new", 600)
        assert len(late.tables.surrogate("new").rows) == 6
    assert reader.tables.catch_up("new", 600)  # a worker that has ended is not waited for


# -- tables that are built beside each other and beside the answers ------------------------------


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
            assert may_build.wait(600)
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
    assert "big" not in tables.present()
    with pytest.raises(TableBehindError, match="cannot answer yet"):
        tables.surrogate("big")
    may_build.set()
    assert tables.catch_up("big", 600)
    assert len(tables.surrogate("big").rows) == 60
    assert "big" in tables.present()


def test_a_row_of_one_table_does_not_wait_for_the_build_of_another(open_tables, slow_build):
    """A row of another component showed after 29.8 s."""
    may_build, _ = slow_build
    may_build.set()
    tables, ledger = open_tables({"big": 60, "small": 3})
    assert tables.catch_up("big", 600)
    may_build.clear()
    insert(ledger, "big", "", new_rows(1, first=60))
    insert(ledger, "small", "", new_rows(1, first=3))
    assert tables.catch_up("small", 600)
    assert len(tables.surrogate("big").rows) == 60
    may_build.set()
    assert tables.catch_up("big", 600)
    assert len(tables.surrogate("big").rows) == 61


def test_rows_that_come_during_a_build_are_built_together_after_it(open_tables, slow_build):
    may_build, built = slow_build
    may_build.set()
    tables, ledger = open_tables({"big": 60})
    assert tables.catch_up("big", 600)
    may_build.clear()
    before = len(built)
    insert(ledger, "big", "", new_rows(1, first=60))
    until(lambda: len(built) > before)
    for number in range(1, 20):
        insert(ledger, "big", "", new_rows(1, first=60 + number))
    may_build.set()
    assert tables.catch_up("big", 600)
    assert len(tables.surrogate("big").rows) == 80
    assert len(built) - before == 4


def test_two_large_tables_are_built_one_after_the_other_and_small_ones_beside_them(
    open_tables, slow_build
):
    may_build, built = slow_build
    may_build.set()
    tables, ledger = open_tables({"big1": 60, "big2": 60, "small": 3})
    assert all(tables.catch_up(name, 600) for name in ("big1", "big2", "small"))
    may_build.clear()
    built.clear()
    for name in ("big1", "big2"):
        insert(ledger, name, "", new_rows(1, first=60))
    insert(ledger, "small", "", new_rows(1, first=3))
    assert tables.catch_up("small", 600)
    may_build.set()
    assert all(tables.catch_up(name, 600) for name in ("big1", "big2"))
    large = [step for step in built if step[0] != "small"]
    assert large in (
        [(name, step) for name in order for step in ("starts", "ends")]
        for order in (("big1", "big2"), ("big2", "big1"))
    )


def test_an_earlier_version_that_is_written_late_does_not_remove_the_newer_file(
    tmp_path, monkeypatch
):
    """Its file could not be written before, as on a full disk, and it removed all others."""
    one = Part(tmp_path, TableBuilder)  # its threads are not started
    one.add("new", 4)
    files = one.tables._store
    save = files.save

    def fail(*_):
        raise OSError(errno.ENOSPC, "No space left on device")

    def save_while_a_newer_one_is_built(*arguments):
        save(*arguments)
        insert(one.ledger, "new", "", new_rows(1, 4))
        one.tables._build_newest("new")

    with monkeypatch.context() as patch:
        patch.setattr(files, "write_packed", fail)
        one.tables._build_newest("new")
    monkeypatch.setattr(files, "save", save_while_a_newer_one_is_built)
    one.tables._write("new")
    assert [file.version for file in files.packed_files()["new"]] == [5]
    one.state.release()
    one.ledger.close()


def test_a_file_names_the_solvers_error_with_which_it_was_built(tmp_path, monkeypatch):
    """An estimate that came between two reads gave a file that no web worker mapped."""
    values = {"loads": [10.0] * 6, "mesh": [[1e-9] * 6] * 6}
    estimates = iter([SolverError(values), None])
    one = Part(tmp_path, TableBuilder)
    library = Library(tmp_path / "components")
    files = one.tables._store
    monkeypatch.setattr(files, "solver_error", lambda _: next(estimates))
    one.tables._build(library["bar"], Rows.empty(library["bar"].space), 0)
    (file,) = files.packed_files()["bar"]
    packed = PackedTable.open(file.path)
    built_with = SolverError.read(packed.meta["solver_error"])
    assert is_of(packed, "bar", files.origin(library["bar"], 0, built_with))
    one.state.release()
    one.ledger.close()
