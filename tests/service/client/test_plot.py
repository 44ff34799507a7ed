"""Figures of tables, clients and deformed parts."""

from __future__ import annotations

import sys
from dataclasses import replace

import numpy as np
import pytest

from tests.service.live import add_table, as_rows, full_wrenches, moved, served
from wrenchbook.service.client import DeformedShape, InvalidArgument, MissingPackage, plot

WRENCHES = full_wrenches(60)


@pytest.fixture(scope="module")
def client(tmp_path_factory):
    with served(tmp_path_factory.mktemp("plot") / "data") as client:
        add_table(client, "rig", as_rows(WRENCHES, moved(WRENCHES)))
        yield client


@pytest.fixture
def pyplot(monkeypatch):
    matplotlib = pytest.importorskip("matplotlib", reason="the extra 'plot' is not installed")
    matplotlib.use("Agg")
    pyplot = pytest.importorskip("matplotlib.pyplot")
    yield pyplot
    pyplot.close("all")


def test_the_band_of_a_response_is_the_answers_error_bars(client, pyplot):
    table = client.download("rig")
    axes = plot.response(table, "fx", "ux", count=11)
    along = np.zeros((11, 6))
    along[:, 0] = np.linspace(-100, 100, 11)
    answers = table.batch(along)
    drawn = np.nanmean([line.get_ydata() for line in axes.lines], axis=0)
    np.testing.assert_allclose(drawn, answers.displacements[:, 0], atol=1e-18)
    edge = axes.collections[0].get_paths()[0].vertices[:, 1]
    np.testing.assert_allclose(
        edge.max(), (answers.displacements + answers.errors)[:, 0].max(), rtol=1e-12
    )
    assert (axes.get_xlabel(), axes.get_ylabel()) == ("fx [N]", "ux [m]")


def test_a_covered_wrench_between_two_others_is_a_marker_on_the_curve(client, pyplot, monkeypatch):
    """It was a line of one point, which draws nothing."""
    table = client.download("rig")
    answers = plot._answers(table, None, None, None, {0: np.linspace(-100, 100, 3)})
    sole = replace(answers, coverage=np.array(["thin", "covered", "thin"]))
    monkeypatch.setattr(plot, "_answers", lambda *_: sole)
    whole, covered = plot.response(table, "fx", "ux", count=3).lines
    assert (whole.get_linestyle(), covered.get_linestyle()) == ("--", "-")
    np.testing.assert_array_equal(whole.get_ydata(), answers.displacements[:, 0])
    assert covered.get_marker() == "."
    assert np.isfinite(covered.get_ydata()).tolist() == [False, True, False]


def test_a_client_and_its_table_draw_the_same_response(client, pyplot):
    _, (left, right) = pyplot.subplots(1, 2)
    plot.response(client.download("rig"), "mz", "rz", count=9, axes=left)
    assert plot.response(client, "mz", "rz", component="rig", count=9, axes=right) is right
    for one, other in zip(left.lines, right.lines, strict=True):
        np.testing.assert_array_equal(one.get_xydata(), other.get_xydata())


def test_a_plot_of_several_interfaces_is_refused_with_what_to_draw_instead(client, pyplot):
    """A client raised KeyError: 'force'."""
    spans = {"range": {"force": [1, 1, 1], "moment": [1, 1, 1]}}
    ends = [{"name": name, **spans} for name in ("left", "right")]
    client.add_component({"name": "ends", "title": "ends", "interface": ends})
    for call in (plot.response, plot.coverage):
        with pytest.raises(InvalidArgument, match=r"ends has several interfaces.*displacements"):
            call(client, "fx", "my" if call is plot.coverage else "ux", component="ends")
    with pytest.raises(InvalidArgument, match="ends has several interfaces"):
        plot.response(client.download("ends"), "fx", "ux")


def test_coverage_of_a_plane_has_the_answers_codes(client, pyplot):
    table = client.download("rig")
    axes = plot.coverage(table, "fx", "my", count=7)
    codes = axes.collections[0].get_array().reshape(7, 7)
    corner = table.answer([-100.0, 0, 0], [0, 10.0, 0])
    assert ("covered", "thin", "outside")[int(codes[6, 0])] == corner.coverage
    assert (axes.get_xlabel(), axes.get_ylabel()) == ("fx [N]", "my [N*m]")


def test_a_deformed_part_is_drawn_displaced_by_a_tenth_of_its_size(pyplot):
    shape = DeformedShape(
        vertices=np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [1, 1, 0]]),
        triangles=np.array([[0, 1, 2], [1, 3, 2]]),
        displacement=np.array([[0.0, 0, 0], [0, 0, 0], [0, 0, 0], [0, 0, -1e-3]]),
        error=None,
        stress=None,
        coverage="covered",
        reason="",
        source="row",
    )
    axes = plot.deformed(shape)
    assert "100 times" in axes.get_title()
    np.testing.assert_allclose(axes.collections[0].get_array(), [0, 1e-3 / 3])


@pytest.mark.parametrize(
    ("draw", "names", "words"),
    [
        (plot.response, ("fx", "ux"), "such as component='plate'"),
        (plot.response, ("ux", "ux", "rig"), "must be one of fx, fy"),
        (plot.response, ("fx", "fx", "rig"), "must be one of ux, uy"),
        (plot.coverage, ("fx", "fx", "rig"), "two different loads"),
    ],
)
def test_what_cannot_be_drawn_is_refused_with_what_can(client, draw, names, words):
    with pytest.raises(ValueError, match=words):
        draw(client, *names[:2], **({"component": names[2]} if names[2:] else {}))


def test_without_matplotlib_the_error_names_the_extra(client, monkeypatch):
    monkeypatch.setitem(sys.modules, "matplotlib.pyplot", None)
    with pytest.raises(MissingPackage, match=r"wrenchbook\[plot\]"):
        plot.response(client, "fx", "ux", component="rig")
