"""Compiled code that is loaded beside the answers, not before them."""

import threading
from typing import Any

import numpy as np
import pytest

from service.tables.warm_up import use_compiled_code
from surrogate import jit
from surrogate.build import build
from surrogate.kriging import compiled
from surrogate.table.rows import LoadRange, Rows


@pytest.fixture(autouse=True)
def fresh(monkeypatch):
    monkeypatch.setattr(jit, "_held_back", set())
    monkeypatch.setattr(jit, "_warming", threading.local())


def table():
    rng = np.random.default_rng(4)
    wrenches = np.zeros((90, 6))
    for axis, loads in enumerate(((0, 4, 5), (1, 5, 3), (2, 3, 4))):
        wrenches[30 * axis : 30 * (axis + 1), loads] = rng.uniform(-1, 1, (30, 3))
    tangents = np.tile(np.eye(6), (90, 1, 1))
    rows = Rows.of(wrenches, np.sinh(wrenches), compliance=tangents)
    return build(rows, LoadRange(-np.ones(6), np.ones(6)))


def test_a_slow_warm_up_delays_no_answer_and_is_used_once_it_is_done():
    answering, may_end = table(), threading.Event()
    thread = jit.warm_in_background(lambda: may_end.wait(30))
    try:
        assert not jit.ready()
        assert jit.state() == ("loading" if jit.COMPILED else "not used")
        assert answering.answer([0.1, 0, 0, 0, 0.1, 0]).displacement is not None
        assert thread.is_alive()  # answered before its end
    finally:
        may_end.set()
    thread.join(30)
    assert jit.ready() == jit.COMPILED
    assert jit.state() == ("used" if jit.COMPILED else "not used")


def test_the_thread_that_warms_up_uses_compiled_code():
    seen = []
    jit.warm_in_background(lambda: seen.append(jit.ready())).join(30)
    assert seen == [jit.COMPILED]


def test_compiled_code_that_fails_is_left_alone(caplog):
    def fails():
        raise OSError("no memory")

    jit.warm_in_background(fails).join(30)
    assert not jit.ready()
    assert "compiled code cannot be used" in caplog.text


@pytest.mark.skipif(not jit.COMPILED, reason="numba is an extra")
def test_answers_are_the_same_before_and_after_the_warm_up():
    answering = table()
    asked = np.random.default_rng(5).uniform(-0.4, 0.4, (50, 6))
    jit._held_back.add("a warm-up")
    before = answering.batch(asked, method="kriging")
    jit._held_back.clear()
    after = answering.batch(asked, method="kriging")
    for one, other in zip(before[:2], after[:2], strict=True):
        scale = np.nanmax(np.abs(one))
        assert np.allclose(one, other, rtol=0, atol=1e-12 * scale, equal_nan=True)
    assert (before.coverage == after.coverage).all()


@pytest.mark.skipif(not jit.COMPILED, reason="numba is an extra")
def test_the_warm_up_leaves_nothing_to_compile_for_an_answer():
    use_compiled_code()
    kernels: tuple[Any, ...] = (compiled.values, compiled.answers)
    counts = [len(kernel.signatures) for kernel in kernels]
    assert min(counts) >= 1
    answering = table()
    asked = np.random.default_rng(5).uniform(-0.4, 0.4, (50, 6))
    asked.flags.writeable = False  # as bytes from the wire are
    answering.batch(asked, method="kriging")
    answering.batch(asked[::2], method="kriging")
    assert [len(kernel.signatures) for kernel in kernels] == counts
