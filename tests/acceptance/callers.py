"""Whoever answers from a table, each asked for all that it tells, in the same words."""

from __future__ import annotations

import re
import subprocess
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from tests.service.fmu.made import Opened, answers, judged, slopes
from wrenchbook.service.client import Client, Displacement, Displacements, Table
from wrenchbook.service.client.replies import EXACT, ROUNDED
from wrenchbook.service.contract import COVERAGE
from wrenchbook.surrogate.answer import METHODS
from wrenchbook.surrogate.kernel import build as kernel_build
from wrenchbook.surrogate.kernel.binding import PackedTable
from wrenchbook.surrogate.kernel.format import map_file
from wrenchbook.surrogate.kernel.replies import REPLY_SIZE, Reply, ReplyReader

Limit = tuple[float, float] | None
UNKNOWN = (None,) * 6


class Question(NamedTuple):
    """Wrenches (n, 6), N and N·m, asked of one table, which answers by its own means if None."""

    wrenches: np.ndarray
    tolerance: Limit = None
    method: str | None = None

    @property
    def how(self) -> dict[str, Any]:
        """What is given beside the wrenches."""
        return {"tolerance": self.tolerance, "method": self.method}

    @property
    def limit(self) -> list[float] | None:
        """The tolerance of each output, m and rad."""
        return self.tolerance and [self.tolerance[0]] * 3 + [self.tolerance[1]] * 3


class Said(NamedTuple):
    """What one caller was told of a question: SI, NaN where nothing is; None what it tells nobody.

    `held` is whether bars are known to be within the tolerance, which batches tell; `within` also
    tells (None) where that is not known.
    """

    numbers: np.ndarray
    coverage: list[str]
    held: list[bool]
    derivatives: np.ndarray | None = None
    within: list[bool | None] | None = None
    reasons: list[str] | None = None
    methods: list[str | None] | None = None
    adds: bool = False  # whether derivatives are sums, in which no zero is negative


def bits(numbers: np.ndarray) -> np.ndarray:
    """The bits of numbers; all that are none are the same."""
    return np.where(np.isnan(numbers), np.nan, numbers).astype(float).view(np.uint64)


def assert_same_bits(one: Said, other: Said) -> None:
    """Compare what both were told."""
    if other.adds and one.derivatives is not None:
        one = one._replace(derivatives=one.derivatives + 0.0)
    for name in Said._fields[:-1]:
        mine, theirs = getattr(one, name), getattr(other, name)
        if mine is None or theirs is None:
            continue
        if isinstance(mine, np.ndarray):
            mine, theirs = bits(mine), bits(theirs)
            np.testing.assert_array_equal(theirs, mine, err_msg=name)
        else:
            assert theirs == mine, name


def by_calls(found: Sequence[Displacement]) -> Said:
    """What single calls of the client or of a table have told."""
    numbers = [_numbers(one.vector) + _numbers(one.error_vector) for one in found]
    slopes_ = [np.full((6, 6), np.nan) if x.derivative is None else x.derivative for x in found]
    return Said(
        np.array(numbers),
        [one.coverage for one in found],
        [one.within_tolerance is True for one in found],
        np.array(slopes_),
        [one.within_tolerance for one in found],
        [one.reason for one in found],
        [one.method for one in found],
    )


def by_batch(found: Displacements) -> Said:
    """What a batch of the client or of a table has told."""
    held = found.within_tolerance
    return Said(
        np.hstack((found.displacements, found.errors)),
        found.coverage.tolist(),
        [False] * len(found) if held is None else held.tolist(),
        found.derivatives,
        found.raw.get("within_tolerance"),
    )


def by_replies(found: Sequence[Reply], derivatives: np.ndarray) -> Said:
    """What the kernel's replies say."""
    numbers = [_numbers(one.outputs) + _numbers(one.error) for one in found]
    return Said(
        np.array(numbers),
        [one.coverage for one in found],
        [one.within_tolerance is True for one in found],
        derivatives,
        [one.within_tolerance for one in found],
        [_reason(one) for one in found],
        [one.method for one in found],
    )


def _numbers(values: Any) -> list[float]:
    return [np.nan if value is None else value for value in (UNKNOWN if values is None else values)]


def _reason(found: Reply) -> str:
    if found.row is None:
        return found.reason
    return f"{EXACT if found.exact else ROUNDED} {found.reason}".rstrip()


def told_by_server(client: Client, name: str, asked: Question) -> dict[str, Said]:
    """A server's answers, which are never solves, by each of its calls."""
    how = {"on_thin": "estimate", **asked.how}
    one = [client.displacement(name, wrench, **how) for wrench in asked.wrenches]
    whole = [client.displacement(name, x, **how, derivatives=True) for x in asked.wrenches]
    plain, detailed = _without_jobs(by_calls(one)), _without_jobs(by_calls(whole))
    told = {"single": plain._replace(derivatives=None), "single with derivatives": detailed}
    for form, binary in (("JSON", False), ("binary", True)):
        batch = client.displacements(name, asked.wrenches, **how, derivatives=True, binary=binary)
        told[f"{form} batch"] = by_batch(batch)
    return told


def _without_jobs(said: Said) -> Said:
    """Leave out the job that a server names, of which tables know nothing."""
    assert said.reasons is not None
    return said._replace(reasons=[re.sub(r"; job \d+ solves .*$", "", x) for x in said.reasons])


def told_by_table(table: Table, asked: Question) -> dict[str, Said]:
    """The answers of a table in this process."""
    one = [table.answer(wrench, **asked.how, derivatives=True) for wrench in asked.wrenches]
    whole = table.batch(asked.wrenches, **asked.how, derivatives=True)
    return {"answer": by_calls(one), "batch": by_batch(whole)}


def told_by_kernel(table: PackedTable, asked: Question) -> dict[str, Said]:
    """The answers of the kernel, one by one and all at once, to the wrenches as they are."""
    how = asked.limit, asked.method
    one = [table.answer(wrench, *how) for wrench in asked.wrenches.tolist()]
    slopes_ = np.array([table.derivative(wrench, *how) for wrench in asked.wrenches])
    single = by_replies(one, slopes_)
    told = {"answer": single}
    for threads in (1, 2):
        many = table.batch(asked.wrenches, *how, threads)
        slopes_ = table.derivatives(asked.wrenches, *how, threads)
        words = [COVERAGE[code] for code in many.coverage]
        numbers = np.hstack((many.outputs, many.errors))
        told[f"{threads} threads"] = Said(numbers, words, single.held, slopes_)
    return told


class Program:
    """The C program ask.c, linked with the library; FMUs are compiled with the sources."""

    def __init__(self, compiler: list[str], folder: Path) -> None:
        self.path = folder / "ask"
        own, library = Path(__file__).with_name("ask.c"), kernel_build.ready_library()
        command = [*compiler, "-std=c11", "-Wall", "-Werror", f"-I{kernel_build.FOLDER}"]
        command += ["-o", str(self.path), str(own), str(library), f"-Wl,-rpath,{library.parent}"]
        subprocess.run(command, check=True)

    def told(self, path: Path, asked: Question) -> dict[str, Said]:
        """Its answers from the table in a file."""
        n = len(asked.wrenches)
        method = -1 if asked.method is None else METHODS.index(asked.method)
        content = np.array([method, n], dtype=np.int32).tobytes()
        content += np.array(asked.limit or [np.nan] * 6).tobytes() + asked.wrenches.tobytes()
        ran = subprocess.run([self.path, path], input=content, capture_output=True, check=True)
        each = REPLY_SIZE + 36 * 8
        replies = [ran.stdout[at : at + REPLY_SIZE] for at in range(0, n * each, each)]
        tangents = [ran.stdout[at + REPLY_SIZE : at + each] for at in range(0, n * each, each)]
        read = ReplyReader(map_file(path), 6, 6).read
        found: Any = replies
        derivatives = np.frombuffer(b"".join(tangents)).reshape(n, 6, 6)
        single = by_replies([read(reply) for reply in found], derivatives)
        many = np.frombuffer(ran.stdout, count=48 * n, offset=n * each)
        outputs, errors, slopes_ = np.split(many, [6 * n, 12 * n])
        numbers = np.hstack((outputs.reshape(n, 6), errors.reshape(n, 6)))
        words = [COVERAGE[code] for code in ran.stdout[-n:]]
        batch = Said(numbers, words, single.held, slopes_.reshape(n, 6, 6))
        return {"one by one": single, "all at once": batch}


def told_by_fmu(fmu: Opened, asked: Question) -> dict[str, Said]:
    """The answers of an FMU of the table; a directional derivative is a sum over the loads."""
    with fmu.running(tolerance=asked.tolerance or (0.0, 0.0)) as instance:
        outputs, errors, coverage = answers(instance, asked.wrenches)
        within = judged(instance, asked.wrenches)
        found = slopes(instance, asked.wrenches)
    words = [COVERAGE[code] for code in coverage]
    held = [one is True for one in within]
    return {"FMU": Said(np.hstack((outputs, errors)), words, held, found, within, adds=True)}
