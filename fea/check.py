"""Check a bundle in a process of its own: ``python -m fea.check FOLDER``.

Prints one line of JSON and ends with status 0 if the bundle can be solved as far as can be told
without solving, else with 1 and every mistake found.
"""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import Any

from fea.bundle import BundleError, read_bundle
from fea.component import build
from fea.mesh import Mesh


def check(folder: str | Path) -> dict[str, Any]:
    """Read the bundle, build its mesh and resolve its groups.

    Returns
    -------
    dict
        ``{"ok": True, "name", "fingerprint", "has_fea"}`` and for a component with a mesh
        ``"unknowns", "nodes", "cells", "groups"``; or ``{"ok": False, "problems": [...]}``, each
        problem with ``"where"`` and ``"message"``.
    """
    try:
        bundle = read_bundle(folder)
        report = {
            "ok": True,
            "name": bundle.name,
            "fingerprint": bundle.fingerprint,
            "has_fea": bundle.has_fea,
        }
        return report if bundle.mesh is None else report | _counts(build(bundle).mesh)
    except BundleError as error:
        problems = [{"where": each.where, "message": each.message} for each in error.problems]
        return {"ok": False, "problems": problems}


def _counts(mesh: Mesh) -> dict[str, Any]:
    facets = {
        name: sum(len(nodes) for _, nodes in group.blocks)
        for name, group in mesh.facet_groups.items()
    }
    return {
        "unknowns": mesh.unknowns,
        "nodes": len(mesh.points),
        "cells": mesh.cell_counts,
        "groups": {
            "cells": {n: sum(len(part) for part in r) for n, r in mesh.regions.items()},
            "facets": facets,
            "nodes": {name: len(nodes) for name, nodes in mesh.node_groups.items()},
        },
    }


def main(arguments: list[str]) -> int:
    """Print the report on the folder named in `arguments`; return the exit status."""
    if len(arguments) != 1:
        print("usage: python -m fea.check FOLDER", file=sys.stderr)
        return 2
    report = check(arguments[0])
    print(json.dumps(report))
    return 0 if report["ok"] else 1


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
