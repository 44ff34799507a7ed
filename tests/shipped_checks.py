"""Write the shipped components' check.json: mass, first frequency and condensed mass.

A server reads them from there, since it never builds a mesh itself. After a change of a shipped
bundle: python -m tests.shipped_checks
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from wrenchbook.fea.bundle.shipped import SHIPPED
from wrenchbook.fea.check.reporting import report
from wrenchbook.service.library.component import CHECK_FILE

DIGITS = 7  # more than a mesh is right to


def vibration(folder: Path) -> dict[str, Any]:
    """Return the vibration of a bundle's check with its fingerprint."""
    result = report(folder)
    own = result.get("vibration") or {}
    return {"fingerprint": result["fingerprint"], "vibration": _rounded(own)}


def _rounded(value: Any) -> Any:
    if isinstance(value, dict):
        return {name: _rounded(own) for name, own in value.items()}
    if isinstance(value, list):
        return [_rounded(own) for own in value]
    return float(f"{value:.{DIGITS}g}") + 0.0 if isinstance(value, float) else value


def main() -> None:
    """Write the files."""
    for folder in sorted(path.parent for path in SHIPPED.glob("*/component.toml")):
        (folder / CHECK_FILE).write_text(json.dumps(vibration(folder)) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
