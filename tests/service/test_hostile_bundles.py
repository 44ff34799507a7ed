"""Bundles made to break the server: each is refused by name, and takes little of it."""

import io
import re
import resource
import struct
import tomllib
import zipfile
from pathlib import Path
from types import SimpleNamespace

import h5py
import meshio
import numpy as np
import pytest

from wrenchbook.fea.bundle.read import BundleError, read_bundle
from wrenchbook.fea.bundle.shipped import SHIPPED
from wrenchbook.fea.mesh.io.abaqus_content import read_deck
from wrenchbook.fea.mesh.io.read import read_mesh
from wrenchbook.fea.spec.problems import MeshFileError
from wrenchbook.service.files.toml import toml_text, toml_value
from wrenchbook.service.library import bundles
from wrenchbook.service.library.bundles import check_mesh, surface_of, unpack

BAR = (SHIPPED / "bar" / "component.toml").read_text().replace('"bar"', '"beam"', 1)


def zipped(*members, method=zipfile.ZIP_DEFLATED):
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w", method) as archive:
        for name, content in members:
            archive.writestr(name, content)
    return buffer.getvalue()


def told(archive, folder):
    folder.mkdir(exist_ok=True)
    with pytest.raises(BundleError) as caught:
        unpack(io.BytesIO(archive), folder)
    assert str(folder) not in str(caught.value)
    assert "Traceback" not in str(caught.value)
    return str(caught.value)


def edited(archive, where, of, content, field="<H"):
    """An archive with one field of each header of the kind `of` overwritten."""
    archive = bytearray(archive)
    at = archive.find(of)
    while at >= 0:
        struct.pack_into(field, archive, at + where, content)
        at = archive.find(of, at + 4)
    return bytes(archive)


LOCAL, CENTRAL, END = b"PK\x03\x04", b"PK\x01\x02", b"PK\x05\x06"
GOOD = zipped(("component.toml", BAR))
BROKEN = {
    "bzip2": zipped(("component.toml", BAR), method=zipfile.ZIP_BZIP2),
    "lzma": zipped(("component.toml", BAR), method=zipfile.ZIP_LZMA),
    "an unknown compression": edited(edited(GOOD, 10, CENTRAL, 97), 8, LOCAL, 97),
    "a password": edited(edited(GOOD, 8, CENTRAL, 1), 6, LOCAL, 1),
    "a wrong sum": edited(GOOD, 16, CENTRAL, 7, "<I"),
    "a member that is longer than it says": edited(GOOD, 24, CENTRAL, 10, "<I"),
    "a member that begins behind the end": edited(GOOD, 42, CENTRAL, 1 << 30, "<I"),
    "a list that begins behind the end": edited(GOOD, 16, END, 1 << 30, "<I"),
    "a name that is no text": edited(edited(GOOD, 46, CENTRAL, 0xFF), 8, CENTRAL, 0x800),
    "a date that is none": edited(GOOD, 14, CENTRAL, 0xFFFF)[:-30],
    "half of it": GOOD[: len(GOOD) // 2],
    "a name of 300 characters": zipped(("a" * 300 + "/component.toml", BAR)),
    "a file that is a folder": zipped(("a", "x"), ("a/component.toml", BAR)),
    "the same file twice": zipped(("component.toml", BAR), ("./component.toml", BAR)),
    "a name with a zero": GOOD.replace(b"component.toml", b"component\0toml"),
    "no name": edited(edited(GOOD, 28, CENTRAL, 0), 26, LOCAL, 0),
    "more files than a component has": zipped(*((f"{n}", "") for n in range(1001))),
    "two components": zipped(("a/component.toml", BAR), ("b/component.toml", BAR)),
    "a component.toml of a megabyte": zipped(("component.toml", BAR + "#" * 1_000_000)),
}


@pytest.mark.parametrize("what", BROKEN)
def test_a_broken_archive_is_refused_and_nothing_of_it_stays(tmp_path, what):
    assert told(BROKEN[what], tmp_path / "incoming")


def test_an_archive_that_lies_about_its_size_is_cut_off_where_the_limit_is(tmp_path, monkeypatch):
    bomb = zipped(("component.toml", BAR), ("zeros", bytes(64 << 20)))
    monkeypatch.setattr("wrenchbook.service.library.bundles.MAX_BUNDLE_BYTES", 1 << 20)
    path = tmp_path / "bomb.zip"
    path.write_bytes(edited(bomb, 24, CENTRAL, 10, "<I"))
    (tmp_path / "out").mkdir()
    with pytest.raises(BundleError):
        bundles.extract(path, tmp_path / "out")
    assert sum(item.stat().st_size for item in (tmp_path / "out").iterdir()) <= 2 << 20


def test_a_small_zip_of_a_large_file_that_nothing_names_is_refused(tmp_path):
    """300 MB of zeros in a zip of 0.3 MB were added, and stored once more by each copy."""
    bomb = zipped(("component.toml", BAR), ("zeros", bytes(32 << 20)))
    assert "unpacks to more than 16 MiB, the limit for a zip" in told(bomb, tmp_path / "in")


def test_a_zip_of_a_mesh_of_ordinary_size_is_unpacked(tmp_path):
    """Any text of numbers packs less than the limit allows."""
    text = "".join(f"{n}, {n % 97 * 0.5:.6f}, {n // 97 * 0.5:.6f}\n" for n in range(900_000))
    assert len(text) > bundles.MIN_BUNDLE_BYTES
    folder, _ = unpack(io.BytesIO(zipped(("component.toml", BAR), ("a.inp", text))), tmp_path)
    assert (folder / "a.inp").stat().st_size == len(text)


@pytest.mark.filterwarnings("ignore:Duplicate name")
@pytest.mark.parametrize(
    ("members", "said"),
    [
        ((("component.toml", BAR),) * 2, "The zip holds 2 files 'component.toml'; leave exactly"),
        (
            (("component.toml", BAR), ("a\x1b[2J.inp", "")),
            r"the file name 'a\x1b[2J.inp', which has control characters; rename it",
        ),
    ],
)
def test_a_zip_with_a_name_that_no_folder_has_is_refused_by_it(tmp_path, members, said):
    assert said in told(zipped(*members), tmp_path / "in")


def test_a_component_toml_with_a_byte_order_mark_is_read(tmp_path):
    """Windows' editors write one; the parser refused an invalid statement in line 1."""
    folder, _ = unpack(io.BytesIO(zipped(("component.toml", "\ufeff" + BAR))), tmp_path)
    assert read_bundle(folder).name == "beam"
    bundles.copy_bundle(SimpleNamespace(folder=folder, name="beam"), "two", None, tmp_path / "two")
    assert read_bundle(tmp_path / "two").name == "two"


@pytest.mark.parametrize(
    "text",
    [
        ".".join("a" * 100_000) + " = 1",
        "[" + ".".join("a" * 100_000) + "]",
        " . ".join("ab" * 10_000) + " = 1",
        "x = [" * 20_000,
        "x = {a=" * 20_000,
        "a" * 200_000,
    ],
)
def test_a_component_toml_that_a_parser_chokes_on_is_refused_for_little(tmp_path, text):
    (tmp_path / "component.toml").write_text(text)
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    with pytest.raises(BundleError):
        read_bundle(tmp_path)
    assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before < 200 << 10  # KiB


@pytest.mark.parametrize(
    "lines",
    [
        "*NSET, NSET=A, GENERATE\n1, 60000000",
        "*ELSET, ELSET=A, GENERATE\n1, 99999999999999999999",
        "*NSET, NSET=A\n1\n" + "*NSET, NSET=A\nA, A, A, A, A, A, A, A\n" * 20,
    ],
)
def test_a_set_of_more_members_than_any_mesh_has_is_refused(tmp_path, lines):
    path = tmp_path / "mesh.inp"
    path.write_text(lines)
    with pytest.raises(MeshFileError):
        read_deck(path)


@pytest.mark.parametrize("kind", ["a link", "stored elsewhere", "a mapping"])
def test_a_mesh_that_has_a_file_of_this_machine_read_as_its_own_is_refused(tmp_path, kind):
    elsewhere = tmp_path / "elsewhere.h5"
    with h5py.File(elsewhere, "w") as file:
        file["points"] = np.zeros((4, 3))
    with h5py.File(tmp_path / "mesh.med", "w") as file:
        group = file.create_group("ENS_MAA")
        if kind == "a link":
            group["points"] = h5py.ExternalLink(str(elsewhere), "points")
        elif kind == "stored elsewhere":
            group.create_dataset("points", (4, 3), "f8", external=[(str(elsewhere), 0, 96)])
        else:
            layout = h5py.VirtualLayout((4, 3), "f8")
            layout[:] = h5py.VirtualSource(str(elsewhere), "points", shape=(4, 3))
            group.create_virtual_dataset("points", layout)
    mesh = (tmp_path / "mesh.med").read_bytes()
    archive = zipped(("component.toml", BAR), ("mesh.med", mesh))
    assert '"mesh.med" has parts in other files' in told(archive, tmp_path / "in")


@pytest.mark.parametrize(
    ("kind", "where"),
    [
        ("HDF", "/etc/passwd:/x"),
        ("HDF", "../mesh.h5:/x"),
        ("HDF", "deep/mesh.h5:/x"),
        ("HDF", ":/x"),
        ("Binary", "/etc/passwd"),
        ("Binary", "mesh.bin"),
    ],
)
def test_an_xdmf_mesh_with_numbers_elsewhere_is_refused_before_they_are_read(tmp_path, kind, where):
    item = f'<DataItem Dimensions="4 3" Format="{kind}">{where}</DataItem>'
    (tmp_path / "a.xdmf").write_text(f"<Xdmf><Grid><Geometry>{item}</Geometry></Grid></Xdmf>")
    with pytest.raises(BundleError, match="has its numbers"):
        read_mesh(tmp_path / "a.xdmf", "mm")


def test_an_xdmf_mesh_with_numbers_elsewhere_under_another_element_is_refused(tmp_path):
    item = '<Other Dimensions="4 3" Format="HDF">../mesh.h5:/x</Other>'
    (tmp_path / "a.xdmf").write_text(f"<Xdmf><Grid><Geometry>{item}</Geometry></Grid></Xdmf>")
    with pytest.raises(BundleError, match="has its numbers"):
        read_mesh(tmp_path / "a.xdmf", "mm")


def test_an_xdmf_mesh_with_its_numbers_beside_it_is_read(tmp_path):
    tet = meshio.Mesh(np.vstack([np.zeros(3), np.eye(3)]), [("tetra", np.arange(4)[None])])
    tet.write(tmp_path / "a.xdmf")  # and a.h5
    assert len(read_mesh(tmp_path / "a.xdmf", "mm").points) == 4


def test_a_name_that_no_disk_takes_is_the_bundles_mistake(tmp_path):
    text = BAR.replace('generator = "bar"', f'file = "{"a" * 300}"', 1)
    assert "File name too long" in told(zipped(("component.toml", text)), tmp_path / "in")


@pytest.mark.parametrize("title", ["a\\u0000b", "\\u001b]0;owned\\u0007", "a\\nb", "\\u202Egpj"])
def test_a_title_that_plays_with_a_terminal_or_a_page_is_refused(tmp_path, title):
    text = re.sub(r"(?m)^title = .*$", lambda _: f'title = "{title}"', BAR, count=1)
    assert "title: must be" in told(zipped(("component.toml", text)), tmp_path / "in")


@pytest.mark.parametrize("title", ['"', "\\", "é", "\U0001f4a9", "\U000f0000 for private use"])
def test_a_title_of_any_letters_comes_back_from_the_component_toml_it_is_kept_in(title):
    assert tomllib.loads(f"title = {toml_text(title)}") == {"title": title}


def test_a_title_with_half_a_character_is_no_toml():
    with pytest.raises(ValueError, match="unpaired surrogate"):
        toml_text("half \ud83d")


@pytest.mark.parametrize("size", [5e-5, 0.4, 40.0])
def test_the_picture_of_a_part_of_any_size_has_its_shape(tmp_path, size):
    bar = f'generator = "bar"\nlength = {size}\nwidth = {size / 30}\nheight = {size / 30}\n'
    text = re.sub(r"(?s)\[mesh\].*?\n\[", f"[mesh]\n{bar}cells_along = 10\n[", BAR, count=1)
    (tmp_path / "component.toml").write_text(text)
    (part,) = bundles.surface(tmp_path)
    assert np.ptp(part.arrays["vertices"], axis=0) / size == pytest.approx(
        [1, 1 / 30, 1 / 30], abs=2e-5
    )


def test_the_surface_of_a_part_cannot_be_changed_for_other_callers():
    surface = surface_of(SHIPPED / "bar", "a test")
    assert not any(array.flags.writeable for array in surface.values())


@pytest.fixture
def hostile_check(monkeypatch):
    """Have a function of sandbox/hostile_readers.py in place of the mesh's check."""
    monkeypatch.setenv("PYTHONPATH", str(Path(__file__).parent / "sandbox"))

    def choose(name):
        monkeypatch.setattr(bundles, "CHECKER", f"hostile_readers:{name}")

    return choose


def test_a_check_that_needs_too_much_memory_is_refused_by_that_name(tmp_path, hostile_check):
    hostile_check("greedy")
    with pytest.raises(BundleError, match="needs more than 2048 MiB of memory"):
        check_mesh(tmp_path)


@pytest.mark.parametrize("name", ["stumbling", "modules", "crashing"])
def test_a_check_that_ends_in_a_mistake_of_ours_tells_no_path_of_the_machine(
    tmp_path, hostile_check, name
):
    hostile_check(name)
    with pytest.raises(BundleError, match="stopped") as caught:
        check_mesh(tmp_path)
    assert str(tmp_path) not in str(caught.value)
    assert "Traceback" not in str(caught.value)


def test_a_value_of_numpy_or_with_any_key_is_written_as_toml():
    value = {"a b": [np.float64(1.5), (1, 2)], "": True, "plain": {"text": "x"}}
    read = tomllib.loads(f"value = {toml_value(value)}")["value"]
    assert read == {"a b": [1.5, [1, 2]], "": True, "plain": {"text": "x"}}


@pytest.mark.parametrize("value", [None, {"force": [None]}, np.arange(2)])
def test_a_value_that_toml_does_not_have_is_refused(value):
    with pytest.raises(TypeError, match="is no value of TOML; give a text"):
        toml_value(value)
