from __future__ import annotations

import subprocess
import sys

SERVER_STACK = (
    "fastapi",
    "starlette",
    "pydantic",
    "uvicorn",
    "orjson",
    "scipy",
    "skfem",
    "meshio",
    "h5py",
    "typer",
    "rich",
    "pint",
    "sqlite3",
    "wrenchbook.fea",
    "wrenchbook.surrogate.build",
)
SHARED = tuple(f"wrenchbook.service.{name}" for name in ("client", "contract", "messages"))


def test_importing_the_client_loads_nothing_of_the_server():
    code = (
        "import sys, wrenchbook.service.client, wrenchbook.service.client.conventions\n"
        f"print([name for name in {SERVER_STACK!r} if name in sys.modules])\n"
        "print(sorted(name for name in sys.modules if name.startswith('wrenchbook.service.')\n"
        f"             and not name.startswith({SHARED!r})))"
    )
    run = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert run.stdout.split("\n")[:2] == ["[]", "[]"]


def test_importing_the_table_files_leaves_pint_for_its_first_use():
    code = "import sys, wrenchbook.service.formats; print('pint' in sys.modules)"
    run = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert run.stdout.strip() == "False"


def test_opening_a_packed_table_loads_numpy_and_the_standard_library_alone():
    code = (
        "import sys, wrenchbook.surrogate.kernel.binding, wrenchbook.surrogate.kernel.format\n"
        "roots = {name.partition('.')[0] for name in sys.modules}\n"
        "print([name for name in ('scipy', 'h5py', 'threadpoolctl') if name in roots])\n"
    )
    run = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert run.stdout.strip() == "[]"
