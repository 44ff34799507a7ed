"""Tables beside the ledger: what is damaged, lost or of another ledger is never served silently."""

import random
import shutil
import threading
from dataclasses import replace

import numpy as np
import pytest

from tests.service.ledger_rows import insert, new_rows, stored
from tests.until import until
from wrenchbook.service.ledger import Ledger, LedgerUnavailableError
from wrenchbook.service.library.library import Library
from wrenchbook.service.tables import build as builds
from wrenchbook.service.tables.build import TableBuilder, packed_bytes
from wrenchbook.service.tables.coordinator_state import CoordinatorState
from wrenchbook.service.tables.mapped import MappedTables, TableBehindError
from wrenchbook.service.tables.store import TableStore, drop_least_used
from wrenchbook.service.workspace import Watcher
from wrenchbook.surrogate.table.hdf5 import read_table

RANGE = [[-10.0, 10.0]] * 3


class Site:
    """A data directory and, while it is open, its ledger, library, builder and tables."""

    def __init__(self, folder):
        self.folder = folder

    def open(self, *names):
        self.ledger = Ledger(self.folder / "ledger.sqlite", patient=True)
        self.library = Library(self.folder / "components", self.folder / "none")
        self.add(*names)
        self.state = CoordinatorState(self.folder / "shared")
        assert self.state.take()
        files = TableStore(self.folder / "tables", self.ledger)
        where = files, self.library, self.state
        self.builder, self.tables = TableBuilder(*where), MappedTables(*where)
        self.watcher = Watcher(self.ledger)
        self.watcher.on_change(self.tables.wake, self.tables.stamp)
        self.watcher.start()
        self.builder.start()
        self.tables.start()

    def add(self, *names):
        for name in names:
            self.library.add_table_only(
                name=name, title=name, range={"force": RANGE, "moment": RANGE}
            )

    def close(self):
        self.watcher.stop()
        self.tables.stop()
        self.builder.stop()
        self.state.release()
        self.ledger.close()

    def insert(self, count, first=0, name="rig"):
        insert(self.ledger, name, "", new_rows(count, first))
        assert self.tables.catch_up(name, 600), self.tables.faults()

    def wrenches(self, name="rig"):
        return sorted(map(tuple, self.tables.surrogate(name).rows.wrench.tolist()))

    def file(self, name="rig"):
        return self.folder / "tables" / f"{name}.h5"


@pytest.fixture
def site(tmp_path):
    site = Site(tmp_path)
    site.open("rig")
    yield site
    site.close()


def expected(count):
    return sorted(tuple(map(float, row.wrench)) for row in new_rows(count))


@pytest.mark.parametrize("count", [0, 5, 60])
def test_rows_of_a_fresh_ledger_beside_an_old_table_file_are_all_there(site, count):
    """A ledger of 219 rows beside a table of 200 hid the first 200 for good."""
    site.insert(30)
    version = site.tables.surrogate("rig").version
    site.close()
    for path in site.folder.glob("ledger.sqlite*"):
        path.unlink()
    fresh = Ledger(site.folder / "ledger.sqlite")
    insert(fresh, "rig", "", new_rows(count, first=30))
    fresh.close()
    site.open()
    assert site.wrenches() == expected(30 + count)
    assert len(stored(site.ledger, "rig")) == 30 + count
    assert site.tables.surrogate("rig").version > version  # no version is of two tables


def put_back(site, copy):
    for path in site.folder.glob("ledger.sqlite*"):
        path.unlink()
    shutil.copy(copy, site.folder / "ledger.sqlite")


@pytest.mark.parametrize("gone_in_copy", [False, True])
def test_a_withdrawn_row_does_not_come_back_with_an_older_copy_of_the_ledger(site, gone_in_copy):
    """Nor does a restored one go: the newest word on a row holds, whoever has it."""
    site.insert(10)
    row = stored(site.ledger, "rig")[4]
    if gone_in_copy:
        site.ledger.withdraw("rig", row.seq)
    site.close()
    copy = shutil.copy(site.folder / "ledger.sqlite", site.folder / "copy")
    site.open()
    site.ledger.withdraw("rig", row.seq, withdrawn=not gone_in_copy)
    site.insert(2, first=10)
    site.close()
    put_back(site, copy)
    for _ in range(2):
        site.open()
        assert (row.wrench in site.wrenches()) == gone_in_copy
        assert len(site.wrenches()) == 12 - (not gone_in_copy)
        assert site.tables.faults() == {}
        site.close()
    site.open()


def test_a_table_file_copied_over_anothers_brings_no_row_of_the_other_component(site, caplog):
    """b.h5 put in place of a.h5: b's rows went into a's ledger and its answers were covered."""
    site.close()
    site.open("other")
    site.insert(5)
    site.insert(5, first=20, name="other")
    site.close()
    shutil.copy(site.file("other"), site.file("rig"))
    site.open()
    assert site.wrenches() == expected(5)
    assert len(stored(site.ledger, "rig")) == 5
    assert "the file is the table of 'other'" in caplog.text


def test_a_withdrawn_row_leaves_the_table_and_its_file_and_comes_back(site):
    site.insert(10)
    gone = stored(site.ledger, "rig")[4]
    site.ledger.withdraw("rig", gone.seq)
    assert site.tables.catch_up("rig", 600)
    version = site.tables.surrogate("rig").version
    assert gone.wrench not in site.wrenches()
    for _ in range(2):
        site.close()
        site.open()
        assert gone.wrench not in site.wrenches()
        assert site.tables.surrogate("rig").version == version
    site.close()
    ledger = Ledger(site.folder / "ledger.sqlite")
    ledger.withdraw("rig", gone.seq, withdrawn=False)  # while nobody serves
    ledger.close()
    site.open()
    assert site.wrenches() == expected(10)
    assert site.tables.surrogate("rig").version > version


def test_an_exception_in_one_tables_build_starves_no_other(site, monkeypatch):
    """The tables after it in the alphabet got no rows any more."""
    for name in ("aaa", "zzz"):
        site.add(name)
        site.tables.surrogate(name)
    build = builds.build_table

    def fails(component, *rest):
        if component.name == "aaa" and len(rest[0]):
            raise ZeroDivisionError("of this table")
        return build(component, *rest)

    monkeypatch.setattr(builds, "build_table", fails)
    insert(site.ledger, "aaa", "", new_rows(5))
    site.insert(5, name="zzz")
    assert len(site.wrenches("zzz")) == 5
    assert not site.tables.catch_up("aaa", 5)
    until(lambda: site.tables.faults() == {"aaa": "of this table"})
    with pytest.raises(TableBehindError, match="of this table"):
        site.tables.caught_up("aaa", 5)
    monkeypatch.undo()
    site.insert(1, first=5, name="aaa")
    until(lambda: not site.tables.faults())


@pytest.mark.parametrize(
    ("part", "call"), [("_ledger", "last_seq"), ("_store", "small"), ("_small", "submit")]
)
def test_a_table_is_built_after_any_step_before_its_build_has_failed(site, monkeypatch, part, call):
    whole, failures = getattr(getattr(site.builder, part), call), []

    def fails_at_first(*arguments):
        in_build = threading.current_thread().name.startswith(("build", "tables-follow"))
        if in_build and len(failures) < 2:
            failures.append(arguments)
            raise RuntimeError("of this step")
        return whole(*arguments)

    monkeypatch.setattr(getattr(site.builder, part), call, fails_at_first)
    monkeypatch.setattr(builds, "RETRY_S", 0.05)
    insert(site.ledger, "rig", "", new_rows(5))
    until(lambda: len(failures) == 2)
    site.insert(1, first=5)
    assert site.wrenches() == expected(6)
    until(lambda: not site.tables.faults())


def test_whatever_byte_is_damaged_tables_open_and_sound_components_answer(site, caplog):
    site.add("other")
    site.tables.surrogate("other")
    site.insert(20)
    site.insert(20, name="other")
    site.close()
    whole = site.folder.with_name("whole")
    shutil.copytree(site.folder, whole)
    chance = random.Random(11)
    kinds = ["tables/rig.h5", "components/rig/component.toml", "ledger.sqlite"]
    for turn in range(16):
        shutil.rmtree(site.folder)
        shutil.copytree(whole, site.folder)
        path = site.folder / kinds[turn % 3]
        raw = bytearray(path.read_bytes())
        for _ in range(1 + turn % 4):
            raw[chance.randrange(len(raw))] ^= chance.randrange(1, 256)
        path.write_bytes(raw)
        site.open()
        rows = site.tables.surrogate("other").rows
        right = {row.wrench[0] + 10 * row.wrench[5]: row.displacement for row in new_rows(20)}
        for wrench, displacement in zip(rows.wrench, rows.displacement, strict=True):
            assert tuple(displacement) == right[wrench[0] + 10 * wrench[5]]
        if path.name != "ledger.sqlite":
            assert len(rows) == 20
        if path.name == "rig.h5":
            assert site.wrenches() == expected(20)
            assert "table rig" in caplog.text
        site.close()
        caplog.clear()
        assert path.name != "rig.h5" or path.read_bytes() != bytes(raw)
    site.open()


def packed_files(site, name="rig"):
    return sorted((site.folder / "tables").glob(f"{name}-*.wbt"))


def no_build(monkeypatch):
    def build(component, *_):
        raise AssertionError(f"{component.name} was built")

    monkeypatch.setattr(builds, "build_table", build)


def answer_of(site, name="rig"):
    return site.tables.surrogate(name).packed.answer((2.5, 0, 0, 0, 0, 0.5))


def test_a_start_maps_the_packed_file_and_builds_nothing(site, monkeypatch):
    site.insert(30)
    before, rows = answer_of(site), site.wrenches()
    site.close()
    no_build(monkeypatch)
    site.open()
    assert answer_of(site) == before
    assert site.tables.faults() == {}
    assert (site.tables.surrogate("rig").row_count, site.wrenches()) == (30, rows)


def test_a_row_after_a_mapped_start_is_in_the_next_version_and_its_only_file(site):
    site.insert(30)
    site.close()
    site.open()
    site.insert(1, first=30)
    assert site.wrenches() == expected(31)
    version = site.tables.surrogate("rig").version
    assert [path.name for path in packed_files(site)] == [f"rig-{version}.wbt"]


def flipped(share):
    def change(content, foreign):
        damaged = bytearray(content)
        damaged[int(share * len(content))] ^= 1
        return bytes(damaged)

    return change


@pytest.mark.parametrize(
    "change",
    [
        *map(flipped, (0.0, 0.02, 0.5, 0.999)),
        lambda content, foreign: content[:900],
        lambda content, foreign: foreign,
        lambda content, foreign: None,
    ],
    ids=["first byte", "header", "middle", "end", "cut", "of another component", "gone"],
)
def test_a_packed_file_that_is_damaged_foreign_or_gone_is_built_anew(site, change):
    site.add("other")
    site.insert(30)
    before, path = answer_of(site), packed_files(site)[0]
    insert(site.ledger, "other", "", [replace_displacement(row) for row in new_rows(30)])
    assert site.tables.catch_up("other", 600)
    site.close()
    whole, foreign = path.read_bytes(), packed_files(site, "other")[0].read_bytes()
    content = change(whole, foreign)
    path.unlink() if content is None else path.write_bytes(content)
    site.open()
    assert answer_of(site) == before
    assert path.read_bytes() == whole


def replace_displacement(row):
    return replace(row, displacement=tuple(2 * amount for amount in row.displacement))


def test_a_packed_file_built_while_the_ledger_could_not_be_read_is_not_current(site, monkeypatch):
    """It named no ledger, and so was taken for one of any ledger."""
    site.insert(10)
    component, version = site.library["rig"], site.ledger.last_seq("rig")
    files = TableStore(site.folder / "tables", site.ledger)

    def unreadable(*_):
        raise LedgerUnavailableError("the disk does not answer")

    with monkeypatch.context() as patch:
        patch.setattr(site.ledger, "digest", unreadable)
        content = packed_bytes(
            site.tables.surrogate("rig").surrogate(),
            component,
            files.origin(component, version, None),
        )
    origin = files.origin(component, version, None)
    assert files.is_current(component, version, origin)
    files.write_packed("rig", version, content)
    assert not files.is_current(component, version, origin)


def test_a_packed_file_without_an_origin_is_written_again(site):
    """An export has none."""
    site.insert(10)
    component, version = site.library["rig"], site.ledger.last_seq("rig")
    files = TableStore(site.folder / "tables", site.ledger)
    files.write_packed(
        "rig", version, packed_bytes(site.tables.surrogate("rig").surrogate(), component)
    )
    assert not files.is_current(component, version, files.origin(component, version, None))


def test_a_packed_file_of_another_ledger_is_not_answered_from(site):
    """Its version is the same, its rows are not."""
    site.insert(30)
    site.close()
    (site.folder / "tables" / "rig.h5").unlink()
    for path in site.folder.glob("ledger.sqlite*"):
        path.unlink()
    ledger = Ledger(site.folder / "ledger.sqlite")
    insert(ledger, "rig", "", [replace_displacement(row) for row in new_rows(30)])
    ledger.close()
    site.open()
    moved = site.tables.surrogate("rig").packed.answer((5.0, 0, 0, 0, 0, 0)).outputs
    assert moved is not None
    assert moved[0] == pytest.approx(2 * 5e-6)


@pytest.mark.parametrize("edit", ["10.0", "tolerance"])
def test_a_component_edited_while_nobody_served_is_not_answered_from_the_old_file(site, edit):
    site.insert(30)
    version = site.tables.surrogate("rig").version
    site.close()
    file = site.folder / "components" / "rig" / "component.toml"
    text = file.read_text()
    limit = "\n[tolerance]\ntranslation = 1e-3\nrotation = 1e-3\n"
    file.write_text(text.replace("10.0", "20.0") if edit == "10.0" else text + limit)
    site.open()
    table = site.tables.surrogate("rig")
    assert table.version == version
    assert table.load_range.high[0] == (20.0 if edit == "10.0" else 10.0)
    assert (table.tolerance is not None) == (edit == "tolerance")


def test_a_table_whose_hdf5_file_was_not_written_before_a_kill_is_mapped_and_written(
    site, monkeypatch
):
    site.insert(30)
    site.close()
    older = site.file().read_bytes()
    site.open()
    site.insert(5, first=30)
    site.close()
    site.file().write_bytes(older)  # as a kill leaves it within a second of the row
    no_build(monkeypatch)
    site.open()
    assert site.wrenches() == expected(35)
    site.close()
    assert len(read_table(site.file())[0]) == 35
    site.open()


def test_what_a_killed_writer_of_a_packed_file_has_left_is_removed(site):
    site.close()
    draft = site.folder / "tables" / ".rig-3.wbt.4711.1"
    draft.write_bytes(b"half")
    site.open()
    assert not draft.exists()


def test_numpy_tables_used_longest_ago_are_dropped_and_built_again(site):
    site.add("other")
    site.insert(30)
    site.insert(30, name="other")
    first, second = (site.tables.surrogate(name) for name in ("rig", "other"))
    before = first.surrogate().rows
    second.surrogate()
    drop_least_used(site.tables.present().values(), 0.5)
    assert (first.built, second.built is None) == (None, False)
    np.testing.assert_array_equal(first.surrogate().rows.displacement, before.displacement)


def test_a_full_disk_leaves_the_version_before_and_the_file_is_written_later(site, monkeypatch):
    def full(*_, **__):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("wrenchbook.service.tables.store.write_atomically", full)
    insert(site.ledger, "rig", "", new_rows(30))
    assert not site.tables.catch_up("rig", 20)
    assert site.tables.surrogate("rig").row_count == 0
    assert "No space left on device; make room on its disk" in site.tables.faults()["rig"]
    monkeypatch.undo()
    until(lambda: not site.tables.faults())
    assert site.wrenches() == expected(30)
    version = site.tables.surrogate("rig").version
    assert [path.name for path in packed_files(site)] == [f"rig-{version}.wbt"]


def test_a_build_of_rows_that_are_in_the_hdf5_file_ends_the_fault_of_a_full_disk(site, monkeypatch):
    def full(*_, **__):
        raise OSError(28, "No space left on device")

    site.insert(30)
    site.builder.stop()
    files = TableStore(site.folder / "tables", site.ledger)
    library = {"rig": site.library["rig"]}
    builder = TableBuilder(files, library, site.state)
    with monkeypatch.context() as patch:
        patch.setattr(files, "write_packed", full)
        builder._run_build("rig")
    assert "No space left on device" in builder.faults()["rig"]
    library["rig"] = replace(library["rig"])  # edited, so that the table is built again
    builder._run_build("rig")
    assert builder.faults() == {}


def test_a_table_that_frees_no_memory_is_not_dropped():
    class Table:
        def __init__(self, used, rows):
            self.used, self.rows, self.dropped = used, rows, False

        def rows_in_memory(self):
            return self.rows

        def drop(self):
            self.dropped = True

    newest, unsaved = Table(2.0, 1000), Table(1.0, 0)
    drop_least_used([newest, unsaved], 1e-6)
    assert not unsaved.dropped
