"""A component that was acknowledged is on the disk, and one that is not leaves nothing."""

import io
import os
import shutil
import zipfile
from pathlib import Path

import pytest

from wrenchbook.fea.bundle.read import BundleError, read_bundle
from wrenchbook.service.library.bundles import copy_bundle
from wrenchbook.service.library.component import (
    MAX_NAMES,
    Component,
    ComponentExistsError,
    LibraryUnavailableError,
    UnknownComponentError,
)
from wrenchbook.service.library.library import Library

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
    fsync, rename = os.fsync, Path.rename

    def recorded(descriptor):
        events.append(os.path.basename(os.readlink(f"/proc/self/fd/{descriptor}")))  # noqa: PTH119, PTH115
        fsync(descriptor)

    def moved(*places):
        events.append("moved")
        return rename(*places)

    monkeypatch.setattr("wrenchbook.service.files.durable.os.fsync", recorded)
    monkeypatch.setattr(Path, "rename", moved)
    monkeypatch.setattr("wrenchbook.service.library.bundles.check_mesh", lambda folder: {})
    library.add_zip(rig_zip())
    before = events[: events.index("moved")]
    assert {"component.toml", "notes", "read.me", "rig"} <= set(before)
    assert events[events.index("moved") + 1 :] == ["components"]


def test_an_upload_is_seen_only_once_its_check_is_kept(tmp_path, monkeypatch):
    """Another process built its table without the check's estimate: answers were refused."""
    seen: list[bool] = []

    def checked(component: Component) -> None:
        seen.append((tmp_path / "components" / component.name).exists())

    library = Library(tmp_path / "components", tmp_path / "none", on_checked=checked)
    monkeypatch.setattr("wrenchbook.service.library.bundles.check_mesh", lambda folder: {})
    assert library.add_zip(rig_zip()).name == "rig"
    assert seen == [False]


@pytest.mark.parametrize("write", ["bundles.unpack", "sync_tree", "Path.rename"])
def test_a_bundle_that_cannot_be_written_is_refused_by_name_and_leaves_nothing(
    library, tmp_path, monkeypatch, write
):
    """It was a 500."""

    def full(*_):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("wrenchbook.service.library.bundles.check_mesh", lambda folder: {})
    monkeypatch.setattr(f"wrenchbook.service.library.library.{write}", full)
    with pytest.raises(
        LibraryUnavailableError, match=r"No space left on device\. Nothing was added"
    ):
        library.add_zip(rig_zip())
    assert list((tmp_path / "components").iterdir()) == []
    assert library.names() == []
    monkeypatch.undo()
    monkeypatch.setattr("wrenchbook.service.library.bundles.check_mesh", lambda folder: {})
    assert library.add_zip(rig_zip()).name == "rig"


def test_a_copy_on_a_full_disk_is_refused_with_its_remedy(library, tmp_path, monkeypatch):
    """The message was a list of Python with each file, and asked for permissions."""

    def full(*_, **__):
        raise OSError(28, "No space left on device", "mesh.msh")

    (tmp_path / "components" / "rig").mkdir()
    (tmp_path / "components" / "rig" / "component.toml").write_text(TEXT)
    monkeypatch.setattr("shutil.copystat", full)  # copytree collects the errors of all files
    with pytest.raises(LibraryUnavailableError, match=r"components: No space left .* make room"):
        library.add_copy("rig", "rig2", None)


def test_a_component_is_taken_up_once_its_files_are_mended(library, tmp_path):
    folder = tmp_path / "components" / "rig"
    folder.mkdir()
    (folder / "component.toml").write_bytes(b"\xff\xfe")
    assert "rig" not in library
    assert "UTF-8" in library.broken()["rig"]
    (folder / "component.toml").write_text(TEXT)
    assert library["rig"].title == "rig"
    assert library.broken() == {}


RANGE = "[range]\nforce = [1, 1, 1]\nmoment = [1, 1, 1]\n"


@pytest.mark.parametrize(
    "head",
    [
        'name = "rig"\ntitle = """\nof two lines"""\n',
        '"name" = "rig"\ntitle = "rig"\n',
        'title = """\n[a title]"""\nname = "rig"\n',
    ],
    ids=["title of several lines", "quoted key", "bracket above the name"],
)
def test_a_file_whose_name_cannot_be_edited_is_not_copied(library, tmp_path, head):
    folder = tmp_path / "components" / "rig"
    folder.mkdir(parents=True)
    (folder / "component.toml").write_text(head + RANGE)
    with pytest.raises(BundleError, match="'rig' cannot be changed for a copy; write each on one"):
        copy_bundle(library["rig"], "other", "new", tmp_path / "copy")
    assert not (tmp_path / "copy").exists()


def test_a_second_server_on_the_folder_does_not_answer_201_with_the_first_ones_component(
    library, tmp_path
):
    """It moved its bundle into the first one's folder and told the first one's range as added."""
    second = Library(tmp_path / "components", tmp_path / "none")
    library.add_table_only(
        name="two", title="first", range={"force": [[-9, 9]] * 3, "moment": [[-9, 9]] * 3}
    )
    with pytest.raises(ComponentExistsError, match="already is a component 'two'"):
        second.add_table_only(
            name="two", title="second", range={"force": [[-1, 1]] * 3, "moment": [[-1, 1]] * 3}
        )
    files = [path.name for path in (tmp_path / "components").rglob("*")]
    assert sorted(files) == ["component.toml", "two"]
    assert second["two"].title == "first"


def test_two_servers_that_add_one_name_at_the_same_moment_add_it_once(
    library, tmp_path, monkeypatch
):
    """The other's folder appears between the look and the rename."""
    monkeypatch.setattr("wrenchbook.service.library.library.os.path.lexists", lambda path: False)
    library.add_table_only(
        name="two", title="first", range={"force": [[-9, 9]] * 3, "moment": [[-9, 9]] * 3}
    )
    second = Library(tmp_path / "components", tmp_path / "none")
    second._components = {}
    with pytest.raises(ComponentExistsError):
        second.add_table_only(
            name="two", title="second", range={"force": [[-1, 1]] * 3, "moment": [[-1, 1]] * 3}
        )
    assert second["two"].title == "first"


def test_a_name_whose_files_are_damaged_is_taken_and_nothing_is_put_into_its_folder(
    library, tmp_path
):
    """The new bundle was moved into the damaged folder, and the reply told the old mistakes."""
    folder = tmp_path / "components" / "rig"
    folder.mkdir()
    (folder / "component.toml").write_bytes(b"")
    with pytest.raises(ComponentExistsError):
        library.add_table_only(
            name="rig", title="rig", range={"force": [[-1, 1]] * 3, "moment": [[-1, 1]] * 3}
        )
    assert [path.name for path in folder.iterdir()] == ["component.toml"]


@pytest.mark.parametrize("place", ["a", "z"])  # read before and after the folder "rig"
def test_a_folder_with_anothers_name_in_its_file_does_not_answer_in_its_place(tmp_path, place):
    """One damaged or copied component.toml replaced a healthy component of another folder."""
    for name, text in (("rig", TEXT), (place, TEXT.replace('"rig"\n[', '"copy"\n['))):
        folder = tmp_path / "components" / name
        folder.mkdir(parents=True)
        (folder / "component.toml").write_text(text)
    library = Library(tmp_path / "components", tmp_path / "none")
    assert library["rig"].title == "rig"
    assert library.broken() == {
        place: f'name: is "rig", but the folder is "{place}"; give both the same name'
    }


def test_a_folder_does_not_take_the_place_of_a_shipped_component(tmp_path):
    """A plate put into the data directory by hand answered instead of the shipped plate."""
    for parent, title in (("shipped", "shipped"), ("components", "own")):
        folder = tmp_path / parent / "rig"
        folder.mkdir(parents=True)
        (folder / "component.toml").write_text(TEXT.replace('"rig"\n[', f'"{title}"\n['))
    library = Library(tmp_path / "components", tmp_path / "shipped")
    assert library["rig"].title == "shipped"
    assert "shipped component" in library.broken()["rig"]
    library.version()  # read the shipped one again, and forgot what it had warned of
    assert "shipped component" in library.broken()["rig"]


def test_a_folder_with_a_shipped_name_is_reported_though_it_comes_after_the_start(tmp_path):
    shipped, own = tmp_path / "shipped" / "rig", tmp_path / "components" / "rig"
    for folder in (shipped, own):
        if folder is own:
            library = Library(own.parent, shipped.parent)
        folder.mkdir(parents=True)
        (folder / "component.toml").write_text(TEXT)
    library.version()
    assert "shipped component" in library.broken()["rig"]


@pytest.mark.parametrize("text", [TEXT, "damaged"])
def test_a_component_whose_folder_is_removed_is_unknown_and_not_broken(library, tmp_path, text):
    """It stayed `broken`, and the server `degraded`, until a restart."""
    folder = tmp_path / "components" / "rig"
    folder.mkdir()
    (folder / "component.toml").write_text(text)
    library.version()
    shutil.rmtree(folder)
    library._next_poll = 0.0
    library.version()
    assert library.broken() == {}
    assert library.names() == []


def test_a_name_no_folder_can_have_is_an_unknown_component(library):
    """A name of 300 characters in the path was a 500: File name too long."""
    for name in ("x" * 300, "..", "a/b", "a\0b"):
        assert name not in library
        with pytest.raises(UnknownComponentError):
            library[name]


def test_a_component_edited_while_it_is_read_is_read_again(library, tmp_path, monkeypatch):
    library.add_zip(rig_zip())
    (file,) = (tmp_path / "components").glob("rig/component.toml")

    def read_and_edit(folder):
        result = read_bundle(folder)
        monkeypatch.setattr("wrenchbook.service.library.library.read_bundle", read_bundle)
        file.write_text(file.read_text().replace('title = "', 'title = "After: ', 1))
        return result

    monkeypatch.setattr("wrenchbook.service.library.library.read_bundle", read_and_edit)
    file.write_text(file.read_text().replace('title = "', 'title = "Before: ', 1))
    assert library["rig"].title.startswith("Before: ")
    assert library["rig"].title.startswith("After: Before: ")


def test_a_small_library_is_told_as_a_whole():
    assert str(UnknownComponentError("x", ["bar", "plate"])).endswith("has: bar, plate.")
    assert str(UnknownComponentError("x", [])).endswith("has: none yet.")


def test_of_a_large_library_the_names_most_like_it_are_told():
    known = [f"rig_{number:04d}" for number in range(1000)] + ["bracket"]
    reported = str(UnknownComponentError("brakcet", known))
    assert "bracket" in reported
    assert f"and {len(known) - MAX_NAMES} more" in reported
    assert len(reported) < 400
