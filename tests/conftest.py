"""For all tests: one BLAS thread, no property judged by its time, the longest files first."""

import os
import secrets
from collections.abc import Iterator
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

# Files of 15 s or more in `make test` or `make test-slow`, the longest first: one that begins last
# leaves the other workers with nothing to do. They hold few tests, by which xdist would have them
# last.
LONGEST = (
    "test_docs.py",
    "service/page/test_views.py",
    "service/page/test_browser.py",
    "surrogate/findings/test_find.py",
    "surrogate/test_error_bars.py",
    "acceptance/test_main_job.py",
    "acceptance/test_nothing_lost.py",
    "acceptance/test_one_law.py",
    "acceptance/test_demo.py",
    "acceptance/test_paper.py",
    "fea/check/test_proposal.py",
    "service/fmu/test_platforms.py",
    "service/test_workers.py",
    "surrogate/test_rig_error.py",
    "surrogate/packed/test_format.py",
    "surrogate/kernel/test_kernel.py",
    "surrogate/kernel/test_replies.py",
    "surrogate/kernel/test_same_bits.py",
    "service/engines/test_conformance.py",
    "service/test_import_findings.py",
    "fea/accuracy/test_accuracy.py",
    "fea/accuracy/test_rounded.py",
    "fea/check/test_deck_springs.py",
    "fea/check/test_load_cases.py",
    "surrogate/kriging/test_inducing.py",
    "surrogate/kriging/test_bars.py",
    "surrogate/test_scatter.py",
    "acceptance/test_mount.py",
    "service/test_kept_component.py",
    "service/test_http_table.py",
    "acceptance/test_wheel.py",
    "service/engines/test_dask_deaths.py",
    "acceptance/test_bundles_from_files.py",
    "fea/deck/test_deck_ccx.py",
    "service/test_http_rows.py",
    "service/test_http_displacement.py",
    "surrogate/test_honesty.py",
    "surrogate/findings/test_clock.py",
    "surrogate/test_composition.py",
    "service/test_http_components.py",
    "service/test_client_async.py",
    "fuzz/test_document.py",
)
MOVER = pytest.StashKey["Mover"]()


def pytest_addoption(parser: pytest.Parser) -> None:
    parser.addoption(
        "--ulp",
        nargs="?",
        type=int,
        const=-1,
        metavar="SEED",
        help="move the numbers of all made-up rows and components by one unit in the last place, "
        "at random; give it behind the paths, or as --ulp=SEED to repeat a run",
    )


def pytest_configure(config: pytest.Config) -> None:
    if config.option.ulp is None:
        return
    if config.option.ulp < 0:
        config.option.ulp = secrets.randbelow(2**31)  # which xdist hands on to its workers
    from tests.ulp import Mover

    mover = Mover(config.option.ulp)
    mover.install()
    config.stash[MOVER] = mover


def pytest_report_header(config: pytest.Config) -> str | None:
    seed = config.option.ulp
    return None if seed is None else f"numbers moved by one ulp: repeat with --ulp={seed}"


@pytest.hookimpl(wrapper=True)
def pytest_runtest_protocol(item: pytest.Item) -> Iterator[None]:
    """Leave the numbers of a test marked `exact` as they are."""
    mover = item.config.stash.get(MOVER, None)
    if mover is None:
        return (yield)
    mover.active = item.get_closest_marker("exact") is None
    try:
        return (yield)
    finally:
        mover.active = True


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Have the longest files begin first, the others in their order."""
    place = {Path(__file__).parent / name: place for place, name in enumerate(LONGEST)}
    items.sort(key=lambda item: place.get(item.path, len(place)))
