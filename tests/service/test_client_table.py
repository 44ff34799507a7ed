"""Tables in the client's process: the server's answers to the last bit."""

from __future__ import annotations

import pickle
import sys
from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from starlette.testclient import TestClient

from tests.service.live import (
    FULL,
    add_rows,
    add_table,
    as_rows,
    full_wrenches,
    moved,
    served,
    tangents,
)
from tests.service.spaces import SPACE, M, N, add_link
from wrenchbook.service.client import Client, Table
from wrenchbook.service.http.app import create_app
from wrenchbook.service.workspace import Settings
from wrenchbook.surrogate.kernel.binding import PackedTable


@pytest.fixture(scope="module")
def client(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Client]:
    with served(tmp_path_factory.mktemp("workspace")) as client:
        solved = full_wrenches(40)
        add_table(client, "solved", as_rows(solved, moved(solved), tangents(solved)))
        partial = moved(solved)
        partial[:, 4] = np.nan
        add_table(client, "partial", as_rows(solved, partial))
        guided, slopes = solved[:20] * [0, 0, 1e-2, 0, 0, 1e-3], np.zeros((20, 6, 6))
        slopes[:, 2, 2], slopes[:, 5, 5] = 1e-3, 2.0
        pushed = np.einsum("kmn,kn->km", slopes, guided)
        add_rows(client, "spring", as_rows(guided, pushed, slopes))
        yield client


@pytest.fixture(scope="module")
def link(tmp_path_factory: pytest.TempPathFactory) -> Table:
    """A table of two interfaces and a temperature."""
    with TestClient(create_app(Settings(tmp_path_factory.mktemp("link"), solvers=0))) as http:
        add_link(http)
        content = http.get("/v1/components/two_ends/table?format=packed").content
    return Table(PackedTable.from_bytes(content))


def test_a_path_in_the_place_of_a_packed_table_is_refused_with_the_call_that_opens_it() -> None:
    with pytest.raises(TypeError, match=r"not a path; use Table.open\('x.wbt'"):
        Table("x.wbt")  # type: ignore[arg-type]


def test_refresh_takes_new_rows_and_withdrawals_and_tells_whether_there_were_any(
    client: Client,
) -> None:
    rows = full_wrenches(30, 8)
    add_table(client, "growing", as_rows(rows[:20], moved(rows[:20]), tangents(rows[:20])))
    table = client.download("growing")
    again, before = pickle.loads(pickle.dumps(table)), table.version
    assert not table.refresh()
    add_rows(client, "growing", as_rows(rows[20:], moved(rows[20:]), tangents(rows[20:])))
    for own in (table, again):
        assert own.refresh()
        assert own.version == client.component("growing", wait_s=60)["table_version"] > before
    client.invalidate_row("growing", table.version)
    assert table.refresh()
    assert not table.refresh()
    there = client.displacement("growing", FULL / 3, on_thin="estimate")
    assert table.answer(FULL / 3).vector.tolist() == there.vector.tolist()
    again.close()


def test_an_answer_beside_a_refresh_names_the_version_that_gave_it(
    client: Client, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The numbers were those of the version before, the version that of the new one."""
    table = client.download("solved")
    old, answer = table.version, PackedTable.answer

    def refreshed(packed: PackedTable, *rest: object) -> object:
        table._now = SimpleNamespace(meta={"provenance": {"version": old + 1}}), None
        return answer(packed, *rest)

    monkeypatch.setattr(PackedTable, "answer", refreshed)
    reply = table.answer(FULL[:3], FULL[3:])
    assert (reply.table_version, table.version) == (old, old + 1)


def test_answers_beside_a_refresh_are_judged_by_the_tolerance_of_their_version(
    client: Client, monkeypatch: pytest.MonkeyPatch
) -> None:
    table, batch = client.download("solved"), PackedTable.batch
    packed = table.packed
    packed.tolerance, packed.bars_are_complete = (1.0, 1.0), True
    newer = SimpleNamespace(space=packed.space, tolerance=(1e-30, 1e-30))

    def refreshed(packed: PackedTable, *options: object) -> object:
        table._now = newer, None
        return batch(packed, *options)

    monkeypatch.setattr(PackedTable, "batch", refreshed)
    reply = table.batch(0.3 * FULL[None])
    assert reply.within_tolerance.all(), reply.errors


def test_a_saved_table_is_the_export_and_cannot_be_refreshed(client: Client, tmp_path: Path):
    table, path = client.download("partial"), tmp_path / "partial.wbt"
    table.save(path)
    assert path.read_bytes() == client.export_table("partial", "packed")
    opened = Table.open(path)
    assert (opened.name, opened.version) == ("partial", table.version)
    with pytest.raises(ValueError, match=r"was opened from .* client\.download\('partial'\)"):
        opened.refresh()


def test_wrong_input_is_refused_before_anything_is_answered(client: Client) -> None:
    table = client.download("solved")
    with pytest.raises(ValueError, match="must be finite"):
        table.answer([0, 0, np.nan])
    with pytest.raises(ValueError, match="unknown method"):
        table.answer([0, 0, 1], method="magic")
    with pytest.raises(ValueError, match="tolerance: translation must be finite and above 0 m"):
        table.answer([0, 0, 1], tolerance={"translation": -1, "rotation": 1})


def test_a_file_that_is_no_packed_table_is_refused_with_its_name(tmp_path: Path) -> None:
    path = tmp_path / "rows.wbt"
    path.write_bytes(b"fx [N]\n")
    with pytest.raises(ValueError, match=r"rows\.wbt: .*not a packed table .*wrenchbook import"):
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
    wrench = [0, 0, 0.1]
    with pytest.raises(ValueError, match="no load moves the locked freedoms"):
        client.download("spring").stiffness(wrench)
    with pytest.raises(ValueError, match=r"the derivative of .* is unknown\. Solve rows near it"):
        client.download("partial").stiffness(wrench)


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


LOADS = {"left": [0.2, 0, 0, 0, 0.1, 0], "right": {"force": [0, -0.3, 0]}}


def test_an_answer_of_several_interfaces_is_by_name_with_its_wrench(link: Table) -> None:
    here = link.answer(loads=LOADS, inputs={"temperature": 0.4})
    assert link.space == SPACE
    assert list(here.interfaces) == ["left", "right"]
    np.testing.assert_array_equal(here.interfaces["right"].wrench, [0, -0.3, 0, 0, 0, 0])
    query = {"loads": LOADS, "inputs": {"temperature": 0.4}}
    slope = link.answer(**query, derivatives=True).derivative
    np.testing.assert_allclose(link.stiffness(**query) @ slope[:, :M], np.eye(M), atol=1e-9)


@pytest.mark.parametrize(
    ("query", "words"),
    [
        ({"force": [0, 0, 1]}, "give loads={'left': WRENCH, 'right': WRENCH}"),
        ({"loads": {"middle": [0] * 6}, "inputs": {"temperature": 0}}, "no such interface"),
        ({"loads": LOADS}, "inputs.temperature: missing; give its value in degC"),
        ({"loads": LOADS, "inputs": {"pressure": 1, "temperature": 0}}, "no such input"),
        ({"loads": LOADS, "inputs": {"temperature": np.nan}}, "finite"),
        ({"force": [0, 0, 1], "loads": LOADS}, "leave force= and moment= out"),
        ({}, r"the call has no load; give force=\[Fx, Fy, Fz\] in N"),
        ({"loads": {"left": [1, 2]}}, r"loads\['left'\]: force must be three numbers"),
        ({"loads": {"left": {"torque": 1}}}, r"loads\['left'\] has the key 'torque'"),
    ],
)
def test_a_query_that_does_not_fit_the_space_is_refused_by_name(link: Table, query, words):
    with pytest.raises(ValueError, match=words):
        link.answer(**query)
    with pytest.raises(ValueError, match=rf"shape \(n, {N}\)"):
        link.batch(np.zeros((2, 6)))


def test_the_columns_of_several_interfaces_have_their_names(link: Table, monkeypatch) -> None:
    pandas = SimpleNamespace(DataFrame=dict, concat=lambda frames, **_: frames[0])
    monkeypatch.setitem(sys.modules, "pandas", pandas)
    frame = link.to_pandas()
    assert list(frame)[1:3] == ["left.fx [N]", "left.fy [N]"]
    assert {"temperature [degC]", "right.rz [rad]"} <= set(frame)
    assert "right.mz" in repr(link)
    assert "temperature [degC]" in link._repr_html_()
