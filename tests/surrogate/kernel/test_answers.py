"""Properties of answers by any method, by Hypothesis; those of the axes are in test_properties."""

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from tests.surrogate.kernel.kinds import asked_of, packed_of, size_of, table_of
from wrenchbook.surrogate.answer import BY_AXES, METHODS

KRIGED = "clean and full", "full", "solved", "second derivatives", "uncertain"
SEEDS = st.integers(0, 2**32 - 1)


def told_by(kind, asked, method):
    return packed_of(kind).batch(asked, None, method, without_rows=True)


@pytest.mark.parametrize("method", METHODS)
@settings(max_examples=8)
@given(number=st.integers(0, 4), seed=SEEDS)
def test_no_answer_jumps_between_two_wrenches(method, number, seed):
    kind = "clean" if method in BY_AXES else KRIGED[number]
    first, last = asked_of(table_of(kind), 2, seed, span=0.4)
    steps = np.linspace(0.0, 1.0, 4001)[:, None]
    result = told_by(kind, (1 - steps) * first + steps * last, method)
    assume(method not in BY_AXES or (result.coverage < 2).all())  # hulls end in steps
    fine, coarse = (
        np.abs(np.diff(result.outputs[::every], axis=0)).max(axis=0) for every in (1, 10)
    )
    assert (fine <= 0.2 * coarse + 1e-9 * size_of(table_of(kind))).all()  # a tenth, of slopes


@settings(max_examples=30)
@given(kind=st.sampled_from(KRIGED), seed=SEEDS)
def test_error_bars_of_the_kriging_grow_from_a_row_on(kind, seed):
    table, random = table_of(kind), np.random.default_rng(seed)
    inner = np.abs(table.rows.wrench / table.load_range.scale).max(axis=1) < 0.8
    row = random.choice(table.rows.wrench[inner])
    step = 0.2 * random.uniform(-1, 1, 6) * table.load_range.scale
    bars = told_by(kind, row + np.array([[0.0], [0.01], [0.1], [0.4]]) * step, "kriging").errors
    known = np.isfinite(bars).all(axis=1)
    assert known[0]
    # Of rows that scatter those near by may have smaller bars: 3 % of 3,000 draws of "uncertain".
    assert kind not in ("solved", "second derivatives") or (bars[known] >= 0.9 * bars[0]).all()
    assert bars[known][-1].sum() > bars[0].sum()


@settings(max_examples=30)
@given(kind=st.sampled_from(["linear", *KRIGED]), seed=SEEDS)
def test_answers_of_the_linear_method_add_up(kind, seed):
    one, other = asked_of(table_of(kind), 2, seed, span=0.4)
    asked = np.stack((one, other, one + other, np.zeros(6)))
    a, b, both, none = told_by(kind, asked, "linear").outputs
    assert (np.abs(a + b - both - none) <= 1e-12 * size_of(table_of(kind)).max()).all()
