"""Make a report: ``python -m wrenchbook.service.report FOLDER``; FOLDER has ``order.json``.

Writes ``report.json``, ``report.md`` and ``report.html``, each complete or not at all;
``progress.json`` meanwhile; ``failure.json`` after a failure.
"""

from __future__ import annotations

import json
import sys
import traceback
from dataclasses import asdict
from datetime import UTC, datetime
from pathlib import Path

from wrenchbook.fea.bundle.read import read_bundle
from wrenchbook.fea.failure import SolveFailed
from wrenchbook.service.files.durable import write_atomically
from wrenchbook.service.jobs.attempt import PROGRESS, Progress, write_json
from wrenchbook.service.report import layout
from wrenchbook.service.report.measure import measure
from wrenchbook.service.report.queue import CANCEL, FAILURE, FILES, ORDER
from wrenchbook.surrogate.table.hdf5 import read_table


def main(folder: Path) -> int:
    """Make the report of ``order.json``; return the exit status, 1 after a failure."""

    def progress(fraction: float, message: str) -> None:
        """Write the progress, 0 to 1; exit if the report is cancelled."""
        if (folder / CANCEL).exists():
            sys.exit(1)
        write_json(folder / PROGRESS, asdict(Progress(fraction, message)))

    (folder / FAILURE).unlink(missing_ok=True)
    try:
        order = json.loads((folder / ORDER).read_bytes())
        rows, meta = read_table(order["table"])
        bundle = read_bundle(order["bundle"])
        report = measure(bundle, rows, meta.load_range, order["wrenches"], order["seed"], progress)
        report |= {"summary": layout.summary_of(report), **layout.advice_of(report)}
        report["sections"] = [asdict(section) for section in layout.sections_of(report)]
        report["made"] = datetime.now(UTC).isoformat(timespec="seconds")
        report["table_version"] = meta.last_seq
        texts = {"md": layout.as_markdown(report), "html": layout.as_page(report)}
        for kind, text in texts.items():
            write_atomically(folder / FILES[kind], text.encode(), durable=False)
        write_json(folder / FILES["json"], report, durable=True)
    except Exception as error:
        traceback.print_exc()
        known = isinstance(error, ValueError | SolveFailed)  # their messages have the remedy
        log = f"reports/{folder.name}/log.txt in the data directory"
        message = str(error) if known else f"{type(error).__name__}: {error}; see {log}"
        write_json(folder / FAILURE, {"message": message})
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main(Path(sys.argv[1])))
