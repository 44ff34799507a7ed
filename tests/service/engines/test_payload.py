"""Files that travel by value, and what a worker keeps of them."""

import os
import pickle
import time
from dataclasses import replace
from pathlib import Path

import pytest

from wrenchbook.service.jobs import dask_worker
from wrenchbook.service.jobs.attempt import Attempt
from wrenchbook.service.jobs.dask_files import (
    BUNDLE_BYTES,
    BadPayloadError,
    digest,
    pack,
    unpack,
    write_files,
)

SPEC = Attempt(1, 1, "quick", "", "f1", (1.0, 2.0, 3.0, 0.0, 0.0, 0.0))


class Worker:
    address = "tcp://127.0.0.1:1"

    def __init__(self, folder):
        self.local_directory = str(folder)


@pytest.fixture
def on_a_worker(tmp_path, monkeypatch):
    monkeypatch.setattr("distributed.get_worker", lambda: Worker(tmp_path))
    return tmp_path / "wrenchbook"


BUNDLE = pickle.dumps({"a": b"1"})


def run(files=BUNDLE):
    sent = pickle.dumps(replace(SPEC, task="t-1-1", folder=Path("/server/jobs/1/1")))
    return dask_worker.run_task(sent, digest(BUNDLE), files)


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
    packed = (pack(folder, BUNDLE_BYTES) for folder in (first, same, other))
    digests = [digest(content) for content in packed]
    assert digests[0] == digests[1] != digests[2]


def test_what_is_placed_is_what_was_packed(tmp_path):
    content = pack(written(tmp_path / "here", FILES), BUNDLE_BYTES)
    unpack(content, digest(content), tmp_path)
    assert read(tmp_path / digest(content)) == FILES


@pytest.mark.parametrize("name", ["../out", "/etc/passwd", "a/../../out", "a\\b", ""])
def test_a_name_that_leads_out_of_its_folder_writes_nothing(tmp_path, name):
    with pytest.raises(BadPayloadError, match="leads out"):
        write_files({"good": b"1", name: b"2"}, tmp_path / "there")
    assert not (tmp_path / "there").exists()


def test_files_that_were_damaged_on_the_way_are_not_kept(tmp_path):
    with pytest.raises(BadPayloadError, match="damaged on the way"):
        unpack(pickle.dumps({"a": b"torn"}), digest(pickle.dumps({"a": b"sent"})), tmp_path)
    assert list(tmp_path.iterdir()) == []


def test_a_folder_larger_than_a_bundle_may_be_is_refused(tmp_path):
    (tmp_path / "large").write_bytes(bytes(100))
    with pytest.raises(BadPayloadError, match="the first file beyond it is large"):
        pack(tmp_path, 99)


def test_a_worker_that_gets_a_damaged_bundle_says_so_and_keeps_none(on_a_worker):
    assert "damaged on the way" in run(files=pickle.dumps({"a": b"2"}))["unfit"]
    assert not (on_a_worker / "bundles").exists()


def test_a_worker_whose_disk_is_full_takes_no_order(on_a_worker, monkeypatch):
    monkeypatch.setattr(dask_worker, "FREE_BYTES", 1 << 62)
    assert "MB left" in run()["unfit"]


def test_a_disk_that_fills_while_a_bundle_comes_is_told_and_nothing_is_left(
    on_a_worker, monkeypatch
):
    def full(*arguments, **named):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(Path, "write_bytes", full)
    assert "No space left" in run()["unfit"]
    assert list((on_a_worker / "bundles").iterdir()) == []


def test_bundles_in_use_are_kept_when_old_ones_go(tmp_path, monkeypatch):
    monkeypatch.setattr(dask_worker, "BUNDLES", 1)
    for number in range(3):
        content = pickle.dumps({"a": bytes([number])})
        unpack(content, digest(content), tmp_path)
        old = time.time() - (dask_worker.BUNDLE_SECONDS + 100 - number if number < 2 else 0)
        os.utime(tmp_path / digest(content), (old, old))
    (tmp_path / "gone").symlink_to("removed")  # has no status, as one that another worker removes
    dask_worker.drop_old_bundles(tmp_path)
    assert [read(path) for path in tmp_path.iterdir() if path.is_dir()] == [{"a": b"\x02"}]
