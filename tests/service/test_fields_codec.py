"""Files of fields: what is written comes back, and what is damaged does not."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from wrenchbook.service.fields.record import (
    MAGIC,
    Column,
    DamagedFieldsError,
    pack,
    read_meta,
    unpack,
)

FIELD = np.random.default_rng(1).standard_normal((50, 3)) * [1e-3, 1.0, 1e6]
NAMES = np.arange(12, dtype=np.int32).reshape(4, 3)


def example():
    columns = {"field": Column(FIELD, 44), "exact": Column(FIELD), "names": Column(NAMES)}
    return pack({"words": "plate", "number": 1 / 3}, columns)


def test_words_and_exact_columns_come_back_bit_for_bit():
    meta, columns = unpack(example())
    assert meta == {"words": "plate", "number": 1 / 3}
    np.testing.assert_array_equal(columns["exact"], FIELD)
    np.testing.assert_array_equal(columns["names"], NAMES)
    assert read_meta(example()) == meta


@given(
    st.sampled_from([8, 24, 30, 44, 50]),
    st.integers(0, 2**32 - 1),
    st.floats(-300, 300),
    st.integers(1, 40),
)
def test_a_rounded_column_is_right_to_its_bits(bits, seed, exponent, count):
    values = np.random.default_rng(seed).standard_normal((count, 4)) * 10.0**exponent
    _, columns = unpack(pack({}, {"a": Column(values, bits)}))
    size = np.abs(values).max(axis=0)
    assert (np.abs(columns["a"] - values) <= size * 2.0**-bits).all()


@pytest.mark.parametrize("shape", [(0, 3), (1, 3), (5, 0), (4, 3, 6)])
@pytest.mark.parametrize("bits", [0, 24])
def test_zeros_and_nothing_at_all_have_their_shape(shape, bits):
    _, columns = unpack(pack({}, {"a": Column(np.zeros(shape), bits)}))
    assert columns["a"].shape == shape
    assert not columns["a"].any()


@pytest.mark.parametrize("number", [np.nan, np.inf])
def test_what_is_not_finite_is_not_kept(number):
    with pytest.raises(ValueError, match="not finite"):
        pack({}, {"a": Column(np.array([[1.0, number]]), 24)})


@settings(max_examples=200)
@given(st.data())
def test_no_byte_may_change(data):
    content = bytearray(example())
    place = data.draw(st.integers(0, len(content) - 1))
    content[place] ^= data.draw(st.integers(1, 255))
    try:
        found = unpack(bytes(content))
    except DamagedFieldsError:
        return
    # JSON may be written in two ways that say the same; then it says the same.
    np.testing.assert_array_equal(found[1]["exact"], FIELD)
    assert found[0] == unpack(example())[0]


@pytest.mark.parametrize("number", ["NaN", "1e999"])
def test_a_header_with_a_number_that_is_not_finite_is_damaged(number):
    header = f'{{"meta": {{"force": {number}}}, "columns": [], "digest": ""}}'.encode()
    with pytest.raises(DamagedFieldsError):
        unpack(MAGIC + len(header).to_bytes(4, "little") + header)


@pytest.mark.parametrize("part", [0, 3, 20, 24, 100, -1])
def test_no_byte_may_be_missing(part):
    with pytest.raises(DamagedFieldsError):
        unpack(example()[:part])


def test_a_field_takes_less_room_than_its_numbers():
    smooth = np.sin(np.linspace(0, 3, 3000)).reshape(-1, 3)
    assert len(pack({}, {"a": Column(smooth, 24)})) < 0.4 * smooth.nbytes
