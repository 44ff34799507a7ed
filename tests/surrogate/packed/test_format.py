"""The file of a packed table: the same bytes for the same table, and nothing damaged answers."""

import os
import re
import sys

import numpy as np
import pytest

from tests.slow import slow, slow_but
from tests.surrogate.kernel.kinds import asked_of, packed_of, table_of
from wrenchbook.surrogate.answer import METHODS, UnknownMethodError
from wrenchbook.surrogate.kernel import format as packed_format
from wrenchbook.surrogate.kernel.binding import PackedTable
from wrenchbook.surrogate.kernel.format import PackedTableError, map_file, pieces, read, write_file
from wrenchbook.surrogate.kernel.replies import METHODS as NUMBERED
from wrenchbook.surrogate.kernel.replies import InverseError
from wrenchbook.surrogate.packed.arrays import BLOCKS, check, header
from wrenchbook.surrogate.packed.arrays import HEADER as C_HEADER
from wrenchbook.surrogate.packed.writer import pack

HEADER = 64


def content_of(kind="linear"):
    return bytearray(b"".join(pack(table_of(kind))))


def is_refused(content):
    for opens in (read, PackedTable.from_bytes):
        try:
            opens(bytes(content))
        except PackedTableError:
            continue
        return False
    return True


def test_arrays_and_words_come_back_as_they_were():
    arrays = {
        "a": np.arange(12.0).reshape(3, 4),
        "b/c": np.arange(5, dtype=np.int32),
        "d": np.array([], dtype=np.int64),
        "e": np.ones((2, 1, 3), dtype=np.uint8),
    }
    result = read(b"".join(pieces(arrays, {"words": ["ä", 1, None]})))
    assert result.meta == {"words": ["ä", 1, None]}
    assert result.arrays.keys() == arrays.keys()
    for name, array in arrays.items():
        np.testing.assert_array_equal(result.arrays[name], array)
        assert result.arrays[name].dtype == array.dtype
        assert not result.arrays[name].flags.writeable
        assert result.arrays[name].ctypes.data % 8 == 0


@pytest.mark.parametrize("kind", ["solved", "clean", "partial"])
def test_the_same_table_gives_the_same_bytes(kind):
    first, second = pack(table_of(kind), component="plate"), pack(table_of(kind), component="plate")
    assert first == second
    again = packed_of.__wrapped__(kind)
    asked = asked_of(table_of(kind), 20)
    for one, other in zip(again.batch(asked), packed_of(kind).batch(asked), strict=True):
        assert one.tobytes() == other.tobytes()


def test_arrays_begin_at_cache_lines_of_the_file(tmp_path):
    write_file(tmp_path / "plate.wbt", pack(table_of("clean")))
    start = np.frombuffer(content_of("clean"), dtype=np.uint8)
    for name, array in read(start.data).arrays.items():
        assert (array.ctypes.data - start.ctypes.data) % 64 == 0, name


def test_a_written_file_answers_and_its_arrays_are_mapped(tmp_path):
    write_file(tmp_path / "plate.wbt", pack(table_of("solved", (1,)), component="plate"))
    assert [path.name for path in tmp_path.iterdir()] == ["plate.wbt"]
    packed = PackedTable.open(tmp_path / "plate.wbt")
    assert packed.meta["provenance"]["component"] == "plate"
    assert packed.arrays["space/locked"].tolist() == [0, 1, 0, 0, 0, 0]
    mapped = map_file(tmp_path / "plate.wbt")
    np.testing.assert_array_equal(mapped.arrays["g0/row/wrench"], packed.arrays["g0/row/wrench"])
    asked = asked_of(table_of("solved"), 30)
    expected = packed_of("solved", (1,)).batch(asked)
    for one, other in zip(packed.batch(asked), expected, strict=True):
        assert one.tobytes() == other.tobytes()


@pytest.mark.skipif(sys.platform == "win32", reason="Windows has no file modes of groups")
def test_others_may_read_a_written_file_as_the_umask_says(tmp_path):
    before = os.umask(0o027)
    try:
        write_file(tmp_path / "plate.wbt", [b"content"])
    finally:
        os.umask(before)
    assert (tmp_path / "plate.wbt").stat().st_mode & 0o777 == 0o640


@pytest.mark.parametrize("step", [29, slow(1)])
def test_any_changed_byte_of_header_and_directory_is_refused(step):
    content = content_of()
    end = HEADER + 128 * int(np.frombuffer(content, "<u8", 1, 40)[0])
    for place in [*range(HEADER), *range(HEADER, end, step)]:
        content[place] ^= 0x10
        assert is_refused(content), place
        content[place] ^= 0x10


@pytest.mark.parametrize("count", [30, slow(300)])
def test_any_changed_byte_further_on_is_refused(count):
    content = content_of("clean")
    for place in np.random.default_rng(1).integers(HEADER, len(content), count).tolist():
        content[place] ^= 1 << place % 8
        assert is_refused(content), place
        content[place] ^= 1 << place % 8


def test_a_truncated_or_a_longer_file_is_refused(tmp_path):
    content = content_of()
    for size in [*range(0, 300, 7), len(content) // 2, len(content) - 1]:
        assert is_refused(content[:size]), size
    assert is_refused(content + b"\0")
    (tmp_path / "plate.wbt").write_bytes(content[:-1])
    for opens in (PackedTable.open, map_file):
        with pytest.raises(PackedTableError, match=r"damaged|of .* bytes"):
            opens(tmp_path / "plate.wbt")


@pytest.mark.parametrize(
    ("number", "words"),
    [
        (packed_format.FORMAT + 1, "use a newer wrenchbook"),
        (packed_format.FORMAT - 1, "download it again"),
    ],
)
def test_another_format_is_refused_by_name(tmp_path, number, words, monkeypatch):
    monkeypatch.setattr(packed_format, "FORMAT", number)
    content = b"".join(pack(table_of("linear")))
    monkeypatch.undo()
    (tmp_path / "plate.wbt").write_bytes(content)
    says = re.escape(f"format {number}") + ".*" + words
    for opens, source in (
        (read, content),
        (PackedTable.from_bytes, content),
        (PackedTable.open, tmp_path / "plate.wbt"),
    ):
        with pytest.raises(PackedTableError, match=says):
            opens(source)


@pytest.mark.parametrize(
    "kind",
    slow_but({"clean and full"}, ["clean", "solved", "clean and full", "second derivatives"]),
)
def test_arrays_of_other_shapes_are_refused_or_lead_no_answer_beyond_them(kind):
    result = read(bytes(content_of(kind)))
    asked = asked_of(table_of(kind), 50)
    for name, array in result.arrays.items():
        for other in (array[:-1], array[..., :-1], np.concatenate((array, array)), array[None]):
            changed = b"".join(pieces({**result.arrays, name: other}, result.meta))
            try:
                packed = PackedTable.from_bytes(changed)
                packed.batch(asked)
                for method in (None, "griddata"):
                    packed.derivatives(asked[:10], None, method)
            except (PackedTableError, UnknownMethodError):
                continue


@pytest.mark.parametrize("count", [1, slow(5)])
@pytest.mark.parametrize("kind", ["clean and full", slow("second derivatives")])
def test_indices_that_lead_out_of_a_table_lead_no_answer_out_of_it(kind, count):
    result = read(bytes(content_of(kind)))
    asked = asked_of(table_of(kind), 100)
    rng = np.random.default_rng(1)
    for name in result.arrays:
        for _ in range(count):
            array = np.array(result.arrays[name])
            whole = array.view(np.uint8).ravel()
            places = rng.integers(0, max(whole.size, 1), whole.size // 20)
            whole[places] = rng.integers(0, 256, len(places))
            changed = b"".join(pieces({**result.arrays, name: array}, result.meta))
            try:
                packed = PackedTable.from_bytes(changed)
            except PackedTableError:
                continue
            for method in ("griddata", "additive", "kriging", "linear"):
                packed.batch(asked, None, method)
            for method in ("kriging", "griddata"):
                packed.derivatives(asked[:50], None, method)
            packed.axis(0, 0, asked[0].tolist())


def a_point_with_facets(arrays: dict[str, np.ndarray]) -> None:
    arrays["g0/axes/ints"][:, 0] = 0
    arrays["g0/axes/floats"][:, 15] = -1.0


def axes_without_points(arrays: dict[str, np.ndarray]) -> None:
    a_point_with_facets(arrays)
    arrays["g0/axes/facets"] = arrays["g0/axes/facets"][:0]
    arrays["g0/axes/facet_first"][:] = 0
    arrays["g0/axes/point_first"][:3] = 0


def a_method_without_its_axes(arrays: dict[str, np.ndarray]) -> None:
    for name in [name for name in arrays if name.startswith("g0/axes/")]:
        del arrays[name]
    arrays["g0/flags"][0] = METHODS.index("additive")


@pytest.mark.parametrize(
    "change", [a_point_with_facets, axes_without_points, a_method_without_its_axes]
)
def test_parts_that_do_not_fit_together_are_refused(change):
    """Such files, whole by their checksums, ended the process that answered from them."""
    result = read(bytes(content_of("clean and full")))
    arrays = {name: np.array(array) for name, array in result.arrays.items()}
    change(arrays)
    with pytest.raises(PackedTableError, match="of another shape"):
        PackedTable.from_bytes(b"".join(pieces(arrays, result.meta)))


@pytest.mark.parametrize(
    ("kind", "name", "value", "words"),
    [
        ("second derivatives", "g0/kriging/smoothness", [3], "kriging/smoothness"),
        ("full", "g0/kriging/factor0/outputs", [0] * 6, "outputs"),
        ("full", "g0/kriging/factor0/outputs", [1] * 6, "outputs"),
    ],
)
def test_a_correlation_or_outputs_that_cannot_be_are_refused(kind, name, value, words):
    """A correlation that the kernel lacks, an output that two factors answer or none."""
    result = read(bytes(content_of(kind)))
    arrays = {**result.arrays, name: np.array(value, dtype=np.int32)}
    with pytest.raises(PackedTableError, match=words):
        PackedTable.from_bytes(b"".join(pieces(arrays, result.meta)))


def test_a_calibration_that_is_no_number_leads_no_answer_out_of_it():
    result = read(bytes(content_of("solved")))
    arrays = {name: np.array(array) for name, array in result.arrays.items()}
    for name in ("scale", "max_sigma"):
        changed = np.full_like(arrays[f"g0/kriging/factor0/{name}"], np.nan)
        content = pieces(arrays | {f"g0/kriging/factor0/{name}": changed}, result.meta)
        packed = PackedTable.from_bytes(b"".join(content))
        assert (packed.batch(asked_of(table_of("solved"), 50)).coverage != 0).all()


def test_a_whole_table_with_another_description_is_refused():
    result = read(bytes(content_of("linear")))
    with pytest.raises(PackedTableError, match="no space"):
        PackedTable.from_bytes(b"".join(pieces(result.arrays, {"x": 1})))


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="the system has no pipes by name")
def test_a_pipe_in_the_place_of_a_table_is_refused_and_not_waited_for(tmp_path):
    os.mkfifo(tmp_path / "plate.wbt")
    with pytest.raises(PackedTableError, match="not a file"):
        PackedTable.open(tmp_path / "plate.wbt")


def test_a_table_replaced_while_it_is_opened_is_one_table_or_the_other(tmp_path, monkeypatch):
    """The kernel and Python each opened the path: 4 % of the opened tables were mixtures."""
    path = tmp_path / "plate.wbt"
    path.write_bytes(content_of("solved"))
    opened, other = packed_format._views, content_of("linear")

    def replaced(whole):
        (tmp_path / "new").write_bytes(other)
        (tmp_path / "new").replace(path)
        return opened(whole)

    monkeypatch.setattr(packed_format, "_views", replaced)
    packed = PackedTable.open(path)
    wrench = asked_of(table_of("solved"), 1)[0].tolist()
    assert packed.content == content_of("solved")
    assert packed.answer(wrench) == PackedTable.from_bytes(content_of("solved")).answer(wrench)


def test_arrays_of_other_types_are_not_written():
    with pytest.raises(PackedTableError, match="complex"):
        pieces({"a": np.zeros(2, dtype=complex)}, {})
    with pytest.raises(PackedTableError, match="n" * 70):
        pieces({"n" * 70: np.zeros(2)}, {})


def test_an_interrupted_write_leaves_the_file_as_it_was(tmp_path):
    path = tmp_path / "plate.wbt"
    path.write_bytes(b"before")
    with pytest.raises(TypeError):
        write_file(path, [b"half", None])
    assert path.read_bytes() == b"before"
    assert [item.name for item in tmp_path.iterdir()] == ["plate.wbt"]


FIRST = "axes/vertex", "kriging/x", "/state"
TABLES = "solved", "clean and full", "second derivatives", "linear"


def test_the_header_of_the_kernel_is_that_of_the_description():
    """`python -m wrenchbook.surrogate.packed.arrays` writes it."""
    assert C_HEADER.read_text() == header()


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
        changed("one row", "g0/flags", 0, NUMBERED.index("kriging"))


def test_a_displacement_of_which_no_group_has_an_output_has_no_wrench():
    """As in a table that is cut to what a scene reads."""
    with pytest.raises(InverseError):
        changed("solved", "g0/outputs", 3, 0).inverse(np.full(6, 1e-9))
