"""The kernel's answers are those of the files that `make` wrote."""

import json
from itertools import chain

import numpy as np
import pytest

from tests.surrogate.golden.make import FOLDER, TABLES, WORDS, packed, told_by
from wrenchbook.surrogate.kernel.binding import PackedTable

SAME = 1e-12  # of a number's size and of the largest of its column
SIGMA = 1e-7  # of an error: sigma near a row is the root of a difference
REBUILT = 1e-6  # of the largest output of a kind: a search ends where rounding lets it
BAR = 1e-3  # of an error, likewise


def golden(kind):
    """What is in a kind's file."""
    with np.load(FOLDER / f"{kind}.npz") as file:
        result = dict(file)
    for name in ("words", "axes"):
        result[name] = json.loads(result[name].tobytes())
    return result


def assert_close(result, expected, part, of_size=SAME):
    """Compare arrays (k, ...) to a part of themselves and of the largest of their column."""
    size = np.nanmax(np.abs(np.nan_to_num(expected)), axis=0, initial=0.0)
    np.testing.assert_array_equal(np.isnan(result), np.isnan(expected))
    apart = np.nan_to_num(np.abs(result - expected))
    assert (apart <= part * np.nan_to_num(np.abs(expected)) + of_size * size).all()


def test_there_is_a_file_for_each_kind_and_no_other_and_all_are_below_a_megabyte():
    files = list(FOLDER.glob("*.npz"))
    assert {file.stem for file in files} == set(TABLES)
    assert sum(file.stat().st_size for file in files) < 1e6


@pytest.mark.parametrize("kind", TABLES)
def test_a_stored_table_replies_as_it_did(kind):
    expected = golden(kind)
    result = told_by(PackedTable.from_bytes(expected["table"].tobytes()), expected["asked"])
    assert json.loads(json.dumps(result["words"])) == expected["words"]
    assert_close(result["numbers"][:, 0], expected["numbers"][:, 0], SAME)
    assert_close(result["numbers"][:, 1:], expected["numbers"][:, 1:], SIGMA)
    assert_close(result["slopes"], expected["slopes"], SAME)


@pytest.mark.parametrize("kind", sorted(set(TABLES) - {"scene"}))
def test_the_axes_of_an_answer_contribute_what_they_did(kind):
    expected = golden(kind)
    results = told_by(PackedTable.from_bytes(expected["table"].tobytes()), expected["asked"])[
        "axes"
    ]
    for one, other in zip(chain(*results), chain(*expected["axes"]), strict=True):
        for name in ("outputs", "error"):
            ours, theirs = one.pop(name), other.pop(name)
            assert ours is theirs is None or ours == pytest.approx(theirs, rel=1e-9, abs=1e-18)
        assert one == other


@pytest.mark.parametrize("kind", TABLES)
def test_a_table_built_of_the_same_rows_replies_as_it_did(kind):
    expected = golden(kind)
    result = told_by(packed(kind), expected["asked"])
    for name in ("coverage", "method", "row", "missing"):
        column = WORDS.index(name)
        ours = json.loads(json.dumps([words[column] for words in result["words"]]))
        assert ours == [words[column] for words in expected["words"]]
    outputs, errors = (expected["numbers"][:, part] for part in (0, 1))
    size = np.nanmax(np.abs(outputs).reshape(-1, 2, 3), axis=(0, 2)).repeat(3)
    for part, near in ((0, 0.0), (1, BAR * np.nan_to_num(errors))):
        np.testing.assert_array_equal(
            np.isnan(result["numbers"][:, part]), np.isnan(expected["numbers"][:, part])
        )
        apart = np.nan_to_num(np.abs(result["numbers"][:, part] - expected["numbers"][:, part]))
        assert (apart <= REBUILT * size + near).all()
