"""For all tests: one BLAS thread, no property judged by its time, the longest files first."""

import os
from pathlib import Path

import pytest
from hypothesis import HealthCheck, settings

# As solvers have: more threads only wait for each other on two cores.
for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ.setdefault(name, "1")

# Machines are shared: an example that takes long says nothing of the property.
settings.register_profile("shared", deadline=None, suppress_health_check=[HealthCheck.too_slow])
settings.register_profile(
    "shared-ci", settings.get_profile("shared"), derandomize=True, database=None, print_blob=True
)
settings.load_profile("shared-ci" if os.environ.get("CI") else "shared")

# Files that take half a minute, the longest first: one that begins last leaves the other workers
# of `make test` with nothing to do. They hold few tests, by which xdist would have them last.
LONGEST = (
    "service/page/test_browser.py",
    "acceptance/test_paper.py",
    "acceptance/test_main_job.py",
    "service/engines/test_dask_deaths.py",
    "acceptance/test_nothing_lost.py",
    "acceptance/test_wheel.py",
    "surrogate/test_error_bars.py",
    "surrogate/test_growing.py",
    "fea/solver/test_tangents.py",
    "service/test_report.py",
    "acceptance/test_one_law.py",
    "acceptance/test_backup_under_load.py",
    "service/test_recording_killed.py",
    "acceptance/test_bundles_from_files.py",
    "service/test_umbridge.py",
    "service/test_recording_machine.py",
)
# Folders of which each test starts servers, a browser or a cluster.
STARTING = ("acceptance", "service/engines", "service/page")


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Have the longest files begin first, the others in their order; mark slow ones."""
    place = {Path(__file__).parent / name: place for place, name in enumerate(LONGEST)}
    items.sort(key=lambda item: place.get(item.path, len(place)))
    starting = [Path(__file__).parent / name for name in STARTING]
    for item in items:
        if item.path in place or any(item.path.is_relative_to(folder) for folder in starting):
            item.add_marker(pytest.mark.slow)
