"""Files that travel by value, and what a worker keeps of them."""

import io
import os
import pickle
import time
import zipfile
from dataclasses import replace
from pathlib import Path

import pytest

from tests.until import until
from wrenchbook.service.jobs import dask as worker_files
from wrenchbook.service.jobs.attempt import Attempt, Outcome, prepare, write_outcome
from wrenchbook.service.jobs.dask import (
    BadPayloadError,
    digest,
    pack,
    place,
    unpack,
)
from wrenchbook.service.jobs.solver_pool import LocalEngine

SPEC = Attempt(1, 1, "quick", "", "f1", (1.0, 2.0, 3.0, 0.0, 0.0, 0.0))


class Worker:
    address = "tcp://127.0.0.1:1"

    def get_current_task(self):
        return "t"


@pytest.fixture
def on_a_worker(tmp_path, monkeypatch):
    monkeypatch.setenv(worker_files.FOLDER_VARIABLE, str(tmp_path / "worker"))
    monkeypatch.setattr("distributed.get_worker", Worker)
    return worker_files.worker_folder()


def zipped(files):
    """The payload of some files, as a worker of any kind may send it."""
    content = io.BytesIO()
    with zipfile.ZipFile(content, "w") as archive:
        for name, text in files.items():
            archive.writestr(zipfile.ZipInfo(name), text)
    return content.getvalue()


BUNDLE = zipped({"a": b"1"})


def run(files=BUNDLE, task="t-1-1"):
    sent = pickle.dumps(replace(SPEC, task=task, folder=Path("/server/jobs/1/1")))
    return worker_files.run_task(sent, digest(BUNDLE), files)


def written(folder, files):
    for name, content in files.items():
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_bytes(content)
    return folder


def read(folder):
    files = (path for path in folder.rglob("*") if path.is_file())
    return {path.relative_to(folder).as_posix(): path.read_bytes() for path in files}


FILES = {"component.toml": b"name", "meshes/part.msh": bytes(range(256))}


@pytest.mark.parametrize("changed", [{"component.toml": b"other"}, {"more": b""}])
def test_files_have_one_digest_if_and_only_if_they_are_the_same(tmp_path, changed):
    """Whatever their times are."""
    first, same = written(tmp_path / "1", FILES), written(tmp_path / "2", FILES)
    os.utime(same / "component.toml", (1, 1))
    other = written(tmp_path / "3", FILES | changed)
    assert digest(pack(first)) == digest(pack(same)) != digest(pack(other))


def test_what_is_unpacked_is_what_was_packed(tmp_path):
    unpack(pack(written(tmp_path / "here", FILES)), tmp_path / "there")
    assert read(tmp_path / "there") == FILES


@pytest.mark.parametrize("name", ["../out", "/etc/passwd", "a/../../out", "a\\b"])
def test_a_name_that_leads_out_of_its_folder_writes_nothing(tmp_path, name):
    with pytest.raises(BadPayloadError, match="leads out"):
        unpack(zipped({"good": b"1", name: b"2"}), tmp_path / "there")
    assert not (tmp_path / "there").exists()


def test_files_that_were_damaged_on_the_way_are_not_kept(tmp_path):
    name = digest(zipped({"a": b"sent"}))
    with pytest.raises(BadPayloadError, match="not as"):
        place(zipped({"a": b"torn"}), name, tmp_path)
    assert list(tmp_path.iterdir()) == []


def test_a_folder_larger_than_a_bundle_may_be_is_refused(tmp_path):
    (tmp_path / "large").write_bytes(bytes(100))
    with pytest.raises(BadPayloadError, match="more than 99 bytes"):
        pack(tmp_path, limit=99)


def test_a_worker_that_gets_a_damaged_bundle_says_so_and_keeps_none(on_a_worker):
    assert "not as" in run(files=zipped({"a": b"2"}))["unfit"]
    assert list((on_a_worker / "bundles").iterdir()) == []


def test_a_worker_whose_disk_is_full_takes_no_order(on_a_worker, monkeypatch):
    monkeypatch.setattr(worker_files, "FREE_BYTES", 1 << 62)
    assert "MB left" in run()["unfit"]


def test_a_disk_that_fills_while_a_bundle_comes_is_told_and_nothing_is_left(
    on_a_worker, monkeypatch
):
    def full(*arguments, **named):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("zipfile.ZipFile.extractall", full)
    with pytest.raises(OSError, match="No space left"):
        place(BUNDLE, digest(BUNDLE), on_a_worker / "bundles")
    assert list((on_a_worker / "bundles").iterdir()) == []


@pytest.mark.parametrize("task", ["../../etc", ".hidden", "a/b", "", "x" * 200])
def test_a_task_key_that_names_no_folder_is_refused(on_a_worker, task):
    assert "no task key" in run(task=task)["unfit"]


def test_an_attempt_that_has_ended_is_answered_from_the_disk(on_a_worker):
    folder = on_a_worker / "attempts" / "t-1-1"
    prepare(replace(SPEC, folder=folder))
    write_outcome(replace(SPEC, folder=folder), Outcome("done", displacement=[0.0] * 6))
    payload = run()
    assert payload["unfit"] is None
    assert b'"done"' in payload["outcome"]


def test_a_solver_that_nobody_minds_is_ended_after_a_while(on_a_worker, monkeypatch):
    monkeypatch.setenv("WRENCHBOOK_SOLVE", "stand_in:endless")
    monkeypatch.setenv("PYTHONPATH", os.path.dirname(os.path.dirname(__file__)))  # noqa: PTH120
    folder = on_a_worker / "attempts" / "t-1-1"
    prepare(replace(SPEC, folder=folder))
    engine = LocalEngine(1)
    attempt = replace(SPEC, task="t-1-1", folder=folder)
    engine.submit(attempt)
    seen = worker_files.sweep(on_a_worker, engine, {})
    assert list(seen) == ["t-1-1"]
    with worker_files.supervised(folder):
        assert worker_files.sweep(on_a_worker, engine, seen) == {}  # somebody minds it
    worker_files.sweep(
        on_a_worker, engine, {"t-1-1": time.monotonic() - worker_files.ORPHAN_SECONDS}
    )
    until(lambda: engine.poll(attempt) != "running")


def test_attempts_are_kept_for_a_while_and_not_for_ever(on_a_worker, monkeypatch):
    monkeypatch.setattr(worker_files, "ATTEMPTS", 2)
    for number in range(5):
        folder = on_a_worker / "attempts" / f"t-{number}-1"
        prepare(replace(SPEC, folder=folder))
        os.utime(folder, (number, time.time() - 10 + number))
    worker_files.sweep(on_a_worker, LocalEngine(1), {})
    kept = sorted(path.name for path in (on_a_worker / "attempts").iterdir())
    assert kept == ["t-3-1", "t-4-1"]


def test_bundles_in_use_are_kept_when_old_ones_go(tmp_path, monkeypatch):
    monkeypatch.setattr(worker_files, "BUNDLES", 1)
    for number in range(3):
        files = zipped({"a": bytes([number])})
        bundle = place(files, digest(files), tmp_path)
        old = time.time() - (worker_files.BUNDLE_SECONDS + 100 - number if number < 2 else 0)
        os.utime(bundle, (old, old))
    worker_files.drop_old_bundles(tmp_path)
    assert [read(path) for path in tmp_path.iterdir()] == [{"a": b"\x02"}]
