"""Damaged files of each form: rows and named mistakes, never an exception, a death or a wait.

WRENCHBOOK_FUZZ=10000, which `make fuzz` sets, reads a hundred times as many: a million of each.
"""

import os
import zlib
from pathlib import Path

import pytest

from wrenchbook.service.sandbox import MIB, Limits, Sandbox

ROOT = Path(__file__).parents[2]
COUNT = 100 * int(os.environ.get("WRENCHBOOK_FUZZ", "3"))
AT_ONCE = 10_000
TABLES = ("csv", "json", "hdf5", "xlsx", "parquet", "tdms", "lvm")
BUNDLES = ("toml", "zip", "inp", "msh", "vtk", "vtu")
LIMITS = Limits(memory=1024 * MIB, seconds=600.0, output=16 * MIB)


@pytest.fixture(scope="module")
def sandbox():
    """A sandbox that finds the tests."""
    with pytest.MonkeyPatch().context() as patched:
        patched.setenv("PYTHONPATH", str(ROOT))
        sandbox = Sandbox()
        yield sandbox
        sandbox.close()


@pytest.mark.timeout(36_000)
@pytest.mark.parametrize("form", TABLES + BUNDLES)
def test_a_damaged_file_comes_to_rows_or_to_named_mistakes(sandbox, form):
    first = zlib.crc32(form.encode())
    for start in range(first, first + COUNT, AT_ONCE):
        asked = {"form": form, "start": start, "count": min(AT_ONCE, COUNT)}
        (reported,) = sandbox.run("tests.fuzz.mutated:fuzzed", None, asked, LIMITS)
        assert reported.fields["mistakes"] == []
