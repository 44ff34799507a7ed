"""One table for the FMUs, and an FMU of it."""

import pytest

from tests.service.fmu.made import opened, solved


@pytest.fixture(scope="module")
def table():
    return solved("plate_thin", 18, 20)


@pytest.fixture(scope="module")
def fmu(table, tmp_path_factory):
    return opened(table, tmp_path_factory.mktemp("fmu"))
