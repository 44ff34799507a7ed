"""Write a part as stiffness and mass of its frames and modes: ``wrenchbook condense``."""

from __future__ import annotations

import argparse
import json
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from wrenchbook.fea.bundle.read import read_bundle
from wrenchbook.fea.failure import SolveFailed
from wrenchbook.fea.solve import Solver
from wrenchbook.fea.spec.problems import BundleError

_SHOWN = 5  # frequencies that are printed; the file has all


def main(arguments: Sequence[str] | None = None) -> int:
    """Write the file and print its first frequencies; return 1 if the part cannot be condensed."""
    parser = argparse.ArgumentParser(
        prog="wrenchbook condense",
        description="Write stiffness and mass of frames and modes (Craig-Bampton) as npz.",
    )
    add = parser.add_argument
    add("--json", action="store_true", help="one line of JSON instead of text")
    add("--modes", type=int, default=10, help="modes with all frames held (default 10)")
    add("folder", type=Path, help="folder of the component bundle")
    add("out", type=Path, help="the file to write, .npz")
    options = parser.parse_args(arguments)
    if options.out.suffix.lower() != ".npz":
        parser.error(f"{options.out}: the file is an .npz")
    if not options.out.absolute().parent.is_dir():
        parser.error(f"{options.out}: there is no folder {options.out.absolute().parent}")
    try:
        content = vars(Solver(read_bundle(options.folder)).craig_bampton(options.modes))
        with options.out.open("wb") as file:
            np.savez(file, **content)
    except (BundleError, SolveFailed, ValueError, OSError) as error:
        kind, message = type(error).__name__, str(error)
        reply = json.dumps({"error": {"title": kind, "detail": message}})
        print(reply if options.json else message)
        return 1
    first = {name: [float(f"{f:.6g}") for f in content[name][:_SHOWN]] for name in ("free", "held")}
    header = {"file": str(options.out), "frames": list(content["names"]), "modes": options.modes}
    if options.json:
        print(json.dumps(header | first))
        return 0
    print(f"{options.out}: frames {', '.join(content['names'])}; {options.modes} modes")
    print(f"first frequencies with the first frame held: {first['free']} Hz")
    print(f"with all frames held: {first['held']} Hz")
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
