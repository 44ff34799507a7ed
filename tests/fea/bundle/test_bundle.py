"""component.toml: every key checked, every mistake told at once."""

import copy
import pickle
import tomllib
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.fea.two_interfaces import LINK, rod_between_loads
from tests.refusals import GOOD
from tests.validation.clamped import attached
from wrenchbook.fea.bundle.fingerprint import fingerprint
from wrenchbook.fea.bundle.read import BundleError, BundleProblem, bundle_of, read_bundle
from wrenchbook.fea.bundle.shipped import SHIPPED
from wrenchbook.fea.bundle.tables import MaterialTable
from wrenchbook.fea.check import as_text
from wrenchbook.fea.check import report as check
from wrenchbook.fea.component import build
from wrenchbook.fea.export.calculix import deck_of
from wrenchbook.fea.spec.keys import validate
from wrenchbook.fea.spec.schema import FREEDOMS

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
    results = mistakes(tmp_path, text)
    assert 'did you mean "mesh"' in results["msh"]
    assert {"material", "supports", "interface", "analysis"} <= set(results)


def test_a_mesh_without_solver_tables_is_a_mistake(tmp_path):
    text = PLATE[: PLATE.index("[[material]]")] + PLATE[PLATE.index("[range]") :]
    results = mistakes(tmp_path, text)
    assert set(results) == {"material", "supports", "interface", "analysis"}


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
    results = mistakes(tmp_path, 'name = "x"\ntitle = \n')
    assert list(results) == ["line 2"]
    assert "TOML" in results["line 2"]
    (tmp_path / "component.toml").write_bytes(b'name = "x"\ntitle = "\xff"\n')
    with pytest.raises(BundleError, match="line 2: is not UTF-8"):
        read_bundle(tmp_path)


@pytest.mark.parametrize("text", ["x = " + 5000 * "9", "x = " + 5000 * "[", "x = 1\nx = 2"])
def test_odd_toml_is_a_mistake_and_not_a_crash(tmp_path, text):
    assert mistakes(tmp_path, text)


def test_an_integer_that_is_too_long_is_named_by_its_line(tmp_path):
    assert list(mistakes(tmp_path, 'name = "x"\nx = ' + 5000 * "9")) == ["line 2"]


def test_a_folder_without_the_file_says_so(tmp_path):
    with pytest.raises(BundleError, match=r"component\.toml: there is no folder .*nowhere; name"):
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
    reported = outcome(table)
    assert len(reported) == 16 or all(problem.where and problem.message for problem in reported)


def outcome(table):
    """The fingerprint, or the mistakes."""
    try:
        return bundle_of(table, SHIPPED).fingerprint
    except BundleError as error:
        return error.problems


RANGE = "range = {force = [20, 20, 200], moment = [5, 5, 5]}"


def written_link(folder, *changes):
    text = LINK
    for old, new in changes:
        assert old in text
        text = text.replace(old, new)
    (folder / "component.toml").write_text(text)
    return folder


def test_a_link_has_two_interfaces_in_the_order_of_the_file(tmp_path):
    bundle = read_bundle(written_link(tmp_path))
    assert [interface.name for interface in bundle.interfaces] == ["left", "right"]
    assert [interface.held for interface in bundle.interfaces] == [True, False]
    assert bundle.interfaces[0].locked == FREEDOMS
    np.testing.assert_array_equal(bundle.range.high, [0] * 6 + [20, 20, 200, 5, 5, 5])
    np.testing.assert_array_equal(bundle.range.low, -bundle.range.high)


def test_names_and_what_is_held_change_the_fingerprint(tmp_path):
    own = read_bundle(written_link(tmp_path)).fingerprint
    renamed = read_bundle(written_link(tmp_path, ('"right"', '"tip"'))).fingerprint
    supports = ("held = true", RANGE + "\n[supports]\nfixed = ['side']")
    assert len({own, renamed, read_bundle(written_link(tmp_path, supports)).fingerprint}) == 3


def test_an_interface_that_is_held_in_the_mean_passes_the_check_without_supports(tmp_path):
    report = check(written_link(tmp_path, ('coupling = "rigid"', 'coupling = "distributed"')))
    assert report["ok"], report["problems"]
    assert report["trial"]["deflection"][:6] == [0.0] * 6
    assert min(report["trial"]["deflection"][6:]) > 0


def test_the_check_of_two_loaded_interfaces_finds_their_stress_error_and_buckling(tmp_path):
    report = check(rod_between_loads(tmp_path))
    assert report["ok"], report["problems"]
    error, strength = report["solver_error"], report["strength"][0]
    assert np.shape(error["mesh"]) == np.shape(error["mesh_stiffness"]) == (12, 12)
    assert len(error["linearity"]) == 12
    assert 1.5 < error["buckling"] < 3
    outer = 5000 / 0.02**2 + 2 * 6 * (0.5 * 20 + 5) / 0.02**3  # Pa, at an edge of the rod
    assert 0.6 * outer < strength["largest"] < outer
    assert "; right force (" in as_text(report)


def test_a_measured_interface_must_have_its_range(tmp_path):
    measured = 'name = "m"\ntitle = "M"\n[[interface]]\nname = "a"\n[[interface]]\nname = "b"\n'
    with pytest.raises(BundleError, match=r"interface\[0\]\.range: is missing; write a table"):
        bundle_of(tomllib.loads(measured), tmp_path)


CARBON = {
    "region": "all",
    "law": "orthotropic",
    "youngs_modulus": [135e9, 10e9, 10e9],
    "poisson_ratio": [0.3, 0.3, 0.4],
    "shear_modulus": [5e9, 5e9, 3.5e9],
}


def read(table):
    problems = []
    material = validate(MaterialTable, table, "material[0]", problems)
    return material, [str(problem) for problem in problems]


def test_nine_constants_and_their_directions_are_read():
    axes = [[0, 1, 0], [-1, 0, 0], [0, 0, 1]]
    material, problems = read(CARBON | {"axes": axes, "density": 1600.0})
    assert problems == []
    assert material.orthotropic.shear_moduli == (5e9, 5e9, 3.5e9)
    np.testing.assert_array_equal(material.orthotropic.axes, axes)
    assert (material.youngs_modulus, material.density) == (135e9, 1600.0)
    assert 0 < material.poisson_ratio < 0.4


def test_without_axes_the_directions_are_the_meshs():
    material, _ = read(CARBON)
    np.testing.assert_array_equal(material.orthotropic.axes, np.eye(3))


def test_a_neo_hookean_material_has_the_two_constants_of_small_strains():
    table = {"region": "all", "law": "neo-hookean", "youngs_modulus": 3e6, "poisson_ratio": 0.4999}
    material, problems = read(table)
    assert problems == []
    assert (material.law, material.poisson_ratio, material.orthotropic) == (
        "neo-hookean",
        0.4999,
        None,
    )


def test_moduli_of_very_different_sizes_are_a_material():
    """Wood, or a honeycomb: 1 : 1000, with the small ratios that go with it."""
    young = [1e6, 1e6, 1e9]
    material, problems = read(
        CARBON
        | {"youngs_modulus": young, "poisson_ratio": [0.3, 1e-4, 1e-4], "shear_modulus": [1e5] * 3}
    )
    assert problems == []
    np.testing.assert_allclose(
        np.diag(np.linalg.inv(material.orthotropic.elasticity))[:3], 1 / np.array(young)
    )


def test_law_and_constants_are_in_the_fingerprint_and_an_isotropic_ones_is_as_it_was():
    bundle = read_bundle(SHIPPED / "bar")
    (plain,) = bundle.materials
    carbon, _ = read(CARBON)
    turned, _ = read(CARBON | {"axes": [[0, 1, 0], [-1, 0, 0], [0, 0, 1]]})
    kinds = [plain, replace(plain, law="neo-hookean"), carbon, turned]
    results = [fingerprint(replace(bundle, materials=(kind,))) for kind in kinds]
    assert len(set(results)) == 4
    assert results[0] == bundle.fingerprint


def test_a_linear_deck_of_rubber_is_elastic_because_calculix_makes_hyperelastic_nonlinear():
    part = build(read_bundle(SHIPPED / "plate_thin"))
    rubber = replace(part.materials[0], law="neo-hookean")
    part = attached(replace(part, materials=(rubber,)), coupling="rigid")
    assert "*HYPERELASTIC, NEO HOOKE" in deck_of(part)
    linear = replace(part, analysis=replace(part.analysis, nonlinear=False))
    assert "*HYPERELASTIC" not in deck_of(linear)
