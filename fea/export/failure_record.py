"""What a failed solve leaves in its attempt's folder, for whoever has to find out why."""

from __future__ import annotations

import json
import sys
from pathlib import Path

import numpy as np

from wrenchbook.fea.component import ComponentModel
from wrenchbook.fea.export.vtu import write_state
from wrenchbook.fea.failure import SolveFailed

HISTORY, LAST_STATE = "history.json", "last_state.vtu"


def keep(folder: Path, failure: SolveFailed, component: ComponentModel) -> None:
    """Write the history of a failure and the last converged state.

    ``history.json`` has the failure's kind, message and remedy, the load factor of the last state
    found and that at which the part gives way (null if unknown), and each iteration. The state is
    the undeformed mesh if there was none. What cannot be written is reported on standard error: the
    failure itself matters more.
    """
    factor, nodes = failure.last or (0.0, np.zeros_like(component.mesh.points))
    record = {
        "kind": failure.kind,
        "message": failure.message,
        "remedy": failure.remedy,
        "last_load_factor": factor,
        "critical_load_factor": failure.load_factor,
        "iterations": [dict(zip(_COLUMNS, step, strict=True)) for step in failure.history],
    }
    try:
        (folder / HISTORY).write_text(json.dumps(record, indent=1) + "\n", encoding="utf-8")
        write_state(folder / LAST_STATE, component, nodes)
    except OSError as error:
        print(f"the last state was not kept: {error}", file=sys.stderr)


_COLUMNS = ("load_factor", "iteration", "residual_norm")
