"""Tables, their FMUs, and instances of them through FMPy."""

from __future__ import annotations

import os
import shutil
import sys
from contextlib import contextmanager
from pathlib import Path

import fmpy
import numpy as np
import pytest
from fmpy.fmi2 import FMU2Model, FMU2Slave

from wrenchbook.service.fmu.export import Fmu, make_fmu
from wrenchbook.surrogate.build import Table, build
from wrenchbook.surrogate.kernel.binding import PackedTable
from wrenchbook.surrogate.kernel.build import KernelBuildError, compiler_command
from wrenchbook.surrogate.packed.writer import pack
from wrenchbook.surrogate.table.rows import LoadRange, Rows

LOADS, OUTPUTS, BARS = list(range(6)), list(range(6, 12)), list(range(12, 18))
COVERAGE, TOLERANCE, WITHIN = [18], [19, 20], [21]
SOLVED = Path(__file__).parents[2] / "surrogate" / "tables"


def need_compiler() -> list[str]:
    """The C compiler's command. Skip a test without one; where CI runs that is a failure."""
    try:
        return compiler_command()
    except KernelBuildError as error:
        pytest.fail(str(error)) if os.environ.get("CI") == "true" else pytest.skip(str(error))


def cpp_compiler() -> list[str]:
    """The C++ compiler's command: g++, else that of ziglang, which the tests install."""
    result = shutil.which("g++")
    return [result] if result else [sys.executable, "-m", "ziglang", "c++"]


def solved(name: str, clean: int, full: int, *, tangents: bool = True, **more: object) -> Table:
    """A table of real solves of a shipped component."""
    with np.load(SOLVED / f"{name}.npz") as file:
        result = dict(file)
    chosen = np.r_[:clean, result["clean"] : result["clean"] + full]
    columns = {"compliance": result["compliance"][chosen]} if tangents else {}
    rows = Rows.of(result["wrench"][chosen], result["displacement"][chosen], **columns)
    return build(rows, LoadRange(result["low"], result["high"]), **more)


def packed(table: Table) -> PackedTable:
    """The packed form of a table."""
    return PackedTable.from_bytes(b"".join(pack(table)))


def wrenches_of(table: Table, count: int, span: float = 1.0, seed: int = 1) -> np.ndarray:
    """Random wrenches, (count, 6), within so much of the load range."""
    loads = table.load_range
    x = np.random.default_rng(seed).uniform(-span, span, (count, 6))
    return (loads.low + loads.high) / 2 + x * loads.scale


class Opened:
    """An FMU, unpacked, with its description."""

    def __init__(self, made: Fmu, folder: Path, name: str = "plate") -> None:
        self.path = folder / f"{name}.fmu"
        self.path.write_bytes(made.content)
        self.folder = Path(fmpy.extract(str(self.path), str(folder / "unpacked")))
        self.description = fmpy.read_model_description(str(self.path))  # which validates it

    @property
    def guid(self) -> str:
        return self.description.guid

    @property
    def library(self) -> Path:
        return next((self.folder / "binaries" / "linux64").iterdir())

    def instance(self, kind=FMU2Slave, *, guid: str | None = None, folder: Path | None = None):
        """An instance, instantiated; its messages are in `.said`."""
        identifier = self.description.coSimulation.modelIdentifier
        result = kind(
            guid=guid or self.guid,
            unzipDirectory=str(folder or self.folder),
            modelIdentifier=identifier,
            instanceName="one",
        )
        result.said = []
        callbacks = fmpy.fmi2.fmi2CallbackFunctions()

        def say(environment, name, status, category, message):
            result.said.append(message.decode())

        callbacks.logger = fmpy.fmi2.fmi2CallbackLoggerTYPE(say)
        callbacks.allocateMemory = fmpy.fmi2.fmi2CallbackAllocateMemoryTYPE(fmpy.calloc)
        callbacks.freeMemory = fmpy.fmi2.fmi2CallbackFreeMemoryTYPE(fmpy.free)
        result.instantiate(callbacks=callbacks)
        return result

    @contextmanager
    def running(self, kind=FMU2Slave, tolerance=(0.0, 0.0)):
        """An instance that answers."""
        result = self.instance(kind)
        named = {
            variable.name: variable.valueReference for variable in self.description.modelVariables
        }
        result.setReal([named[f"tolerance_{k}"] for k in ("translation", "rotation")], tolerance)
        result.setupExperiment()
        result.enterInitializationMode()
        result.exitInitializationMode()
        if kind is FMU2Model:
            result.newDiscreteStates()
            result.enterContinuousTimeMode()
        yield result
        result.freeInstance()


def opened(table: Table, folder: Path, method: str | None = None) -> Opened:
    """The FMU of a table."""
    need_compiler()
    return Opened(make_fmu("plate", packed(table), method), folder)


def answers(instance, wrenches: np.ndarray, m: int = 6) -> tuple[np.ndarray, ...]:
    """Displacements and bars, (k, m), and coverage, (k,), that an instance gives."""
    k, n = wrenches.shape
    numbers, flags = np.empty((k, 2 * m)), np.empty(k, dtype=int)
    for place, wrench in enumerate(wrenches):
        instance.setReal(list(range(n)), wrench)
        numbers[place] = instance.getReal(list(range(n, n + 2 * m)))
        flags[place] = instance.getInteger([n + 2 * m])[0]
    return numbers[:, :m], numbers[:, m:], flags


def judged(instance, wrenches: np.ndarray, m: int = 6) -> list[bool | None]:
    """What an instance says of each wrench: whether the whole bar is within the tolerance."""
    results: list[bool | None] = []
    n = wrenches.shape[1]
    for wrench in wrenches:
        instance.setReal(list(range(n)), wrench)
        results.append({1: True, 0: False, -1: None}[instance.getInteger([n + 2 * m + 3])[0]])
    return results


def slopes(instance, wrenches: np.ndarray, m: int = 6) -> np.ndarray:
    """du/dw, (k, m, n), by directional derivatives along one load after another."""
    k, n = wrenches.shape
    result = np.empty((k, m, n))
    for place, wrench in enumerate(wrenches):
        instance.setReal(list(range(n)), wrench)
        for load in range(n):
            along = instance.getDirectionalDerivative(list(range(n, n + m)), [load], [1.0])
            result[place, :, load] = along
    return result
