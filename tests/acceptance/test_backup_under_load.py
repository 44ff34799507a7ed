"""A backup taken while rows come in restores to the answers of one moment of that server."""

import threading

import numpy as np
import orjson

from wrenchbook.service.ops.backup import back_up
from wrenchbook.service.ops.doctor import examine
from wrenchbook.service.ops.restore import restore

RANGE = {"force": [100.0] * 3, "moment": [10.0] * 3}
ROWS, ASKED = 20, [[0.0, 0.0, z, 0.0, 0.0, 0.0] for z in np.linspace(-90, 90, 7).tolist()]


def send_rows(client, first):
    rows = []
    for number in range(first, first + ROWS):
        load = 200.0 * ((number * 0.6180339887) % 1.0) - 100.0
        rows.append(
            {"wrench": [0, 0, load, 0, 0, 0], "displacement": [0, 0, 1e-9 * load**3, 0, 0, 0]}
        )
    return client.import_table("rig", orjson.dumps({"rows": rows}), format="json")


def answers(client):
    """Rows by their content, and what the table answers."""
    client.component("rig")  # waits until the table holds all rows there are
    table = orjson.loads(client.export_table("rig", "json"))
    batch = client.displacements("rig", ASKED, on_thin="estimate")
    rows = [(row["wrench"], row["displacement"]) for row in table["rows"]]
    return rows, batch.displacements.tolist()


def test_a_backup_under_load_restores_to_one_state_and_its_answers(server, tmp_path):
    client, ended, sent = server.start(solvers=0), threading.Event(), []
    client.add_component({"name": "rig", "title": "Rig", "range": RANGE})
    send_rows(client, 0)

    def load():
        while not ended.is_set() and len(sent) < 100:
            sent.append(send_rows(client, ROWS * (1 + len(sent))))

    sender = threading.Thread(target=load)
    sender.start()
    for _ in range(3):
        back_up(tmp_path / "workspace", tmp_path / "rig.backup")  # as `wrenchbook backup` does
    ended.set()
    sender.join(60)
    whole, _ = answers(client)
    server.stop()

    again = tmp_path / "again"
    restore(tmp_path / "rig.backup", again)
    assert [one for one in examine(again) if one.kind == "fault"] == []
    server.folder = again
    rows, answered = answers(server.start(solvers=0))
    assert ROWS <= len(rows) <= len(whole)
    assert len(rows) % ROWS == 0  # an import is there as a whole or not at all
    assert rows == whole[: len(rows)]
    server.stop()

    # The same rows loaded anew answer the same
    server.folder = tmp_path / "anew"
    client = server.start(solvers=0)
    client.add_component({"name": "rig", "title": "Rig", "range": RANGE})
    for first in range(0, len(rows), ROWS):
        send_rows(client, first)
    loaded, told = answers(client)
    assert loaded == rows
    # 1e-12 of the largest displacement, 1e-3 m: that at no load is what rounding leaves of it.
    np.testing.assert_allclose(told, answered, rtol=1e-11, atol=1e-15)
