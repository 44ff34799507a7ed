"""A component that was acknowledged is on the disk, and one that is not leaves nothing."""

import io
import os
import shutil
import zipfile

import pytest

from service.library.component import LibraryUnavailableError
from service.library.library import Library

TEXT = 'name = "rig"\ntitle = "rig"\n[range]\nforce = [1, 1, 1]\nmoment = [1, 1, 1]\n'


@pytest.fixture
def library(tmp_path):
    return Library(tmp_path / "components", tmp_path / "none")


def rig_zip():
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w") as archive:
        archive.writestr("rig/component.toml", TEXT)
        archive.writestr("rig/notes/read.me", "kept with it")
    buffer.seek(0)
    return buffer


def test_every_file_of_a_bundle_is_synced_before_it_is_moved_in(library, tmp_path, monkeypatch):
    """A power cut after 201 could leave a component with empty files."""
    events = []
    fsync, move = os.fsync, shutil.move

    def recorded(descriptor):
        events.append(os.path.basename(os.readlink(f"/proc/self/fd/{descriptor}")))  # noqa: PTH119, PTH115
        fsync(descriptor)

    def moved(*places):
        events.append("moved")
        return move(*places)

    monkeypatch.setattr("service.files.durable.os.fsync", recorded)
    monkeypatch.setattr("service.library.library.shutil.move", moved)
    monkeypatch.setattr("service.library.library.check_mesh", lambda folder: {})
    library.add_zip(rig_zip())
    before = events[: events.index("moved")]
    assert {"component.toml", "notes", "read.me", "rig"} <= set(before)
    assert events[events.index("moved") + 1 :] == ["components"]


@pytest.mark.parametrize("write", ["extract", "sync_tree", "shutil.move"])
def test_a_bundle_that_cannot_be_written_is_refused_by_name_and_leaves_nothing(
    library, tmp_path, monkeypatch, write
):
    """It was a 500."""

    def full(*_):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("service.library.library.check_mesh", lambda folder: {})
    monkeypatch.setattr(f"service.library.library.{write}", full)
    with pytest.raises(
        LibraryUnavailableError, match=r"No space left on device\. Nothing was added"
    ):
        library.add_zip(rig_zip())
    assert list((tmp_path / "components").iterdir()) == []
    assert library.names() == []
    monkeypatch.undo()
    monkeypatch.setattr("service.library.library.check_mesh", lambda folder: {})
    assert library.add_zip(rig_zip()).name == "rig"


def test_a_component_is_taken_up_once_its_files_are_mended(library, tmp_path):
    folder = tmp_path / "components" / "rig"
    folder.mkdir()
    (folder / "component.toml").write_bytes(b"\xff\xfe")
    assert "rig" not in library
    assert "UTF-8" in library.broken()["rig"]
    (folder / "component.toml").write_text(TEXT)
    assert library["rig"].title == "rig"
    assert library.broken() == {}
