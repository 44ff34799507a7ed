"""``python -m data.paper --quick``: the bands hold, and page and JSON are whole."""

import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from scipy.stats import linregress

from data.paper.bar import tip_load
from data.paper.part import QUICK
from data.paper.spring import line_through
from tests.service.live import served

ROOT = Path(__file__).parents[2]


@pytest.fixture(scope="module")
def quick(tmp_path_factory):
    folder = tmp_path_factory.mktemp("paper")
    command = [sys.executable, "-m", "data.paper", str(folder), "--quick"]
    done = subprocess.run(
        command, cwd=ROOT, capture_output=True, text=True, timeout=280, check=False
    )
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout, json.loads((folder / "paper.json").read_text()), folder


@pytest.mark.slow
def test_every_band_holds_and_the_table_says_so(quick):
    printed, body, _ = quick
    assert body["bands"]["missed"] == 0
    assert body["bands"]["held"] >= 15
    assert "FAIL" not in printed


@pytest.mark.slow
def test_the_third_level_of_the_spring_is_the_second(quick):
    levels = quick[1]["parts"]["spring"]["numbers"]["levels"]
    solved, looped = levels["finite elements"], levels["MuJoCo and service"]
    assert looped["shortening_mm"] == pytest.approx(solved["shortening_mm"], rel=1e-6, abs=2e-6)
    for span, line in solved["k_N_per_mm"].items():
        assert looped["k_N_per_mm"][span]["slope"] == pytest.approx(line["slope"], rel=1e-6)
        assert line["error"] > 0.0
    small = looped["k_N_per_mm"]["0 to 2 N"]["slope"]
    assert small == pytest.approx(0.582, abs=0.001)


@pytest.mark.slow
def test_the_arm_is_told_output_by_output_by_both_methods(quick):
    plate = quick[1]["parts"]["arm"]["numbers"]["plate_thin"]
    methods = plate["methods"]
    assert [method["method"] for method in methods.values()] == ["kriging", "griddata"]
    assert all(len(method["rms_over_range"]) == 6 for method in methods.values())
    assert max(methods["default"]["rms_over_range"]) < max(methods["griddata"]["rms_over_range"])


@pytest.mark.slow
def test_the_page_needs_nothing_but_itself(quick):
    page = (quick[2] / "paper.html").read_text()
    assert 'src="http' not in page
    for figure in ("Figure 2", "Figure 8", "Figure 10a", "Figure 10b", "Figure 11", "Figure 12"):
        assert figure in page


def test_the_bands_of_the_bar_hold(tmp_path):
    """The quickest part of the paper's; the others are above."""
    with served(tmp_path, solvers=1) as client:
        findings = tip_load(client, QUICK, lambda *_: None).as_body()["findings"]
    verdicts = [finding["verdict"] for finding in findings]
    assert "pass" in verdicts
    assert "FAIL" not in verdicts


# -- a line through points ------------------------------------------------------------------------


def test_slope_and_standard_error_are_scipys():
    rng = np.random.default_rng(3)
    x = rng.uniform(0, 10, 25)
    y = 0.582 * x + 0.1 + rng.normal(0, 0.05, 25)
    result, expected = line_through(x, y), linregress(x, y)
    assert result.slope == pytest.approx(expected.slope, rel=1e-12)
    assert result.intercept == pytest.approx(expected.intercept, rel=1e-10)
    assert result.error == pytest.approx(expected.stderr, rel=1e-12)


def test_points_on_a_line_have_no_error():
    assert line_through([0, 1, 2, 3], [1, 3, 5, 7]).error < 1e-15


@pytest.mark.parametrize(
    ("x", "y", "told"),
    [
        ([0, 1], [0, 1], "three points"),
        ([1, 1, 1], [0, 1, 2], "same x"),
        ([0, 1, np.nan], [0, 1, 2], "finite"),
    ],
)
def test_points_that_tell_no_line_are_refused(x, y, told):
    with pytest.raises(ValueError, match=told):
        line_through(x, y)
