"""``[[material]]``: what is read, and each thing that no material is."""

from dataclasses import replace

import numpy as np

from tests.validation.clamped import attached
from wrenchbook.fea.bundle.read import read_bundle
from wrenchbook.fea.bundle.shipped import SHIPPED
from wrenchbook.fea.bundle.tables import MaterialTable
from wrenchbook.fea.component import build
from wrenchbook.fea.export.calculix import deck_of
from wrenchbook.fea.spec.fingerprint import fingerprint
from wrenchbook.fea.spec.keys import validated

CARBON = {
    "region": "all",
    "law": "orthotropic",
    "youngs_modulus": [135e9, 10e9, 10e9],
    "poisson_ratio": [0.3, 0.3, 0.4],
    "shear_modulus": [5e9, 5e9, 3.5e9],
}


def read(table):
    problems = []
    material = validated(MaterialTable, table, "material[0]", problems)
    return material, [str(one) for one in problems]


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
    parts = {name: getattr(bundle, name) for name in bundle.__dataclass_fields__}
    (plain,) = bundle.materials
    carbon, _ = read(CARBON)
    turned, _ = read(CARBON | {"axes": [[0, 1, 0], [-1, 0, 0], [0, 0, 1]]})
    kinds = [plain, replace(plain, law="neo-hookean"), carbon, turned]
    found = [fingerprint(parts | {"materials": (one,)}) for one in kinds]
    assert len(set(found)) == 4
    assert found[0] == bundle.fingerprint


def test_a_linear_deck_of_rubber_is_elastic_because_calculix_makes_hyperelastic_nonlinear():
    part = build(read_bundle(SHIPPED / "plate_thin"))
    rubber = replace(part.materials[0], law="neo-hookean")
    part = attached(replace(part, materials=(rubber,)), coupling="rigid")
    assert "*HYPERELASTIC, NEO HOOKE" in deck_of(part)
    linear = replace(part, analysis=replace(part.analysis, nonlinear=False))
    assert "*HYPERELASTIC" not in deck_of(linear)
