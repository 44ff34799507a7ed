"""Install the wheel in an empty environment of each Python, run the demo, and POST a wrench.

``make release-check``; ``PYTHONS="python3.12 /opt/python3.14/bin/python3"`` names others.
"""

import json
import os
import shutil
import subprocess
import sys
import tempfile
import urllib.request
from pathlib import Path

PYTHONS = ("python3.11", "python3.12", "python3.13", "python3.14")
BODY = json.dumps({"force": [0, 0, -5], "moment": [0, 0, 0], "on_thin": "wait", "wait_s": 3600})


def check(python: str, wheel: Path, folder: Path) -> str:
    """Return the answers of demo and server in an environment of the wheel and its packages."""
    run = {"check": True, "capture_output": True, "text": True, "cwd": folder}
    subprocess.run([python, "-m", "venv", folder / "env"], **run)
    pip = [folder / "env/bin/python", "-m", "pip", "--disable-pip-version-check", "-q"]
    subprocess.run([*pip, "install", "--only-binary=:all:", f"{wheel}[server]"], **run)
    program = str(folder / "env/bin/wrenchbook")
    demo = json.loads(subprocess.run([program, "demo", "--json"], **run).stdout)
    serve = [program, "serve", "--port", "0", "--data", str(folder / "workspace")]
    server = subprocess.Popen(
        serve, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True, cwd=folder
    )
    try:
        assert server.stdout is not None
        url = f"{server.stdout.readline().split()[-1]}/v1/components/bar/displacement"
        head = {"Content-Type": "application/json"}
        with urllib.request.urlopen(urllib.request.Request(url, BODY.encode(), head)) as reply:
            answer = json.loads(reply.read())
    finally:
        server.terminate()
        server.wait()
    uz = answer["translation"][2]
    return f"demo {demo['rows']} rows in {demo['seconds']:.0f} s; POST u_z = {uz:.4e} m"


def main() -> int:
    """Check each Python of the arguments; return how many are missing or fail."""
    wheel = Path(sys.argv[1]).resolve()
    faults = 0
    for name in sys.argv[2:] or PYTHONS:
        python = shutil.which(name)
        with tempfile.TemporaryDirectory(ignore_cleanup_errors=True) as folder:
            try:
                reported = check(python, wheel, Path(folder)) if python else "not on this machine"
            except subprocess.CalledProcessError as error:
                reported, python = f"FAILED: {error.cmd}\n{error.stderr}", None
        faults += python is None
        print(f"{name}: {reported}", flush=True)
    return faults


if __name__ == "__main__":
    os.environ.pop("PYTHONPATH", None)
    sys.exit(main())
