"""Answers in notebooks: HTML tables and pandas."""

import re
import sys
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

import wrenchbook
from wrenchbook import Displacement, Displacements

BODY = {
    "component": "plate",
    "translation": [1e-6, None, 3e-4],
    "rotation": [0.0, 0.0, 0.0],
    "error": None,
    "coverage": "thin",
    "reason": "axis z <empty> & alone",
}


def batch(count: int) -> Displacements:
    row = [1e-6, 0, 3e-4, 0, 0, 0]
    body = {
        "component": "plate",
        "displacements": [row] * count,
        "errors": [None] * count,
        "coverage": ["thin"] * count,
    }
    return Displacements.read(body, np.arange(6.0 * count).reshape(count, 6))


def test_an_answer_is_a_table_with_units_and_escaped_text():
    shown = Displacement.read(BODY, np.arange(6.0))._repr_html_()
    assert "axis z &lt;empty&gt; &amp; alone" in shown
    assert "<td>fz [N]</td><td>2</td><td>uz [m]</td><td>0.0003</td><td></td>" in shown
    assert shown.count("<tr>") == 7


def test_an_answer_that_is_not_known_yet_is_a_table_without_numbers():
    shown = Displacement.read({"coverage": "outside"}, np.zeros(6))._repr_html_()
    assert "<td>ux [m]</td><td></td><td></td>" in shown


def test_a_batch_shows_its_first_rows_and_how_many_there_are():
    shown = batch(12)._repr_html_()
    assert "plate: 12 answers, the first 10 of 12" in shown
    assert shown.count("<tr>") == 11
    assert "<th>error rz [rad]</th>" in shown


def test_a_batch_becomes_named_columns_with_units(monkeypatch):
    monkeypatch.setitem(sys.modules, "pandas", SimpleNamespace(DataFrame=dict))
    columns = batch(3).to_pandas()
    assert list(columns)[:7] == [*wrenchbook_loads(), "ux [m]"]
    assert columns["fx [N]"].tolist() == [0.0, 6.0, 12.0]
    assert columns["uz [m]"].tolist() == [3e-4] * 3
    assert np.isnan(columns["error ux [m]"]).all()
    assert columns["coverage"].tolist() == ["thin"] * 3


def wrenchbook_loads():
    """The loads' columns of a CSV export."""
    return ["fx [N]", "fy [N]", "fz [N]", "mx [N*m]", "my [N*m]", "mz [N*m]"]


def test_without_pandas_the_error_says_what_to_install(monkeypatch):
    monkeypatch.setitem(sys.modules, "pandas", None)
    with pytest.raises(ImportError, match="pip install pandas") as caught:
        batch(1).to_pandas()
    assert isinstance(caught.value, wrenchbook.WrenchbookError)


@pytest.mark.parametrize(
    ("name", "second"),
    [
        ("InvalidArgument", ValueError),
        ("MissingPackage", ImportError),
        ("MountError", RuntimeError),
        ("CouplingDiverged", RuntimeError),
        ("ProblemError", Exception),
        ("RecorderError", RuntimeError),
        ("SceneError", ValueError),
        ("ServerTimeout", TimeoutError),
        ("TableError", ValueError),
        ("ServerUnreachable", ConnectionError),
    ],
)
def test_each_error_is_one_of_wrenchbook_and_of_the_kind_that_it_was(name, second):
    error = getattr(wrenchbook, name)
    assert issubclass(error, wrenchbook.WrenchbookError)
    assert issubclass(error, second)


def test_a_wrong_wrench_is_an_error_of_wrenchbook():
    with pytest.raises(wrenchbook.WrenchbookError, match="three numbers"):
        wrenchbook.Client("http://127.0.0.1:9").displacement("plate", [1.0, 2.0])


def test_a_file_that_is_no_table_is_an_error_of_wrenchbook(tmp_path):
    (tmp_path / "a.wbt").write_bytes(b"no table")
    with pytest.raises(wrenchbook.TableError, match="not a packed table"):
        wrenchbook.Table.open(tmp_path / "a.wbt")


ROOT = Path(__file__).parents[2]


def test_every_file_of_a_walk_exists():
    text = (ROOT / "service" / "README.md").read_text()
    walks = text.partition("## Request flow")[2].partition("\n## ")[0]
    named = set(re.findall(r"`((?:\w+/)*\w+\.py)`", walks))
    files = [str(file.relative_to(ROOT)) for file in ROOT.glob("*/**/*.py")]
    assert len(named) > 30
    assert [
        name for name in named if not any(f"/{file}".endswith(f"/{name}") for file in files)
    ] == []
