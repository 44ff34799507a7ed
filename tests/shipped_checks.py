"""Write the shipped components' check.json: interface points, mass, frequency, condensed mass.

A server reads them from there, since it never builds a mesh itself. After a change of a shipped
bundle: python -m tests.shipped_checks
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np

from wrenchbook.fea.bundle.shipped import SHIPPED
from wrenchbook.fea.check.reporting import report
from wrenchbook.service.library.component import CHECK_FILE

DIGITS = 7  # more than a mesh is right to
PLACES = 9  # m, of a point: below them is round-off


def shipped_check(folder: Path) -> dict[str, Any]:
    """Return the parts of a bundle's check that a server reads, with its fingerprint."""
    result = report(folder)
    one = [result["section"]] if "section" in result else []  # a deck has none
    sections = result.get("sections", one)
    return {
        "fingerprint": result["fingerprint"],
        "sections": [
            {"point": np.round(section["point"], PLACES).tolist()} for section in sections
        ],
        "vibration": _rounded(result.get("vibration") or {}),
    }


def _rounded(value: Any) -> Any:
    if isinstance(value, dict):
        return {name: _rounded(own) for name, own in value.items()}
    if isinstance(value, list):
        return [_rounded(own) for own in value]
    return float(f"{value:.{DIGITS}g}") + 0.0 if isinstance(value, float) else value


def main() -> None:
    """Write the files."""
    for folder in sorted(path.parent for path in SHIPPED.glob("*/component.toml")):
        (folder / CHECK_FILE).write_text(json.dumps(shipped_check(folder)) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
