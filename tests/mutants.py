"""Put faults into a copy of the sources, one at a time, and list the test that catches each.

    make mutants [ONLY=calibration] [WORKERS=1]

`mutants.toml` has the faults, and lists of tests, of which the next is run where none of the one
before fails. Faults that no test catches are printed, and the exit status is their number.
"""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
import tempfile
import tomllib
from pathlib import Path

ROOT = Path(__file__).parent.parent
PARTS = ("fea", "service", "surrogate", "src", "tests", "data", "pyproject.toml", "README.md")
WORKERS = ("-n", os.environ.get("WORKERS", "2"))
LIMIT_S = 1800  # a fault may make a loop endless
FAILED = re.compile(r"^(?:FAILED|ERROR) (\S+)", re.MULTILINE)


def run(copy: Path, *command: str) -> subprocess.CompletedProcess[str]:
    """Run Python in the copy, whose packages go before the installed ones."""
    known = {"PYTHONPATH": str(copy / "src"), "OPENBLAS_NUM_THREADS": "1"}
    return subprocess.run(
        [sys.executable, *command],
        cwd=copy,
        env=os.environ | known,
        capture_output=True,
        text=True,
        timeout=LIMIT_S,
        check=False,
    )


def caught_by(copy: Path, file: str, lists: list[str]) -> str:
    """Return the first test that fails in the copy; empty if none does."""
    if file.endswith(".c"):
        built = run(copy, "-m", "wrenchbook.surrogate.kernel.build")
        if built.returncode:
            return "the compiler"
    for tests in lists:
        try:
            ran = run(
                copy, "-m", "pytest", "-qx", *WORKERS, "-p", "no:cacheprovider", *tests.split()
            )
        except subprocess.TimeoutExpired:
            return f"the limit of {LIMIT_S} s"
        result = FAILED.search(ran.stdout)
        if ran.returncode not in (0, 1, 2) or (ran.returncode and not result):
            raise SystemExit(f"pytest did not run:\n{ran.stdout[-3000:]}{ran.stderr[-3000:]}")
        if result:
            return result[1]
    return ""


def main() -> int:
    """Return the number of faults that no test catches."""
    areas, only, missed = tomllib.loads(Path(__file__).with_suffix(".toml").read_text()), "", 0
    only = os.environ.get("ONLY", "")
    with tempfile.TemporaryDirectory() as folder:
        copy = Path(folder)
        for part in PARTS:
            source = ROOT / part
            if source.is_dir():
                shutil.copytree(source, copy / part, symlinks=True)
            else:
                shutil.copy(source, copy / part)
        for name, area in areas.items():
            if only not in name:
                continue
            path = copy / area["file"]
            sound = path.read_text()
            for old, new in area["faults"]:
                if sound.count(old) != 1:
                    raise SystemExit(f"{area['file']} has {sound.count(old)} times: {old}")
                path.write_text(sound.replace(old, new))
                test = caught_by(copy, area["file"], area["tests"])
                missed += not test
                print(f"{name}: {old!r} -> {new!r}: {test or 'NOT CAUGHT'}", flush=True)
            path.write_text(sound)
            if path.suffix == ".c":
                run(copy, "-m", "wrenchbook.surrogate.kernel.build")
    print(f"{missed} not caught")
    return missed


if __name__ == "__main__":
    sys.exit(main())
