"""A server in this process, with a stand-in for finite elements."""

import resource
from pathlib import Path

import pytest
from starlette.testclient import TestClient

import tests.building  # noqa: F401
from tests.service.stub_server import Answer, running_stub
from wrenchbook.service.client import Client
from wrenchbook.service.fields.store import FieldStore
from wrenchbook.service.http.app import create_app
from wrenchbook.service.ledger import Ledger
from wrenchbook.service.workspace import Settings

HERE = Path(__file__).parent
# stand_in.py, the tests, and the sources under test
SOLVERS = ":".join(map(str, (HERE, HERE.parents[1], HERE.parents[1] / "src")))


@pytest.fixture(autouse=True)
def _address_space():
    """Lift the limit that a solver sets which a test runs in this process."""
    limits = resource.getrlimit(resource.RLIMIT_AS)
    yield
    if resource.getrlimit(resource.RLIMIT_AS) != limits:
        resource.setrlimit(resource.RLIMIT_AS, limits)


@pytest.fixture
def stand_in(monkeypatch):
    """Choose the solver of the server's subprocesses, by its name in stand_in.py."""

    def choose(name: str) -> None:
        monkeypatch.setenv("WRENCHBOOK_SOLVE", f"stand_in:{name}")
        monkeypatch.setenv("PYTHONPATH", SOLVERS)

    choose("quick")
    return choose


@pytest.fixture
def folder(tmp_path):
    return tmp_path / "workspace"


@pytest.fixture
def http(folder, stand_in):
    with TestClient(create_app(Settings(folder, solvers=2))) as client:
        yield client


@pytest.fixture
def ledger(tmp_path):
    ledger = Ledger(tmp_path / "ledger.sqlite")
    yield ledger
    ledger.close()


@pytest.fixture
def store(tmp_path):
    return FieldStore(tmp_path / "fields")


@pytest.fixture
def stub():
    """A stub of a server, whose answers a test gives; until then a job that is done."""
    with running_stub() as running:
        running.answers(Answer({"id": 1, "status": "done"}))
        yield running


@pytest.fixture
def client(stub):
    with Client(stub.url, timeout=600) as created:
        yield created
