"""Bundles of several interfaces: what is read, what is refused, and what `check` reports."""

import tomllib

import numpy as np
import pytest

from tests.fea.two_interfaces import LINK, rod_between_loads
from wrenchbook.fea.bundle.read import bundle_of, read_bundle
from wrenchbook.fea.check import as_text
from wrenchbook.fea.check import report as check
from wrenchbook.fea.solve import solve
from wrenchbook.fea.spec.problems import BundleError
from wrenchbook.fea.spec.schema import FREEDOMS

RANGE = "range = {force = [20, 20, 200], moment = [5, 5, 5]}"


def write(folder, *changes):
    text = LINK
    for old, new in changes:
        assert old in text
        text = text.replace(old, new)
    (folder / "component.toml").write_text(text)
    return folder


def test_a_link_has_two_interfaces_in_the_order_of_the_file(tmp_path):
    bundle = read_bundle(write(tmp_path))
    assert [one.name for one in bundle.interfaces] == ["left", "right"]
    assert [one.held for one in bundle.interfaces] == [True, False]
    assert bundle.interfaces[0].locked == FREEDOMS
    np.testing.assert_array_equal(bundle.range.high, [0] * 6 + [20, 20, 200, 5, 5, 5])
    np.testing.assert_array_equal(bundle.range.low, -bundle.range.high)


def test_a_link_is_solved_without_supports_relative_to_the_interface_that_is_held(tmp_path):
    found = solve(read_bundle(write(tmp_path)), {"right": [0, 100, 0, 0, 0, 0]})
    assert not found.displacement[:6].any()
    stiffness = 70e9 * 0.02**4 / 12
    assert found.displacement[7] == pytest.approx(100 * 0.4**3 / (3 * stiffness), rel=1e-2)
    assert found.displacement[11] == pytest.approx(100 * 0.4**2 / (2 * stiffness), rel=1e-2)


def test_names_and_what_is_held_change_the_fingerprint(tmp_path):
    own = read_bundle(write(tmp_path)).fingerprint
    renamed = read_bundle(write(tmp_path, ('"right"', '"tip"'))).fingerprint
    supports = ("held = true", RANGE + "\n[supports]\nfixed = ['side']")
    assert len({own, renamed, read_bundle(write(tmp_path, supports)).fingerprint}) == 3


def test_an_interface_that_is_held_in_the_mean_passes_the_check_without_supports(tmp_path):
    report = check(write(tmp_path, ('coupling = "rigid"', 'coupling = "distributed"')))
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
    with pytest.raises(BundleError, match=r"interface\[0\]\.range: missing; write a table"):
        bundle_of(tomllib.loads(measured), tmp_path)
