"""The files that requests and the numerics pass: ``python -m tests.walks [-v]``.

A file counts if a Python function of it runs between the first byte of the request and the end of
what follows from it (the reply, the build of a new table, the row of a job), in any thread of a
server in this process. Files that run in an idle server do not count after the reply. The numerics
go from component.toml to a solution, and from 16 solved rows to one answer of the kernel.
"""

from __future__ import annotations

import http.client
import json
import sys
import tempfile
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from types import FrameType
from typing import Any

import numpy as np

from tests.service.live import add_table, served
from tests.until import until
from wrenchbook.fea.bundle.read import read_bundle
from wrenchbook.fea.solve import solve
from wrenchbook.surrogate.build import build
from wrenchbook.surrogate.packed.writer import packed_of
from wrenchbook.surrogate.table.rows import LoadRange, Rows

ROOT = Path(__file__).parents[1]
PACKAGES = tuple(f"{ROOT / name}/" for name in ("service", "surrogate", "fea"))
IDLE_S = 3.0  # every loop of a server runs at least once a second
CSV = "Fz [N],ux [m],uy [m],uz [m],rx [rad],ry [rad],rz [rad]\n" + "".join(
    f"{load},0,0,{load}e-6,0,0,0\n" for load in range(1, 40)
)


class Passed:
    """The files of which functions ran since `clear`, in threads that start after `record`."""

    def __init__(self) -> None:
        self.files: set[str] = set()
        self._known: dict[str, str] = {}

    def record(self) -> None:
        """Have all threads that start from now on note the files of their functions."""
        threading.setprofile(self.note)

    def note(self, frame: FrameType, event: str, _: Any) -> None:
        if event == "call":
            name = frame.f_code.co_filename
            if name not in self._known:
                path = str(Path(name).resolve())
                self._known[name] = path if path.startswith(PACKAGES) else ""
            if path := self._known[name]:
                self.files.add(path)


def post(line: http.client.HTTPConnection, path: str, body: bytes, kind: str) -> None:
    """Send a request on a connection that stays open, and read its reply."""
    line.request("POST", path, body, {"Content-Type": kind})
    reply = line.getresponse()
    text = reply.read()
    assert reply.status < 300, text


def ask(line: http.client.HTTPConnection, component: str, load: float, on_thin: str) -> None:
    """Send a displacement query of one force."""
    query = {"force": [0, 0, load], "moment": [0, 0, 0], "on_thin": on_thin}
    body = json.dumps(query).encode()
    post(line, f"/v1/components/{component}/displacement", body, "application/json")


def packed_files(folder: str) -> set[str]:
    """Return the names of the packed tables of a data directory."""
    return {path.name for path in Path(folder).rglob("*.wbt")}


def walks(solvers: int) -> dict[str, list[str]]:
    """Return the files that each kind of request passes in a server, relative to the root.

    Without solvers a query that is not covered leaves its job waiting; with them it is solved.
    """
    passed, result = Passed(), {}
    passed.record()
    with tempfile.TemporaryDirectory() as folder, served(Path(folder), solvers=solvers) as client:
        rows = [
            {"wrench": [0, 0, z, 0, 0, 0], "displacement": [0, 0, 1e-6 * z, 0, 0, 0]}
            for z in range(30)
        ]
        add_table(client, "rig", rows)
        time.sleep(IDLE_S)
        passed.files = set()
        time.sleep(IDLE_S)
        idle = set(passed.files)

        @contextmanager
        def walk(name: str, component: str) -> Iterator[http.client.HTTPConnection]:
            line = http.client.HTTPConnection(client.url.removeprefix("http://"))
            ask(line, component, 2.5, "estimate")  # a head that the connection has sent before
            tables = packed_files(folder)
            passed.files = set()
            yield line
            files = set(passed.files)
            if name in ("job", "import"):
                until(lambda: packed_files(folder) - tables)  # the new table
                time.sleep(IDLE_S)  # which is mapped, and saved
                files |= passed.files - idle
            result[name] = sorted(str(Path(file).relative_to(ROOT)) for file in files)

        if solvers:
            with walk("job", "plate") as line:
                ask(line, "plate", 321.0, "queue")
        else:
            with walk("covered", "rig") as line:
                ask(line, "rig", 2.5, "estimate")
            with walk("thin", "plate") as line:
                ask(line, "plate", 100.0, "queue")
            with walk("import", "rig") as line:
                path = "/v1/components/rig/table?missing_loads=zero"
                post(line, path, CSV.encode(), "text/csv")
            with walk("download", "rig") as line:
                line.request("GET", "/v1/components/rig/table?format=packed")
                line.getresponse().read()
    threading.setprofile(None)
    return result


def numerics() -> dict[str, list[str]]:
    """Return the files from component.toml to a solution, and from rows to the kernel's answer."""
    passed, result = Passed(), {}

    @contextmanager
    def walk(name: str) -> Iterator[None]:
        passed.files = set()
        sys.setprofile(passed.note)
        yield
        sys.setprofile(None)
        result[name] = sorted(str(Path(file).relative_to(ROOT)) for file in passed.files)

    with walk("solve"):
        bundle = read_bundle(ROOT / "data" / "components" / "plate_thin")
        assert solve(bundle, [0, 0, 200.0, 0, 0, 0]).curvature is not None
    with np.load(ROOT / "tests" / "surrogate" / "tables" / "plate_thin.npz") as file:
        solved = dict(file)
    chosen = slice(int(solved["clean"]), int(solved["clean"]) + 16)
    columns = {"compliance": solved["compliance"][chosen], "source": ["fea"] * 16}
    with walk("answer"):
        rows = Rows.of(solved["wrench"][chosen], solved["displacement"][chosen], **columns)
        table = packed_of(build(rows, LoadRange(solved["low"], solved["high"])))
        assert table.answer([0, 0, 100.0, 0, 0, 0]).method == "kriging"
    return result


if __name__ == "__main__":
    for name, files in (numerics() | walks(0) | walks(1)).items():
        print(f"{name}: {len(files)} files")
        if "-v" in sys.argv:
            print("".join(f"    {file}\n" for file in files), end="")
