"""Make directory-0.3.tar.xz: a data directory of release 0.3, and a backup of it.

It was run with the code of 0.3: ``cd CHECKOUT && PYTHONPATH=$PWD python THIS_FILE TARGET``.

A component "rig" without finite elements has rows, notes and a demand map; it was renamed to
"bracket". A component "block" is a copy of the shipped bar, with one solved row and the estimate of
its solver's error.
"""

import json
import shutil
import sys
import tarfile
import tempfile
import time
from pathlib import Path

import numpy as np

from wrenchbook.service.ops.backup import back_up
from wrenchbook.service.workers.private import private_server

RIG = {
    "name": "rig",
    "title": "Bracket on rig 3",
    "range": {"force": [900] * 3, "moment": [90] * 3},
}
HEADER = "fx [N],fy [N],fz [N],mx [N*m],my [N*m],mz [N*m],ux [m],uy [m],uz [m]"


def fill(client) -> None:
    """Make the state of the directory by calls of its server."""
    loads = np.random.default_rng(1).uniform(-1, 1, (20, 6)) * ([900] * 3 + [90] * 3)
    rows = np.hstack([loads, 1e-6 * loads[:, :3]]).tolist()
    text = "\n".join([HEADER, *(",".join(map(repr, row)) for row in rows)]).encode()
    client.call("POST", "/v1/components", body(RIG), headers=JSON)
    client.call("POST", "/v1/components/rig/table", text, headers={"content-type": "text/csv"})
    client.call("PUT", "/v1/components/rig/notes", body({"text": "bolts at 20 N m"}), headers=JSON)
    for wrench in ([0, 0, 5000, 0, 0, 0], [0, 0, 5000, 0, 0, 0], [0, 0, -5000, 0, 0, 0]):
        client.displacement("rig", wrench, on_thin="estimate")
    client.call("POST", "/v1/components/rig/rename", body({"name": "bracket"}), headers=JSON)
    client.call(
        "POST", "/v1/components/bar/copy", body({"name": "block", "rows": False}), headers=JSON
    )
    client.solve("block", [10.0, 0, 0, 0, 0, 0], wait_s=300)
    time.sleep(5)  # a second after the last change the server writes the demand map and the tables


def body(fields) -> bytes:
    return json.dumps(fields).encode()


JSON = {"content-type": "application/json"}


def main(target: Path) -> None:
    """Write the archive."""
    with tempfile.TemporaryDirectory() as place:
        folder, backup = Path(place) / "data", Path(place) / "backup-0.3.zip"
        with private_server(folder, 1) as client:
            fill(client)
        for name in ("jobs", "shared", "fields", "reports"):
            shutil.rmtree(folder / name, ignore_errors=True)
        for packed in (folder / "tables").glob("*.wbt"):
            packed.unlink()
        back_up(folder, backup)
        with tarfile.open(target, "w:xz") as archive:
            archive.add(folder, "directory-0.3")
            archive.add(backup, backup.name)


if __name__ == "__main__":
    main(Path(sys.argv[1]))
