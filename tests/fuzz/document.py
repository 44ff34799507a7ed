"""Calls made up from the OpenAPI document, sent to a real server: no answer may be a surprise.

Each call is sent with values as its schema has them and with some that it has not, for components,
jobs and rows that there are as well as for others. What is looked at is what schemathesis looks at:
no 5xx, no status, content type or body that the document does not say.
"""

from __future__ import annotations

import os
import subprocess
import sys
import zlib
from collections import Counter
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

import hypothesis
import hypothesis.errors
import numpy as np
import schemathesis
from hypothesis import strategies as st
from hypothesis.stateful import run_state_machine_as_test
from schemathesis.checks import CHECKS
from schemathesis.generation import GenerationMode

from tests.service.live import add_table, as_rows, clean_wrenches, full_wrenches, moved
from wrenchbook.service.client import Client
from wrenchbook.service.files.program import child_command

MEMORY = 2 << 30
NAMED = (
    "not_a_server_error",
    "status_code_conformance",
    "content_type_conformance",
    "response_schema_conformance",
)
# It goes on for ever, as it should; and a report is minutes of solving.
LEFT_OUT = {("GET", "/v1/events"), ("POST", "/v1/components/{name}/report")}
KNOWN = ("rig", "plate_thin", "bar", "spring", "nobody")
MADE = set(KNOWN)  # names that calls have answered as well
_OF = "/v1/components/{name}"
_WRENCH = {"force": [3.0, -2.0, 5.0], "moment": [0.5, 0.0, -0.2]}
_A_ROUND = hypothesis.settings(
    max_examples=10,
    stateful_step_count=20,
    deadline=None,
    database=None,
    phases=[hypothesis.Phase.generate],
    suppress_health_check=list(hypothesis.HealthCheck),
)
# Bodies as people send them: what is made up by the schema alone seldom comes to an answer.
REAL: dict[tuple[str, str], Any] = {
    ("POST", f"{_OF}/displacement"): {**_WRENCH, "detail": True, "derivatives": True},
    ("POST", f"{_OF}/displacements"): {"wrenches": [[1, 2, 3, 0, 0, 0]], "on_thin": "estimate"},
    ("POST", f"{_OF}/solve"): {**_WRENCH, "wait_s": 0},
    ("POST", f"{_OF}/fill"): {"budget": 3, "outputs": ["uz", "rx"]},
    ("POST", f"{_OF}/recording"): {"wrenches": [[1, 2, 3, 0, 0, 0], [2, 2, 3, 0, 0, 0]]},
    ("POST", f"{_OF}/envelope"): {"wrenches": [[1, 2, 3, 0, 0, 0], [2, 2, 3, 0, 0, 0]]},
    ("PUT", f"{_OF}/notes"): {"text": "as it stands"},
    ("POST", "/v1/scenes/plan"): {
        "components": {"plate_thin": {"force": [[0, 0], [0, 0], [-9, 9]], "moment": [[0, 0]] * 3}}
    },
}


@contextmanager
def server(folder: Path) -> Iterator[tuple[subprocess.Popen[str], Client]]:
    """Run a server that may take 2 GB of address space, with tables to ask about."""
    texts = child_command(
        "wrenchbook.service.cli.main", "serve", "--data", str(folder), "--port", "0"
    )
    texts += ["--solvers", "0", "--log-level", "warning"]
    limit = f"import os,resource,sys; resource.setrlimit(resource.RLIMIT_AS, ({MEMORY},) * 2); "
    child = subprocess.Popen(
        [sys.executable, "-c", f"{limit} os.execv(sys.argv[1], sys.argv[1:])", *texts],
        stdout=subprocess.PIPE,
        text=True,
        env=os.environ | {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"},
    )
    assert child.stdout is not None
    try:
        address = child.stdout.readline().split()[-1]
        with Client(address, timeout=600) as client:
            wrenches = np.concatenate([clean_wrenches(), full_wrenches(30)])
            add_table(client, "rig", as_rows(wrenches, moved(wrenches)))
            yield child, client
    finally:
        child.terminate()
        child.wait(600)
        child.stdout.close()


def operations(address: str) -> list[Any]:
    """Return the calls of a server's document."""
    schema = schemathesis.openapi.from_url(f"{address}/openapi.json")
    results = [get_all_operation.ok() for get_all_operation in schema.get_all_operations()]
    return [result for result in results if (result.method.upper(), result.path) not in LEFT_OUT]


def fuzz(operation: Any, examples: int, told: Counter[int]) -> None:
    """Send so many calls of one operation; count the statuses of the answers."""
    checks = CHECKS.get_by_names(list(NAMED))
    created = [operation.as_strategy(generation_mode=mode) for mode in GenerationMode]
    names = st.sampled_from(KNOWN)
    real = REAL.get((operation.method.upper(), operation.path))
    numbers = st.sampled_from([1, 2, 3, 2**63, 0])

    @hypothesis.settings(
        max_examples=examples,
        deadline=None,
        database=None,
        derandomize="WRENCHBOOK_FUZZ" not in os.environ,
        suppress_health_check=list(hypothesis.HealthCheck),
    )
    @hypothesis.given(case=st.one_of(created), name=names, number=numbers)
    def send(case: Any, name: str, number: int) -> None:
        for parameter in case.path_parameters or {}:
            case.path_parameters[parameter] = name if parameter == "name" else number
        wait_for_nothing(case)
        if real and case.body is not None and number == 2:
            case.body = real
        response = case.call(timeout=600)
        told[response.status_code] += 1
        if response.status_code == 431:  # a head too long for a server, before any call is known
            return
        case.validate_response(response, checks=checks)

    send()


def follow(address: str, calls: int, told: Counter[int]) -> None:
    """Send sequences of calls, each with what earlier ones answered, as the document links them.

    At least so many calls. The server remembers what earlier sequences did, so that one that is
    sent again may go on otherwise; what was found wrong is kept, and not asked for again.
    """
    wrong: list[Exception] = []
    machine = _machine(address, told, wrong)
    while sum(told.values()) < calls and not wrong:
        with suppress(hypothesis.errors.FlakyStrategyDefinition):
            run_state_machine_as_test(machine, settings=_A_ROUND)
    if wrong:
        raise wrong[0]


def _machine(address: str, told: Counter[int], wrong: list[Exception]) -> Any:
    """Return the sequences of calls that a document has, counted, with what was found wrong."""
    schema = schemathesis.openapi.from_url(f"{address}/openapi.json")
    for method, path in LEFT_OUT:
        schema = schema.exclude(method=method, path=path)
    checks = CHECKS.get_by_names(list(NAMED))

    class Calls(schema.as_state_machine()):
        def before_call(self, case: Any) -> None:
            """Ask about what there is, unless an earlier answer says about what."""
            parameters = case.path_parameters or {}
            if (name := parameters.get("name")) is not None and name not in MADE:
                parameters["name"] = KNOWN[zlib.crc32(str(name).encode()) % len(KNOWN)]
            wait_for_nothing(case)
            real = REAL.get((case.method.upper(), case.operation.path))
            if real and zlib.crc32(repr(case.body).encode()) % 2:
                case.body = real

        def after_call(self, response: Any, case: Any) -> None:
            told[response.status_code] += 1
            if response.status_code == 201 and case.operation.path == "/v1/components":
                MADE.add(response.json()["name"])

        def validate_response(self, response: Any, case: Any, *_: Any, **__: Any) -> None:
            if response.status_code == 431:  # a head too long, before any call is known
                return
            try:
                case.validate_response(response, checks=checks)
            except Exception as error:
                wrong.append(error)
                raise

    return Calls


def wait_for_nothing(case: Any) -> None:
    """Leave no call waiting for a solve: nobody solves here."""
    for said in (case.query, case.body):
        if isinstance(said, dict) and "wait_s" in said:
            said["wait_s"] = 0


def peak(child: subprocess.Popen[str]) -> int:
    """Return the most memory that a process has had, bytes."""
    status = Path(f"/proc/{child.pid}/status").read_text(encoding="ascii")
    line = next(item for item in status.splitlines() if item.startswith("VmHWM"))
    return int(line.split()[1]) << 10
