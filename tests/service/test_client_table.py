"""Tables in the client's process: the server's answers to the last bit."""

from __future__ import annotations

import pickle
import sys
from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from tests.service.live import (
    FULL,
    add_rows,
    add_table,
    as_rows,
    clean_wrenches,
    full_wrenches,
    moved,
    served,
    tangents,
)
from wrenchbook.service.client import Client, Displacement, Table


@pytest.fixture(scope="module")
def client(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Client]:
    with served(tmp_path_factory.mktemp("workspace")) as client:
        solved, clean = full_wrenches(40), clean_wrenches()
        add_table(client, "solved", as_rows(solved, moved(solved), tangents(solved)))
        add_table(client, "measured", as_rows(clean, moved(clean)))
        measured = np.concatenate([clean, full_wrenches(24)])
        partial = moved(measured)
        partial[:, 4] = np.nan
        partial[::3, 0] = np.nan
        add_table(client, "partial", as_rows(measured, partial))
        offset = moved(measured) + 3e-5
        limit = {"translation": 1e-4, "rotation": 1e-4}
        add_table(client, "offset", as_rows(measured, offset), tolerance=limit)
        spans = client.component("bar")["range"]  # shipped, and linear
        loads = np.array([high for _, high in spans["force"] + spans["moment"]])
        wrench = 0.5 * loads[None]
        compliance = np.diag(1e-4 / loads)[None]
        add_rows(client, "bar", as_rows(wrench, (compliance @ wrench[0]), compliance))
        yield client


def same(here: Displacement, there: Displacement) -> None:
    """All that an answer says is the same, to the last bit."""
    for name in ("translation", "rotation", "error_translation", "error_rotation", "derivative"):
        ours, theirs = getattr(here, name), getattr(there, name)
        assert (ours is None) == (theirs is None), name
        if ours is not None:
            np.testing.assert_array_equal(ours, theirs, err_msg=name)
    for name in ("component", "coverage", "source", "method", "table_version"):
        assert getattr(here, name) == getattr(there, name), name
    assert here.reason == there.reason
    assert here.job is None


def compare(
    client: Client, table: Table, name: str, scale: np.ndarray | float = 1.0, **how: object
) -> None:
    """The table and the server say the same of wrenches on rows, between and beyond them."""
    asked = np.concatenate([full_wrenches(12, 5), clean_wrenches()[:6], 3.0 * full_wrenches(2, 6)])
    asked = asked * scale
    for wrench in asked:
        here = table.answer(wrench, derivatives=True, **how)
        there = client.displacement(
            name, wrench[:3], wrench[3:], on_thin="estimate", derivatives=True, **how
        )
        same(here, there)
    here = table.batch(asked, derivatives=True, **how)
    for binary in (False, True):
        there = client.displacements(
            name, asked, on_thin="estimate", derivatives=True, binary=binary, **how
        )
        for part in ("displacements", "errors", "coverage", "derivatives"):
            np.testing.assert_array_equal(getattr(here, part), getattr(there, part), err_msg=part)
        assert (here.method, here.table_version) == (there.method, there.table_version)


@pytest.mark.parametrize("name", ["solved", "measured", "partial", "offset", "bar"])
def test_a_table_answers_what_the_server_does_to_the_last_bit(client: Client, name: str) -> None:
    table = client.download(name)
    compare(client, table, name)
    told = client.component(name)["coverage"]["method"]
    assert told == {"solved": "kriging", "bar": "linear"}.get(name, told)


@pytest.mark.parametrize("method", ["griddata", "additive", "linear", "kriging"])
def test_by_every_method_too(client: Client, method: str) -> None:
    compare(client, client.download("offset"), "offset", method=method, tolerance=(1e-3, 1e-3))


def test_a_batch_tells_the_method_that_answers_where_the_one_asked_for_is_not_there(
    client: Client,
) -> None:
    """A table of one row has no kriging: batches said that it had answered, single calls not."""
    add_table(client, "lonely", as_rows(full_wrenches(1), moved(full_wrenches(1))))
    table, asked = client.download("lonely"), full_wrenches(3, 5)
    here, there = table.answer(asked[0], method="kriging"), table.batch(asked, method="kriging")
    assert (here.method, there.method) == ("additive", "additive")
    for binary in (False, True):
        how = {"on_thin": "estimate", "method": "kriging", "binary": binary}
        assert client.displacements("lonely", asked, **how).method == "additive"


def guided_rows(client: Client) -> np.ndarray:
    """Give `spring`, of which ux, uy, rx and ry are locked, rows of its two free loads, SI."""
    wrenches = full_wrenches(20, 3) / FULL * [0, 0, 2.0, 0, 0, 0.01]
    slopes = np.zeros((20, 6, 6))
    slopes[:, 2, 2], slopes[:, 5, 5] = 1e-3, 2.0
    add_rows(client, "spring", as_rows(wrenches, (slopes @ wrenches[:, :, None])[:, :, 0], slopes))
    return wrenches


def test_a_download_leaves_out_loads_on_locked_freedoms_as_the_server_does(client: Client) -> None:
    """The server alone did: 10 of 30 answers of a download were outside that it had covered."""
    rows = guided_rows(client)
    table = client.download("spring")
    asked = rows + np.array([0.9, -0.8, 0, 0.005, 0.004, 0])
    here = table.batch(asked)
    np.testing.assert_array_equal(here.displacements, table.batch(rows).displacements)
    assert set(here.coverage) == {"covered"}
    derivative = table.answer(asked[0], derivatives=True).derivative
    assert not derivative[:, [0, 1, 3, 4]].any()
    compare(client, table, "spring", [0.01, 0.01, 0.02, 0.001, 0.001, 0.001])
    parts = table.error_parts(asked[0])
    assert {name: share.tolist() for name, share in parts.items()} == {
        name: share.tolist() for name, share in table.error_parts(rows[0]).items()
    }


@pytest.mark.parametrize("name", ["bar", "partial", "solved"])
def test_an_estimate_beyond_what_tables_may_hold_is_null_in_a_download_too(
    client: Client, name: str
) -> None:
    """The server alone left it out: a download moved a bar by 3e94 m."""
    table = client.download(name)
    compare(client, table, name, 1e7)
    far = 1e7 * full_wrenches(1, 5)[0]
    answer = table.answer(far)
    assert answer.translation is None
    assert answer.error_translation is None
    assert "20 degrees and 10 m" in answer.reason
    assert np.isnan(table.batch(far[None]).displacements).all()


def test_refresh_takes_new_rows_and_withdrawals_and_tells_whether_there_were_any(
    client: Client,
) -> None:
    more = full_wrenches(30, 8)
    add_table(client, "growing", as_rows(more[:20], moved(more[:20]), tangents(more[:20])))
    table = client.download("growing")
    before = table.version
    assert not table.refresh()
    add_rows(client, "growing", as_rows(more[20:], moved(more[20:]), tangents(more[20:])))
    assert table.refresh()
    assert table.version == client.component("growing")["table_version"] > before
    compare(client, table, "growing")
    client.invalidate_row("growing", table.version)
    assert table.refresh()
    assert table.version == client.component("growing")["table_version"]
    assert not table.refresh()
    compare(client, table, "growing")


def test_a_pickled_table_answers_the_same_and_can_be_refreshed(client: Client) -> None:
    table = client.download("solved")
    again = pickle.loads(pickle.dumps(table))
    wrench = full_wrenches(1, 9)[0]
    same(again.answer(wrench), table.answer(wrench))
    assert again.version == table.version
    assert not again.refresh()
    again.close()


def test_a_table_without_rows_says_so_as_the_server_does(client: Client) -> None:
    load_range = {"force": [1.0] * 3, "moment": [1.0] * 3}
    client.add_component({"name": "empty", "title": "empty", "range": load_range})
    table = client.download("empty")
    same(table.answer([1, 2, 3]), client.displacement("empty", [1, 2, 3], on_thin="estimate"))
    assert table.answer([1, 2, 3], derivatives=True).derivative is None


def test_the_derivative_is_the_slope_of_the_answers(client: Client) -> None:
    table = client.download("solved")
    for wrench in full_wrenches(4, 11) * 0.9:
        told = table.answer(wrench, derivatives=True).derivative
        for load, step in enumerate(FULL * 1e-2):
            steps = np.zeros((4, 6))
            steps[:, load] = [-2 * step, -step, step, 2 * step]
            # Of fourth order: steps can be large enough for the values' rounding not to matter.
            slope = [1, -8, 8, -1] @ table.batch(wrench + steps).displacements / (12 * step)
            np.testing.assert_allclose(told[:, load], slope, atol=1e-4 * np.abs(slope).max())


def test_wrong_input_is_refused_before_anything_is_answered(client: Client) -> None:
    table = client.download("solved")
    with pytest.raises(ValueError, match="not finite"):
        table.answer([0, 0, np.nan])
    with pytest.raises(ValueError, match="unknown method"):
        table.answer([0, 0, 1], method="magic")
    with pytest.raises(ValueError, match="a tolerance is"):
        table.answer([0, 0, 1], tolerance={"translation": -1, "rotation": 1})


def test_a_saved_table_opens_without_a_server_and_answers_to_the_last_bit(
    client: Client, tmp_path: Path
) -> None:
    for name in ("solved", "partial", "bar"):
        table = client.download(name)
        path = tmp_path / f"{name}.wbt"
        table.save(path)
        assert path.read_bytes() == client.export_table(name, "packed")
        opened = Table.open(path)
        assert (opened.name, opened.version) == (name, table.version)
        assert opened.tolerance == table.tolerance
        for wrench in full_wrenches(5, 12):
            same(opened.answer(wrench, derivatives=True), table.answer(wrench, derivatives=True))
        here, there = opened.batch(full_wrenches(50, 13)), table.batch(full_wrenches(50, 13))
        np.testing.assert_array_equal(here.displacements, there.displacements)
        np.testing.assert_array_equal(here.errors, there.errors)
        again = pickle.loads(pickle.dumps(opened))
        same(again.answer(FULL / 3), table.answer(FULL / 3))
        opened.save(tmp_path / "copy.wbt")
        assert (tmp_path / "copy.wbt").read_bytes() == path.read_bytes()
        with pytest.raises(ValueError, match=r"is of a file: download the newest version"):
            opened.refresh()
        opened.close()


def test_a_file_that_is_no_packed_table_is_refused_with_its_name(tmp_path: Path) -> None:
    path = tmp_path / "rows.wbt"
    path.write_bytes(b"fx [N]\n")
    with pytest.raises(ValueError, match=r"rows\.wbt: .*not a packed table"):
        Table.open(path)


def test_the_stiffness_is_the_inverse_of_the_derivative(client: Client) -> None:
    table = client.download("solved")
    for wrench in full_wrenches(5, 14):
        derivative = table.answer(wrench, derivatives=True).derivative
        stiffness = table.stiffness(wrench[:3], wrench[3:])
        np.testing.assert_allclose(stiffness @ derivative, np.eye(6), atol=1e-9)
        # A small load more, as the stiffness has it from the displacement that it makes.
        load = 1e-4 * FULL
        change = table.answer(wrench + load).vector - table.answer(wrench).vector
        np.testing.assert_allclose(stiffness @ change, load, rtol=1e-2)


def test_a_stiffness_that_is_not_there_is_refused_with_the_reason(client: Client) -> None:
    guided_rows(client)
    with pytest.raises(ValueError, match="locked freedom"):
        client.download("spring").stiffness([0, 0, 0.1])
    missing = client.download("partial")
    unknown = np.isnan(missing.answer(FULL / 3, derivatives=True).derivative)
    assert unknown[4].all()
    with pytest.raises(ValueError, match="not known"):
        missing.stiffness(FULL / 3)


def test_the_arrays_are_read_only_views_with_the_tables_rows(client: Client) -> None:
    table = client.download("solved")
    arrays = table.arrays()
    assert arrays["space/range"].shape == (2, 6)
    assert len(arrays["g0/row/wrench"]) == 40
    for name, array in arrays.items():
        assert not array.flags.writeable, name
        assert not array.flags.owndata, name
    with pytest.raises(ValueError, match="read-only"):
        arrays["g0/row/moved"][0] = 0.0
    rows = np.lexsort(arrays["g0/row/wrench"].T)
    sent = full_wrenches(40)
    del table  # the views keep the content
    np.testing.assert_array_equal(arrays["g0/row/wrench"][rows], sent[np.lexsort(sent.T)])
    np.testing.assert_array_equal(arrays["g0/row/moved"][rows], moved(sent)[np.lexsort(sent.T)])


def test_a_table_shows_its_name_version_rows_and_method(client: Client) -> None:
    table = client.download("solved")
    assert repr(table) == (
        f"<Table 'solved', version {table.version}: 40 rows, method kriging, "
        "range fx -100 to 100, fy -100 to 100, fz -100 to 100, "
        "mx -10 to 10, my -10 to 10, mz -10 to 10 (N, N·m), "
        f"{len(client.export_table('solved', 'packed')) / 1e6:.3g} MB>"
    )


def test_a_table_is_an_html_table_of_its_range_in_a_notebook(client: Client) -> None:
    shown = client.download("solved")._repr_html_()
    assert "solved, table version" in shown
    assert "<th>mz [N*m]</th>" in shown
    assert "<td>lowest</td><td>-100</td>" in shown


def test_the_rows_of_a_table_become_pandas_columns_with_units(client: Client, monkeypatch) -> None:
    pandas = SimpleNamespace(DataFrame=dict, concat=lambda frames, **_: frames)
    monkeypatch.setitem(sys.modules, "pandas", pandas)
    (rows,) = client.download("solved").to_pandas()
    assert list(rows)[:2] == ["group", "fx [N]"]
    assert list(rows)[-1] == "rz [rad]"
    order = np.lexsort(np.array([rows["fx [N]"]]))
    np.testing.assert_allclose(rows["fx [N]"][order], np.sort(full_wrenches(40)[:, 0]), atol=1e-3)
