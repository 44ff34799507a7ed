"""Solve a part on finer meshes and keep what its own lacks: ``wrenchbook converge``."""

from __future__ import annotations

import argparse
import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from wrenchbook.fea.accuracy.convergence import studied, write
from wrenchbook.fea.bundle.read import read_bundle
from wrenchbook.fea.failure import SolveFailed
from wrenchbook.fea.spec.problems import BundleError


def main(arguments: Sequence[str] | None = None) -> int:
    """Write the study and print it; return 1 if a mesh cannot be made or solved."""
    parser = argparse.ArgumentParser(prog="python -m wrenchbook.fea.check.converge")
    parser.add_argument("--json", action="store_true")
    parser.add_argument("--finer", type=Path, action="append", default=[])
    parser.add_argument("folder", type=Path)
    options = parser.parse_args(arguments)
    try:
        bundle = read_bundle(options.folder)
        file = write(bundle, studied(bundle, options.finer))
    except (BundleError, SolveFailed, ValueError, OSError, MemoryError) as error:
        kind, message = type(error).__name__, str(error)
        words = json.dumps({"error": {"title": kind, "detail": message}})
        print(words if options.json else message)
        return 1
    found = json.loads(file.read_text(encoding="utf-8"))
    print(json.dumps({"file": str(file)} | found) if options.json else _as_text(file, found))
    return 0


def _as_text(file: Path, found: dict[str, Any]) -> str:
    """Return a line a mesh, the order, and what the component's own mesh lacks of each response."""
    sizes = zip(found["nodes"], found["sizes"], found["values"], strict=True)
    lines = [_line("response, SI", found["outputs"])]
    lines += [
        _line(f"{n} nodes, {1e3 * h:.4g} mm", [f"{one:.6g}" for one in row]) for n, h, row in sizes
    ]
    if len(found["nodes"]) > 2:
        lines.append(_line("order", _known(found["order"], ".2g")))
        lines.append(_line("at cells without size", _known(found["extrapolated"], ".6g")))
    else:
        lines.append("two meshes show no order: give a third by --finer")
    shares = [
        f"{100 * a / b:.2g} %"
        for a, b in zip(found["first_lacks"], found["values"][0], strict=True)
    ]
    lines.append(_line("the first mesh lacks", shares))
    return "\n".join([*lines, f"{file}: error bars of this component take it from here"])


def _known(values: Sequence[float | None], digits: str) -> list[str]:
    return ["none" if one is None else format(one, digits) for one in values]


def _line(first: str, words: Sequence[str]) -> str:
    return f"{first:<26}" + "".join(f"{one:>13}" for one in words)


if __name__ == "__main__":
    raise SystemExit(main())
