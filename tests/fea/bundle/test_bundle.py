"""component.toml: every key checked, every mistake told at once."""

import copy
import pickle
import tomllib
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.refusals import GOOD
from wrenchbook.fea.bundle.read import BundleError, BundleProblem, bundle_of, read_bundle

SHIPPED = Path(__file__).parents[3] / "data" / "components"
PLATE = (GOOD / "plate" / "component.toml").read_text("utf-8")


def write(folder, text):
    (folder / "component.toml").write_text(text, encoding="utf-8")
    return folder


def mistakes(folder, text):
    with pytest.raises(BundleError) as caught:
        read_bundle(write(folder, text))
    return {problem.where: problem.message for problem in caught.value.problems}


def changed(old, new, text=PLATE):
    assert text.count(old) == 1, old
    return text.replace(old, new)


def test_every_key_of_a_full_bundle_is_read(tmp_path):
    bundle = read_bundle(write(tmp_path, PLATE))
    assert (bundle.name, bundle.title, bundle.folder) == ("plate", "A plate", tmp_path)
    assert bundle.mesh.generator == "plate"
    assert bundle.mesh.parameters["corner"] == 0.04
    assert bundle.materials[0].youngs_modulus == 70e9
    assert bundle.supports.fixed == ("rim",)
    assert bundle.interface.coupling == "distributed"
    assert bundle.interface.locked == ("ux", "rz")
    np.testing.assert_array_equal(bundle.interface.point, [0, 0, 0.01])
    np.testing.assert_array_equal(bundle.interface.axes, np.eye(3))
    assert bundle.analysis.nonlinear
    assert bundle.analysis.integration == "full"
    np.testing.assert_array_equal(bundle.range.low, [-1000, -1000, -5000, -500, -500, -200])
    np.testing.assert_array_equal(bundle.range.high, [1000, 1000, 100, 500, 500, 200])
    assert (bundle.tolerance.translation, bundle.tolerance.rotation) == (1e-5, 1e-4)
    assert bundle.has_fea


@pytest.mark.parametrize("name", ["bar", "plate", "plate_thin", "spring", "link", "hot_bracket"])
def test_the_shipped_bundles_can_be_read_and_are_named_as_their_folder(name):
    bundle = read_bundle(SHIPPED / name)
    assert bundle.name == name
    assert bundle.has_fea


def test_a_table_only_bundle_needs_a_name_a_title_and_a_range(tmp_path):
    table = {"name": "measured", "title": "M", "range": {"force": [1, 1, 1], "moment": [1, 1, 1]}}
    bundle = bundle_of(table, tmp_path)
    assert not bundle.has_fea
    assert bundle.tolerance is None
    assert set(mistakes(tmp_path, "")) == {"name", "title", "range"}


def test_solver_tables_without_a_mesh_are_mistakes(tmp_path):
    text = PLATE.replace("[mesh]", "[msh]")
    found = mistakes(tmp_path, text)
    assert 'did you mean "mesh"' in found["msh"]
    assert {"material", "supports", "interface", "analysis"} <= set(found)


def test_a_mesh_without_solver_tables_is_a_mistake(tmp_path):
    text = PLATE[: PLATE.index("[[material]]")] + PLATE[PLATE.index("[range]") :]
    found = mistakes(tmp_path, text)
    assert set(found) == {"material", "supports", "interface", "analysis"}


def test_all_mistakes_are_told_at_once(tmp_path):
    text = changed("youngs_modulus = 70e9", "youngs_modulus = -1")
    text = changed('section = "patch"', "section = 7", text)
    text = changed("rotation = 1e-4", 'rotation = "x"\nextra = 1', text)
    assert set(mistakes(tmp_path, text)) == {
        "material[0].youngs_modulus",
        "interface.section",
        "tolerance.rotation",
        "tolerance.extra",
    }


def test_bad_toml_is_named_by_its_line(tmp_path):
    found = mistakes(tmp_path, 'name = "x"\ntitle = \n')
    assert list(found) == ["line 2"]
    assert "TOML" in found["line 2"]
    (tmp_path / "component.toml").write_bytes(b'name = "x"\ntitle = "\xff"\n')
    with pytest.raises(BundleError, match="line 2: is not UTF-8"):
        read_bundle(tmp_path)


@pytest.mark.parametrize("text", ["x = " + 5000 * "9", "x = " + 5000 * "[", "x = 1\nx = 2"])
def test_odd_toml_is_a_mistake_and_not_a_crash(tmp_path, text):
    assert mistakes(tmp_path, text)


def test_a_folder_without_the_file_says_so(tmp_path):
    with pytest.raises(
        BundleError, match=r"component\.toml: cannot be read .*nowhere is no folder"
    ):
        read_bundle(tmp_path / "nowhere")


def test_axes_written_to_a_few_digits_become_exactly_orthonormal(tmp_path):
    text = changed("[[1,0,0],[0,1,0],[0,0,1]]", "[[0.8,0.6,0],[-0.6,0.8000005,0],[0,0,1]]")
    axes = read_bundle(write(tmp_path, text)).interface.axes
    np.testing.assert_allclose(axes @ axes.T, np.eye(3), atol=1e-15)


def test_a_deck_is_read_and_its_file_must_be_there(tmp_path):
    deck = '[deck]\nfile = "p.inp"\ncommand = ["ccx", "{job}"]\n'
    output = 'output = {reader = "calculix-dat", point = "REF", rotation = "ROT"}\n'
    head = 'name = "p"\ntitle = "P"\n[range]\nforce = [1,1,1]\nmoment = [1,1,1]\n'
    assert set(mistakes(tmp_path, head + deck)) == {"deck.file", "deck.output"}
    (tmp_path / "p.inp").write_text("*NODE\n")
    bundle = read_bundle(write(tmp_path, head + deck + output))
    assert bundle.has_fea
    assert bundle.deck.command == ("ccx", "{job}")
    assert bundle.deck.output["point"] == "REF"


def test_the_error_survives_a_pickle():
    error = BundleError([BundleProblem("mesh.file", "is missing")])
    assert pickle.loads(pickle.dumps(error)).problems == error.problems


def places(table, path=()):
    """The path of every value of a parsed file, tables and lists included."""
    for key, value in table.items() if isinstance(table, dict) else enumerate(table):
        yield (*path, key)
        if isinstance(value, dict | list):
            yield from places(value, (*path, key))


VALUES = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=5),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text(max_size=3), inner),
    max_leaves=4,
)


@given(st.sampled_from(list(places(tomllib.loads(PLATE)))), VALUES)
def test_any_value_at_any_place_gives_a_bundle_or_told_mistakes(path, value):
    table = copy.deepcopy(tomllib.loads(PLATE))
    at = table
    for key in path[:-1]:
        at = at[key]
    at[path[-1]] = value
    told = outcome(table)
    assert len(told) == 16 or all(problem.where and problem.message for problem in told)


def outcome(table):
    """The fingerprint, or the mistakes."""
    try:
        return bundle_of(table, SHIPPED).fingerprint
    except BundleError as error:
        return error.problems
