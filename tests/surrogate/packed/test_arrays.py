"""One description of a packed table's arrays: the writer, the header of the kernel, the reader."""

import re

import numpy as np
import pytest

from tests.surrogate.kernel.kinds import packed_of
from wrenchbook.surrogate.kernel.binding import PackedTable
from wrenchbook.surrogate.kernel.format import PackedTableError, pieces
from wrenchbook.surrogate.kernel.replies import METHODS, InverseError
from wrenchbook.surrogate.packed.arrays import BLOCKS, HEADER, check, header

FIRST = "axes/vertex", "kriging/x", "/state"
TABLES = "solved", "clean and full", "second derivatives", "linear"


def test_the_header_of_the_kernel_is_that_of_the_description():
    """`python -m wrenchbook.surrogate.packed.arrays` writes it."""
    assert HEADER.read_text() == header()


@pytest.mark.parametrize("kind", TABLES)
def test_every_array_is_described(kind):
    arrays = packed_of(kind).arrays
    assert check(arrays) is arrays
    with pytest.raises(PackedTableError, match="unknown"):
        check({**arrays, "space/unknown": np.zeros(1)})


@pytest.mark.parametrize("kind", TABLES)
def test_the_writer_and_the_kernel_refuse_arrays_of_another_shape_or_type_and_lacking_ones(kind):
    packed = packed_of(kind)
    for name, array in packed.arrays.items():
        start, last = re.fullmatch("(.*/)(.*)", name).groups()
        block = next(own for own in BLOCKS.values() if re.fullmatch(own.names, start))
        own = next(own for own in block.arrays if own.name == last)
        if name == "space/sizes" or "x" in own.shape.split():
            continue
        other = np.zeros(array.shape, np.uint8 if own.type != "u1" else np.int32)
        for changed in (array[None], other, *(() if own.optional else (None,))):
            arrays = {key: value for key, value in packed.arrays.items() if key != name}
            if changed is not None:
                arrays[name] = changed
            with pytest.raises(PackedTableError, match=last):
                check(arrays)
            # Without its first array an optional block is not there.
            if own.member != "-" and (changed is not None or not name.endswith(FIRST)):
                with pytest.raises(PackedTableError):
                    PackedTable.from_bytes(b"".join(pieces(arrays, packed.meta)))


def changed(kind, name, index, value):
    """A table with one number of an array changed."""
    packed = packed_of(kind)
    arrays = {key: np.array(array) for key, array in packed.arrays.items()}
    arrays[name][index] = value
    return PackedTable.from_bytes(b"".join(pieces(arrays, packed.meta)))


def test_a_group_without_a_kriging_cannot_have_it_as_its_method():
    with pytest.raises(PackedTableError, match="flags"):
        changed("one row", "g0/flags", 0, METHODS.index("kriging"))


def test_a_displacement_of_which_no_group_has_an_output_has_no_wrench():
    """As in a table that is cut to what a scene reads."""
    with pytest.raises(InverseError):
        changed("solved", "g0/outputs", 3, 0).inverse(np.full(6, 1e-9))
