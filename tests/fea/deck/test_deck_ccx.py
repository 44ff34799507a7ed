"""Shipped and written decks, run by CalculiX, against this solver."""

import tomllib
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from tests.fea.calculix import require_ccx
from tests.refusals import cases, changed
from wrenchbook.fea.bundle.read import BundleError, bundle_of, read_bundle
from wrenchbook.fea.check import report
from wrenchbook.fea.component import build
from wrenchbook.fea.export import calculix as inpwriter
from wrenchbook.fea.failure import SolveFailed
from wrenchbook.fea.solve import Solver, solve
from wrenchbook.fea.spec.schema import Deck

FOLDER = Path(__file__).parents[3] / "data" / "components" / "plate_ccx"
CORNER = np.array([1e3, 500, -5e3, 300, -200, 100])
OUTPUT = {"reader": "calculix-dat", "point": "REF", "rotation": "ROT"}


def embedded():
    table = tomllib.loads((FOLDER / "embedded.toml").read_text())
    return bundle_of(table, FOLDER)


BAR = {
    "name": "bar",
    "title": "Slender steel bar",
    "mesh": {
        "generator": "bar", "length": 0.4, "width": 0.02, "height": 0.01,
        "cells_along": 8, "cells_across": 2,
    },
    "material": [{"region": "all", "youngs_modulus": 2e11, "poisson_ratio": 0.3}],
    "supports": {"fixed": ["start"]},
    "interface": {"section": "end", "coupling": "rigid"},
    "analysis": {"nonlinear": False},
    "range": {"force": [100, 100, 100], "moment": [100, 100, 100]},
}  # fmt: skip
BENT = [44.0, -88, 220, 132, 264, -198]


def bar(folder, **changes):
    """A bundle that both solvers take; `changes` are those of its interface."""
    table = {**BAR, "interface": {**BAR["interface"], **changes}}
    return bundle_of(table, folder)


def nonlinear(bundle):
    return replace(bundle, analysis=replace(bundle.analysis, nonlinear=True))


@pytest.fixture(scope="module")
def plate():
    return Solver(embedded())


def written(folder, bundle, **changes):
    """The bundle solved by the deck that is written of it."""
    file = folder / "written.inp"
    file.write_text(inpwriter.deck_of(build(bundle)))
    deck = Deck(file, ("ccx", "{job}"), OUTPUT, timeout=600, moment="conjugate")
    return replace(bundle, deck=replace(deck, **changes))


def gap(result, expected):
    """The largest error of translation and rotation, each over the largest of its kind."""
    apart = np.abs(result - expected).reshape(2, 3).max(axis=1)
    return (apart / np.abs(expected).reshape(2, 3).max(axis=1)).max()


def test_the_shipped_deck_is_what_the_command_writes(capsys):
    assert inpwriter.main([str(FOLDER / "embedded.toml")]) == 0
    there = (FOLDER / "plate.inp").read_text()
    # The comments name the program and its command of the day: the file keeps its fingerprint.
    assert capsys.readouterr().out.splitlines()[2:] == there.splitlines()[2:]
    assert len(there) < 200_000


def test_the_shipped_deck_passes_the_check():
    reported = report(FOLDER)
    assert reported["ok"]
    assert reported["deck"]["moment"] == "conjugate"
    assert reported["has_fea"]


def test_the_deck_and_the_embedded_example_claim_the_same_loads():
    one, other = read_bundle(FOLDER), embedded()
    np.testing.assert_array_equal(one.range.high, other.range.high)
    assert one.tolerance == other.tolerance


def test_a_distributed_coupling_cannot_be_written():
    bundle = embedded()
    bundle = replace(bundle, interface=replace(bundle.interface, coupling="distributed"))
    with pytest.raises(BundleError, match='coupling = "rigid"'):
        inpwriter.deck_of(build(bundle))


def test_the_command_tells_what_is_wrong_with_a_bundle(tmp_path, capsys):
    assert inpwriter.main([str(tmp_path)]) == 1
    assert "component.toml" in capsys.readouterr().err


def test_the_command_writes_the_deck_of_a_file_with_a_mark_of_its_encoding(tmp_path, capsys):
    (tmp_path / "own.toml").write_text((FOLDER / "embedded.toml").read_text(), "utf-8-sig")
    assert inpwriter.main([str(tmp_path / "own.toml")]) == 0
    assert "*STEP" in capsys.readouterr().out


def test_the_command_tells_that_a_file_is_no_text(tmp_path, capsys):
    (tmp_path / "own.toml").write_bytes(b"\xff\xfe\x00")
    assert inpwriter.main([str(tmp_path / "own.toml")]) == 1
    assert "is not UTF-8 text" in capsys.readouterr().err


@pytest.mark.ccx
class TestWithCalculix:
    """What needs the solver."""

    @pytest.fixture(autouse=True)
    def _ccx(self, monkeypatch):
        require_ccx()
        monkeypatch.setenv("OMP_NUM_THREADS", "1")

    def test_the_shipped_deck_agrees_with_the_embedded_solver(self, plate, tmp_path):
        result = solve(read_bundle(FOLDER), CORNER, folder=tmp_path)
        expected = plate.solve(CORNER)
        np.testing.assert_allclose(result.displacement, expected.displacement, rtol=1e-5)
        assert result.unknowns == expected.unknowns
        assert len(list((tmp_path / "deck").iterdir())) == 2

    @pytest.mark.parametrize("load", [1e-9, 1e-3])
    def test_small_loads_keep_their_digits(self, plate, load):
        wrench = [load] * 6
        result = solve(read_bundle(FOLDER), wrench)
        expected = plate.compliance @ wrench
        np.testing.assert_allclose(result.displacement, expected, rtol=2e-6)

    def test_no_load_is_no_displacement(self):
        assert (solve(read_bundle(FOLDER), [0] * 6).displacement == 0).all()

    def test_moments_about_all_axes_agree_at_large_rotation(self, tmp_path):
        """The conjugate moment is found for the spatial one; taken as it is, it is another load."""
        bundle = nonlinear(bar(tmp_path))
        expected = Solver(bundle).solve(BENT).displacement
        assert 15 < np.degrees(np.linalg.norm(expected[3:])) < 20
        result = solve(written(tmp_path, bundle), BENT).displacement
        assert gap(result, expected) < 1e-4
        raw = solve(written(tmp_path, bundle, moment="spatial"), BENT).displacement
        assert gap(raw, expected) > 1e-2

    def test_a_linear_deck_gives_the_whole_compliance(self, tmp_path):
        bundle = bar(tmp_path)
        result = solve(written(tmp_path, bundle), BENT)
        expected = Solver(bundle).solve(BENT)
        np.testing.assert_allclose(result.displacement, expected.displacement, rtol=1e-5)
        size = np.sqrt(np.outer(*2 * [np.diagonal(expected.compliance)]))
        assert (np.abs(result.compliance - expected.compliance) < 1e-5 * size).all()
        assert result.strain_energy == pytest.approx(expected.strain_energy, rel=1e-5)

    def test_a_turned_and_guided_component_is_written_in_its_own_frame(self, tmp_path):
        axes = [[0, 1, 0], [0, 0, 1], [1, 0, 0]]
        bundle = bar(tmp_path, axes=axes, locked=["ux", "rz"])
        result = solve(written(tmp_path, bundle), BENT)
        expected = Solver(bundle).solve(BENT).displacement
        assert expected[0] == expected[5] == 0
        np.testing.assert_allclose(result.displacement, expected, rtol=1e-5)

    def test_an_nlgeom_deck_said_to_be_linear_is_found_out(self, tmp_path):
        bundle = written(tmp_path, nonlinear(bar(tmp_path)))
        analysis = replace(bundle.analysis, nonlinear=False)
        with pytest.raises(SolveFailed, match="not_linear"):
            solve(replace(bundle, analysis=analysis), BENT)

    @cases(__file__, "ccx")
    def test_what_ccx_complains_of_is_a_named_failure(self, tmp_path, case):
        bundle = written(tmp_path, nonlinear(bar(tmp_path)))
        bundle.deck.file.write_text(changed(bundle.deck.file.read_text(), case))
        with pytest.raises(SolveFailed, match=case["words"]) as caught:
            solve(bundle, BENT)
        assert caught.value.kind == case["kind"]

    def test_a_floating_linear_deck_is_a_named_failure(self, tmp_path):
        """CalculiX factorises a singular stiffness and prints what comes out."""
        bundle = written(tmp_path, bar(tmp_path))
        text = bundle.deck.file.read_text()
        bundle.deck.file.write_text(text.replace("FIXED, 1, 3", "FIXED, 3, 3"))
        with pytest.raises(SolveFailed) as caught:
            solve(bundle, BENT)
        assert caught.value.kind in ("not_linear", "not_reciprocal", "rotation_too_large")
