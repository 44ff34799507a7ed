"""A backup taken while rows come in restores to the rows of one moment of that server."""

import threading

import orjson

from wrenchbook.service.ops.backup import back_up
from wrenchbook.service.ops.doctor import examine
from wrenchbook.service.ops.restore import restore

RANGE = {"force": [100.0] * 3, "moment": [10.0] * 3}
ROWS = 20


def send_rows(client, first):
    rows = []
    for number in range(first, first + ROWS):
        load = 200.0 * ((number * 0.6180339887) % 1.0) - 100.0
        rows.append(
            {"wrench": [0, 0, load, 0, 0, 0], "displacement": [0, 0, 1e-9 * load**3, 0, 0, 0]}
        )
    return client.import_table("rig", orjson.dumps({"rows": rows}), format="json")


def rows_of(client):
    """Rows by their content; what a table says of its rows is in test_one_law.py."""
    client.component("rig", wait_s=60)  # waits until the table holds all rows there are
    table = orjson.loads(client.export_table("rig", "json"))
    return [(row["wrench"], row["displacement"]) for row in table["rows"]]


def test_a_backup_under_load_restores_to_one_state(server, tmp_path):
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
    sender.join(600)
    whole = rows_of(client)
    server.stop()

    again = tmp_path / "again"
    restore(tmp_path / "rig.backup", again)
    assert [item for item in examine(again) if item.kind == "fault"] == []
    server.folder = again
    rows = rows_of(server.start(solvers=0))
    assert ROWS <= len(rows) <= len(whole)
    assert len(rows) % ROWS == 0  # an import is there as a whole or not at all
    assert rows == whole[: len(rows)]
