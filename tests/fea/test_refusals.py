"""Bundles, meshes and deck tables that cannot be solved: each is refused by its key with a reason.

refusals.toml has a section for each bundle in good/, of which its cases are the smallest changes.
"""

import shutil

import pytest

from tests.fea.geometry import draw_bracket
from tests.refusals import GOOD, assert_told, tables
from wrenchbook.fea.bundle.read import read_bundle
from wrenchbook.fea.component import build
from wrenchbook.fea.spec.deck_text import deck_text
from wrenchbook.fea.spec.problems import BundleError, MeshFileError

CASES = [
    pytest.param(good, case, id=name)
    for good, section in tables(__file__).items()
    for name, case in section.items()
]


@pytest.fixture(scope="module")
def bracket(tmp_path_factory):
    return draw_bracket(tmp_path_factory.mktemp("drawn") / "bracket.step")


@pytest.fixture
def bundle(tmp_path, request):
    """Return how to copy a good bundle with changes of its texts and further files."""

    def make(good, change=(), files=()):
        folder = shutil.copytree(GOOD / good, tmp_path / "bundle")
        if good == "bracket":
            shutil.copy(request.getfixturevalue("bracket"), folder)
        for old, new in dict(change).items():
            (path,) = (item for item in (GOOD / good).iterdir() if old in item.read_text("utf-8"))
            text = (folder / path.name).read_text("utf-8")
            assert text.count(old) == 1, old
            (folder / path.name).write_text(text.replace(old, new), "utf-8")
        for name, text in dict(files).items():
            (folder / name).write_text(text)
        return folder

    return make


@pytest.mark.parametrize("good", [path.name for path in GOOD.iterdir()])
def test_the_bundles_that_are_changed_are_good(bundle, good):
    own = read_bundle(bundle(good))
    assert own.deck or build(own).interfaces


@pytest.mark.parametrize(
    ("target", "words"), [("../secret.msh", "outside the bundle"), ("link.msh", "symbolic links")]
)
def test_a_mesh_file_that_is_a_link_astray_is_refused(bundle, target, words):
    folder = bundle("blocks", {'"blocks.msh"': '"link.msh"'})
    (folder.parent / "secret.msh").touch()
    (folder / "link.msh").symlink_to(target)
    with pytest.raises(BundleError, match=rf"mesh\.file: .*{words}"):
        read_bundle(folder)


def test_a_mesh_file_by_an_absolute_path_is_told_its_relative_one(bundle):
    folder = bundle("blocks")
    file = folder / "component.toml"
    file.write_text(file.read_text().replace('"blocks.msh"', f'"{folder}/blocks.msh"'))
    with pytest.raises(BundleError, match=r'blocks\.msh" is an absolute path; .*: "blocks\.msh"$'):
        read_bundle(folder)


def test_an_included_file_that_is_there_twice_or_cannot_be_read_is_refused(tmp_path):
    deck, folder = tmp_path / "deck.inp", tmp_path / "sub"
    folder.mkdir()
    deck.write_text("*INCLUDE, INPUT=sub/a.inc\n")
    (folder / "a.inc").write_text("*INCLUDE, INPUT=b.inc\n")
    for place in (tmp_path, folder):
        (place / "b.inc").write_text("**\n")
    with pytest.raises(MeshFileError, match=r"of which there are two, b\.inc and sub/b\.inc; re"):
        deck_text(deck)
    deck.write_text(f"*INCLUDE, INPUT={'a' * 300}\n")
    with pytest.raises(MeshFileError, match=r'"a+", which cannot be read \(File name too long\)$'):
        deck_text(deck)


@pytest.mark.parametrize(("good", "case"), CASES)
@pytest.mark.filterwarnings("ignore:loadtxt")
def test_a_bundle_is_refused_by_its_key_with_what_to_do(bundle, good, case):
    folder = bundle(good, case["change"], case.get("files", ()))
    with pytest.raises(BundleError) as caught:
        build(read_bundle(folder))
    assert_told(case, [str(problem) for problem in caught.value.problems])


def test_a_list_of_one_interface_has_one_mistake(bundle):
    folder = bundle("plate")
    file = folder / "component.toml"
    text = file.read_text()
    assert text.count("[interface]") == 1
    file.write_text(text.replace("[interface]", "[[interface]]"))
    with pytest.raises(BundleError) as caught:
        read_bundle(folder)
    assert [str(problem.where) for problem in caught.value.problems] == ["interface"]
