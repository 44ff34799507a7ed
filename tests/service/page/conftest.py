"""A browser for the length of these tests, and real servers for it to look at."""

import pytest

from tests.service.page.chromium import Browser
from tests.until import until
from wrenchbook.service.workers.private import private_server


@pytest.fixture(scope="session")
def chromium(tmp_path_factory):
    browser = Browser(tmp_path_factory.mktemp("downloads"))
    yield browser
    browser.close()


@pytest.fixture(scope="module")
def client(tmp_path_factory):
    """A server in a process of its own, with a solver."""
    with private_server(tmp_path_factory.mktemp("page") / "workspace", solvers=1) as client:
        yield client


@pytest.fixture
def browser(chromium, client):
    chromium.begin(client)
    chromium.resize(1280, 900)
    chromium.colours("light")
    yield chromium
    chromium.driver.get("about:blank")  # no page of a test goes on listening
    # No solve of a test changes a table that the next test reads.
    for status in ("waiting", "running"):
        client.call("DELETE", f"/v1/jobs?status={status}")
    until(lambda: not client.call_json("GET", "/health/ready")["pending_rows"])
