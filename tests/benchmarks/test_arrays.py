"""Run times of tables on arrays of JAX and PyTorch: 4096 wrenches, a kriging of 40 solves."""

from __future__ import annotations

import os
import time
from collections.abc import Callable

import numpy as np
import pytest

from tests.surrogate.kernel.kinds import asked_of, packed_of, table_of
from wrenchbook.service.client import Table, arrays

COUNT = 4096


def spent(call: Callable[[], object], repeats: int = 30) -> tuple[float, float]:
    """Return the least wall time and processor time of one call, ms, after one that compiles."""
    call()
    walls, works = [], []
    for _ in range(repeats):
        wall, work = time.perf_counter(), time.process_time()
        call()
        walls.append(time.perf_counter() - wall)
        works.append(time.process_time() - work)
    return 1e3 * min(walls), 1e3 * min(works)


def kernel_ms(wrenches: np.ndarray) -> tuple[float, float]:
    """Return the times of the kernel's batches of answers and derivatives by two threads, ms."""
    packed, options = packed_of("solved"), (None, "kriging", 2)
    return spent(lambda: (packed.batch(wrenches, *options), packed.derivatives(wrenches, *options)))


def show(name: str, result: tuple[float, float], kernel: tuple[float, float]) -> None:
    wall, work = result
    print(
        f"\n{name}: {wall:.1f} ms, {work:.1f} ms of the processors (the kernel's batches by two "
        f"threads: {kernel[0]:.1f} and {kernel[1]:.1f} ms), load {os.getloadavg()[0]:.1f}"
    )


def test_jax_answers_4096_wrenches() -> None:
    jax = pytest.importorskip("jax", reason="the extra 'jax' is not installed")
    jax.config.update("jax_enable_x64", True)
    wrenches = asked_of(table_of("solved"), COUNT, 1, 1.0)
    own, asked = (
        arrays.jax(Table(packed_of("solved"), "plate"), "kriging"),
        jax.numpy.array(wrenches),
    )
    bare = jax.jit(lambda w: (own.displacement(w), own.derivative(w)))
    whole = jax.jit(lambda w: (own(w), own.derivative(w)))
    kernel = kernel_ms(wrenches)
    bare_ms = spent(lambda: jax.block_until_ready(bare(asked)))
    whole_ms = spent(lambda: jax.block_until_ready(whole(asked)))
    show("JAX, value and derivative (at most 12 ms on two idle cores)", bare_ms, kernel)
    show("JAX, with error bars (at most 20 ms)", whole_ms, kernel)
    assert bare_ms[1] < 1.5 * kernel[1]
    assert whole_ms[1] < 1.5 * kernel[1]


def test_torch_answers_4096_wrenches() -> None:
    torch = pytest.importorskip("torch", reason="the extra 'torch' is not installed")
    wrenches = asked_of(table_of("solved"), COUNT, 1, 1.0)
    own = arrays.torch(Table(packed_of("solved"), "plate"), "kriging")
    asked, kernel = torch.tensor(wrenches), kernel_ms(wrenches)
    bare = spent(lambda: (own.displacement(asked), own.derivative(asked)), 10)
    whole = spent(lambda: (own(asked), own.derivative(asked)), 10)
    show("PyTorch, value and derivative", bare, kernel)
    show("PyTorch, with error bars", whole, kernel)
    assert bare[1] < 1.5 * kernel[1]
