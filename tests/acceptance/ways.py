"""Every way to ask a table, in one table `WAYS`, each asked for all that it says in one form."""

from __future__ import annotations

import asyncio
import pickle
import re
import subprocess
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial
from importlib.util import find_spec
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import orjson

from tests.service.fmu.made import Opened, answers, judged, slopes
from wrenchbook.service.client import (
    Client,
    Displacement,
    Displacements,
    ProblemError,
    Table,
    arrays,
)
from wrenchbook.service.client.async_client import AsyncClient
from wrenchbook.service.client.replies import EXACT, ROUNDED
from wrenchbook.service.contract import COVERAGE
from wrenchbook.service.fmu.export import NotExportableError, make_fmu
from wrenchbook.surrogate.answer import BY_AXES, METHODS
from wrenchbook.surrogate.kernel import build as kernel_build
from wrenchbook.surrogate.kernel.binding import PackedTable
from wrenchbook.surrogate.kernel.format import map_file
from wrenchbook.surrogate.kernel.replies import REPLY_SIZE, Reply, ReplyReader

PARTS = {"table": "interpolation", "mesh": "discretisation", "linearity": "linearity"}
PARTS |= {"measurement": "measurement"}


class Question(NamedTuple):
    """Wrenches (k, n), SI, to ask a table, which answers by its own means where there is None."""

    wrenches: np.ndarray
    tolerance: tuple[float, float] | None = None
    method: str | None = None

    @property
    def how(self) -> dict[str, Any]:
        """What is given beside the wrenches."""
        return {"tolerance": self.tolerance, "method": self.method}


@dataclass
class Said:
    """The answers to k wrenches, SI, NaN where nothing is known; None for what a way has not.

    `held` is whether bars are known to be within the tolerance, which batches say; `within` also
    says (None) where that is not known. `parts` are the parts of errors, by cause.
    """

    outputs: np.ndarray
    coverage: list[str]
    errors: np.ndarray | None = None
    held: list[bool] | None = None
    derivatives: np.ndarray | None = None
    within: list[bool | None] | None = None
    reasons: list[str] | None = None
    methods: list[str | None] | None = None
    sources: list[str | None] | None = None
    parts: list[dict[str, np.ndarray]] | None = None


def bits(numbers: np.ndarray) -> np.ndarray:
    """The bits of numbers; all that are none are the same."""
    return np.where(np.isnan(numbers), np.nan, numbers).astype(float).view(np.uint64)


def assert_same_bits(expected: Said, said: Said) -> None:
    """Compare all that two ways both say."""
    for name, mine in vars(expected).items():
        theirs = getattr(said, name)
        if name == "parts" and theirs is not None:
            for own, other in zip(mine, theirs, strict=True):
                for cause in own.keys() & other.keys():
                    np.testing.assert_array_equal(bits(other[cause]), bits(own[cause]), cause)
        elif mine is None or theirs is None:
            continue
        elif isinstance(mine, np.ndarray):
            np.testing.assert_array_equal(bits(theirs), bits(mine), err_msg=name)
        else:
            assert theirs == mine, name


@dataclass
class Kind:
    """A kind of table, on a server and in the hands of all other callers."""

    name: str
    client: Client
    folder: Path
    others: list[Client]
    """Each of another process of a server on the same data."""
    program: list[str]

    @cached_property
    def table(self) -> Table:
        """Its table, downloaded."""
        return self.client.download(self.name)

    @cached_property
    def path(self) -> Path:
        """Its table in a file."""
        path = self.folder / f"{self.name}.wbt"
        self.table.save(path)
        return path

    @cached_property
    def packed(self) -> PackedTable:
        """Its table as the kernel opens it."""
        return PackedTable.open(self.path)

    @cached_property
    def rows(self) -> np.ndarray:
        """The wrenches of its rows, (r, n), SI."""
        groups = range(len(self.packed.meta["groups"]))
        return np.concatenate([self.packed.arrays[f"g{group}/row/wrench"] for group in groups])

    @cached_property
    def fmu(self) -> Opened | None:
        """Its FMU; None of a table without rows, which has none."""
        try:
            created = make_fmu(self.name, self.packed)
        except NotExportableError:
            return None
        return Opened(created, self.folder / self.name, self.name)

    @property
    def own_methods(self) -> list[str]:
        """The methods that a table of its inputs can have."""
        return [name for name in METHODS if self.packed.space.is_default or name not in BY_AXES]

    def limit(self, asked: Question) -> list[float] | None:
        """The tolerance of each output, m and rad."""
        return asked.tolerance and np.resize(np.repeat(asked.tolerance, 3), self.m).tolist()

    @property
    def m(self) -> int:
        """The number of outputs."""
        return self.packed.outputs

    def loads(self, wrench: np.ndarray) -> dict[str, Any]:
        """A wrench as the client's calls take it."""
        space = self.packed.space
        if space.is_default:
            return {"force": wrench[:3].tolist(), "moment": wrench[3:].tolist()}
        count = 6 * len(space.interfaces)
        blocks = wrench[:count].reshape(-1, 6).tolist()
        names = [item.name for item in space.inputs[count:]]
        given = dict(zip(names, wrench[count:].tolist(), strict=True))
        if not space.several:
            return {"force": blocks[0][:3], "moment": blocks[0][3:], "inputs": given}
        return {"loads": dict(zip(space.several, blocks, strict=True)), "inputs": given}


def by_calls(kind: Kind, results: Sequence[Displacement]) -> Said:
    """What single calls of a client or of a table have said."""
    unknown = np.full(kind.m, np.nan)

    def vector(one: Displacement, name: str) -> np.ndarray:
        parts = [getattr(part, name) for part in one.interfaces.values() or (one,)]
        return unknown if parts[0] is None else np.concatenate(parts).astype(float)

    nothing = np.full((kind.m, kind.packed.inputs), np.nan)
    return Said(
        np.array([vector(result, "vector") for result in results]),
        [result.coverage for result in results],
        np.array([vector(result, "error_vector") for result in results]),
        [result.within_tolerance is True for result in results],
        np.array(
            [nothing if result.derivative is None else result.derivative for result in results]
        ),
        [result.within_tolerance for result in results],
        # A server names the job that it queues, of which tables know nothing.
        [re.sub(r"; job \d+ solves .*$", "", result.reason) for result in results],
        [result.method for result in results],
        [result.source for result in results],
    )


def by_batch(results: Displacements) -> Said:
    """What a batch of a client or of a table has said."""
    held = results.within_tolerance
    return Said(
        results.displacements,
        results.coverage.tolist(),
        results.errors,
        [False] * len(results) if held is None else held.tolist(),
        results.derivatives,
        results.raw.get("within_tolerance"),
    )


def by_replies(kind: Kind, results: Sequence[Reply], derivatives: np.ndarray) -> Said:
    """What replies of the kernel say."""

    def numbers(name: str) -> np.ndarray:
        unknown = (None,) * kind.m
        return np.array([getattr(result, name) or unknown for result in results], dtype=float)

    def reason(one: Reply) -> str:
        start = "" if one.row is None else EXACT if one.exact else ROUNDED
        return f"{start} {one.reason}".strip()

    parts = {cause: numbers(name) for cause, name in PARTS.items()}
    return Said(
        numbers("outputs"),
        [result.coverage for result in results],
        numbers("error"),
        [result.within_tolerance is True for result in results],
        derivatives,
        [result.within_tolerance for result in results],
        [reason(result) for result in results],
        [result.method for result in results],
        [
            result.source if result.row is not None else "table" if result.outputs else None
            for result in results
        ],
        [{cause: part[k] for cause, part in parts.items()} for k in range(len(results))],
    )


def kernel(kind: Kind, asked: Question) -> Said:
    """One wrench after another: what all other ways are compared with."""
    how = kind.limit(asked), asked.method
    result = [kind.packed.answer(wrench, *how) for wrench in asked.wrenches.tolist()]
    slopes_ = [kind.packed.derivative(wrench, *how) for wrench in asked.wrenches]
    return by_replies(kind, result, np.array(slopes_))


def kernel_batch(kind: Kind, asked: Question, threads: int = 1) -> Said:
    how = kind.limit(asked), asked.method, threads
    many = kind.packed.batch(asked.wrenches, *how)
    slopes_ = kind.packed.derivatives(asked.wrenches, *how)
    words = [COVERAGE[code] for code in many.coverage]
    return Said(many.outputs, words, many.errors, derivatives=slopes_)


def ask_c(kind: Kind, asked: Question) -> tuple[bytes, int]:
    """What the C program says of a question, and where its batch begins."""
    k = len(asked.wrenches)
    method = -1 if asked.method is None else METHODS.index(asked.method)
    content = np.array([method, k], dtype=np.int32).tobytes()
    limits = kind.limit(asked) or [np.nan] * kind.m
    content += np.array(limits).tobytes() + asked.wrenches.tobytes()
    ran = subprocess.run([*kind.program, kind.path], input=content, capture_output=True, check=True)
    return ran.stdout, k * (REPLY_SIZE + 8 * kind.m * kind.packed.inputs)


def c_program(kind: Kind, asked: Question) -> Said:
    n, (said, end) = kind.packed.inputs, ask_c(kind, asked)
    each = REPLY_SIZE + 8 * kind.m * n
    results: Any = [said[at : at + REPLY_SIZE] for at in range(0, end, each)]
    tangents = b"".join(said[at + REPLY_SIZE : at + each] for at in range(0, end, each))
    read = ReplyReader(map_file(kind.path), n, kind.m).read
    derivatives = np.frombuffer(tangents).reshape(-1, kind.m, n)
    return by_replies(kind, [read(reply) for reply in results], derivatives)


def c_batch(kind: Kind, asked: Question) -> Said:
    k, n, m = len(asked.wrenches), kind.packed.inputs, kind.m
    said, end = ask_c(kind, asked)
    many = np.frombuffer(said, count=k * m * (2 + n), offset=end)
    outputs, errors, slopes_ = np.split(many, [k * m, 2 * k * m])
    words = [COVERAGE[code] for code in said[-k:]]
    errors, slopes_ = errors.reshape(k, m), slopes_.reshape(k, m, n)
    return Said(outputs.reshape(k, m), words, errors, derivatives=slopes_)


def table(kind: Kind, asked: Question, made: Callable[[Kind], Table]) -> Said:
    own = made(kind)
    calls = [kind.loads(wrench) for wrench in asked.wrenches]
    said = by_calls(kind, [own.answer(**call, **asked.how, derivatives=True) for call in calls])
    parts = (
        [own.error_parts(**call) for call in calls] if asked == (*asked[:1], None, None) else None
    )
    return replace(said, parts=parts and [numbers_of(part) for part in parts])


def numbers_of(parts: dict[str, Any]) -> dict[str, np.ndarray]:
    """The parts of an error that are known."""
    return {cause: np.array(part, float) for cause, part in parts.items() if part is not None}


def table_batch(kind: Kind, asked: Question) -> Said:
    result = kind.table.batch(asked.wrenches, **asked.how, derivatives=True)
    assert result.method == kind.packed.answers_by(asked.method)
    return by_batch(result)


def http(kind: Kind, asked: Question) -> Said:
    """The route itself, asked for all details."""
    results, parts = [], []
    for wrench in asked.wrenches:
        body = body_of(kind, wrench, asked) | {"detail": True, "derivatives": True}
        reply = kind.client.call_json("POST", f"/v1/components/{kind.name}/displacement", body)
        results.append(Displacement.read({"component": kind.name} | reply, wrench))
        own = {cause: one for cause, one in reply.get("error_parts", {}).items() if cause in PARTS}
        parts.append({cause: joined(one) for cause, one in own.items() if one is not None})
    return replace(by_calls(kind, results), parts=parts)


def joined(part: dict[str, Any]) -> np.ndarray:
    """A part of an error, of one interface or by interface, as one vector."""
    blocks = [part] if "translation" in part else list(part.values())
    return np.array(
        [x for block in blocks for x in block["translation"] + block["rotation"]], float
    )


def body_of(kind: Kind, wrench: np.ndarray, asked: Question) -> dict[str, Any]:
    """The body of a query for one wrench."""
    loads, more = kind.loads(wrench), {"on_thin": "estimate"}
    for name, six in loads.get("loads", {}).items():
        loads["loads"][name] = {"force": six[:3], "moment": six[3:]}
    if asked.tolerance:
        more["tolerance"] = dict(zip(("translation", "rotation"), asked.tolerance, strict=True))
    return loads | more | ({"method": asked.method} if asked.method else {})


def client(kind: Kind, asked: Question, derivatives: bool, process: int = -1) -> Said:
    own = kind.client if process < 0 else kind.others[process]
    how = {"on_thin": "estimate", **asked.how, "derivatives": derivatives}
    calls = [kind.loads(wrench) for wrench in asked.wrenches]
    said = by_calls(kind, [own.displacement(kind.name, **call, **how) for call in calls])
    return said if derivatives else replace(said, derivatives=None)


def client_batch(kind: Kind, asked: Question, binary: bool, process: int = -1) -> Said:
    own = kind.client if process < 0 else kind.others[process]
    how = {"on_thin": "estimate", **asked.how, "derivatives": True, "binary": binary}
    result = own.displacements(kind.name, asked.wrenches, **how)
    assert result.method == kind.packed.answers_by(asked.method)
    return by_batch(result)


def async_client(kind: Kind, asked: Question) -> Said:
    how = {"on_thin": "estimate", **asked.how, "derivatives": True}

    async def gathered() -> list[Displacement]:
        async with AsyncClient(kind.client.url, timeout=600) as own:
            calls = [kind.loads(wrench) for wrench in asked.wrenches]
            results = [own.displacement(kind.name, **call, **how) for call in calls]
            return list(await asyncio.gather(*results))

    return by_calls(kind, asyncio.run(gathered()))


def umbridge(kind: Kind, asked: Question) -> Said:
    """UM-Bridge's calls, which refuse an output that is not known whole."""
    expected = kernel(kind, asked)
    said = Said(np.array(expected.outputs), list(expected.coverage))
    said.derivatives = np.array(expected.derivatives)

    def post(call: str, wrench: np.ndarray, **more: Any) -> tuple[Any, dict[str, str]] | None:
        config = body_of(kind, wrench, asked)
        for name in ("force", "moment", "loads", "inputs"):
            config.pop(name, None)
        fields = {"name": kind.name, "input": [wrench.tolist()], "config": config, **more}
        try:
            reply = kind.client.call("POST", f"/umbridge/{call}", orjson.dumps(fields))
        except ProblemError as error:
            if error.body["error"]["type"] != "InvalidOutput":
                raise
            return None
        return orjson.loads(reply.content)["output"], reply.headers

    for k, wrench in enumerate(asked.wrenches):
        if (result := post("Evaluate", wrench)) is None:
            assert np.isnan(expected.outputs[k]).any()
            continue
        (said.outputs[k],), said.coverage[k] = result[0], result[1]["wrenchbook-coverage"]
        for load, direction in enumerate(np.eye(len(wrench)).tolist()):
            along = post("ApplyJacobian", wrench, outWrt=0, inWrt=0, vec=direction)
            if along is None:
                assert np.isnan(expected.derivatives[k]).any()
            else:
                said.derivatives[k, :, load] = along[0]
    return said


def fmu(kind: Kind, asked: Question) -> Said | None:
    if kind.fmu is None or asked.method is not None:
        return None
    with kind.fmu.running(tolerance=asked.tolerance or (0.0, 0.0)) as instance:
        outputs, errors, coverage = answers(instance, asked.wrenches, kind.m)
        within = judged(instance, asked.wrenches, kind.m)
        result = slopes(instance, asked.wrenches, kind.m)
    text, held = [COVERAGE[code] for code in coverage], [item is True for item in within]
    return Said(outputs, text, errors, held, result, within)


def on_arrays(kind: Kind, asked: Question, package: str) -> Said:
    """Arrays of JAX, with float64, or tensors of PyTorch."""
    if package == "jax":
        import jax

        before = jax.config.jax_enable_x64
        jax.config.update("jax_enable_x64", True)
    try:
        own = getattr(arrays, package)(kind.table, asked.method, asked.tolerance)
        result = [np.asarray(item) for item in own(asked.wrenches)]
        slopes_ = np.asarray(own.derivative(asked.wrenches))
    finally:
        if package == "jax":
            jax.config.update("jax_enable_x64", before)
    return Said(result[0], [COVERAGE[code] for code in result[2]], result[1], derivatives=slopes_)


WAYS: dict[str, Callable[[Kind, Question], Said | None]] = {
    "kernel, batch of one thread": kernel_batch,
    "kernel, batch of two threads": partial(kernel_batch, threads=2),
    "C program": c_program,
    "C program, batch": c_batch,
    "downloaded table": partial(table, made=lambda kind: kind.table),
    "opened table": partial(table, made=lambda kind: Table.open(kind.path)),
    "pickled table": partial(
        table, made=lambda kind: pickle.loads(pickle.dumps(Table.open(kind.path)))
    ),
    "table, batch": table_batch,
    "HTTP": http,
    "client": partial(client, derivatives=False),
    "client with derivatives": partial(client, derivatives=True),
    "client, JSON batch": partial(client_batch, binary=False),
    "client, binary batch": partial(client_batch, binary=True),
    "async client": async_client,
    "first of two processes": partial(client, derivatives=True, process=0),
    "second of two processes": partial(client, derivatives=True, process=1),
    "first of two processes, batch": partial(client_batch, binary=True, process=0),
    "second of two processes, batch": partial(client_batch, binary=False, process=1),
    "UM-Bridge": umbridge,
    "FMU": fmu,
    **{
        title: partial(on_arrays, package=package)
        for title, package in (("JAX", "jax"), ("PyTorch", "torch"))
        if find_spec(package)
    },
}
SUMS = ("UM-Bridge", "FMU")
"""Their derivatives are sums over the loads, in which no zero is negative."""


def compiled(compiler: list[str], folder: Path) -> list[str]:
    """The command of the C program ask.c, linked with the library; FMUs have the sources."""
    path, own = folder / "ask", Path(__file__).with_name("ask.c")
    library = kernel_build.ready_library()
    command = [*compiler, "-std=c11", "-Wall", "-Werror", f"-I{kernel_build.FOLDER}"]
    command += ["-o", str(path), str(own), str(library), f"-Wl,-rpath,{library.parent}"]
    subprocess.run(command, check=True)
    return [str(path)]
