"""What the kernel promises whatever the law: threads, batches, inverses, C programs."""

import os
import shutil
import subprocess
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
import pytest

from tests.surrogate.kernel.kinds import KINDS, RANGE, asked_of, packed_of, special_of, table_of
from wrenchbook.surrogate.answer import ANSWERED, METHODS, NAMES, UnknownMethodError
from wrenchbook.surrogate.build import build
from wrenchbook.surrogate.kernel import binding
from wrenchbook.surrogate.kernel import build as kernel_build
from wrenchbook.surrogate.kernel.binding import PackedTable
from wrenchbook.surrogate.kernel.format import write_file
from wrenchbook.surrogate.kernel.replies import InverseError
from wrenchbook.surrogate.packed.writer import pack
from wrenchbook.surrogate.table.rows import Rows

PAGE = Path(__file__).parents[3] / "data" / "docs" / "how-to" / "c.md"


@pytest.fixture(scope="module")
def program_text():
    """The program of the page on C and C++."""
    return PAGE.read_text().split("```c\n")[1].split("```")[0]


def same_bits(one, other):
    return all(a.tobytes() == b.tobytes() for a, b in zip(one, other, strict=True))


@pytest.mark.parametrize("kind", sorted(KINDS))
def test_a_batch_has_the_bits_of_single_answers(kind):
    packed = packed_of(kind)
    asked = np.concatenate((asked_of(table_of(kind), 150), special_of(table_of(kind), 40)))
    for method in (None, "griddata", "kriging"):
        found = packed.batch(asked, None, method)
        for place, wrench in enumerate(asked.tolist()):
            reply = packed.answer(wrench, None, method)
            outputs = [np.nan if x is None else x for x in reply.outputs or (None,) * 6]
            error = [np.nan if x is None else x for x in reply.error or (None,) * 6]
            np.testing.assert_array_equal(found.outputs[place], outputs)
            np.testing.assert_array_equal(found.errors[place], error)
            assert NAMES[found.coverage[place]] == reply.coverage


@pytest.mark.parametrize("kind", ["clean", "solved", "partial", "clean and full"])
@pytest.mark.parametrize("method", [None, "additive"])
def test_threads_change_no_bit(kind, method):
    packed, asked = packed_of(kind), asked_of(table_of(kind), 20_000)
    alone = packed.batch(asked, None, method)
    for threads in (2, 3, 8):
        assert same_bits(alone, packed.batch(asked, None, method, threads))
    slopes = packed.derivatives(asked[:9000], None, method)
    assert slopes.tobytes() == packed.derivatives(asked[:9000], None, method, threads=3).tobytes()


def test_the_order_and_the_company_of_wrenches_change_no_bit():
    packed, asked = packed_of("clean"), asked_of(table_of("clean"), 6000)
    whole = packed.batch(asked)
    order = np.random.default_rng(1).permutation(len(asked))
    assert same_bits([column[order] for column in whole], packed.batch(asked[order]))
    assert same_bits([column[:7] for column in whole], packed.batch(asked[:7]))


@pytest.mark.parametrize("kind", ["solved", "clean and full", "uncertain", "second derivatives"])
def test_other_optimisation_and_vectors_change_no_bit(kind, tmp_path, monkeypatch):
    """As on a processor without AVX2, and by another compiler's choice of instructions."""
    sources = [str(path) for path in kernel_build.FOLDER.glob("wb_*.c")]
    other = tmp_path / "other.so"
    flags = ["-std=c11", "-O1", "-ffp-contract=off", "-DWB_SHARED", "-DWB_VECTORS=", "-fPIC"]
    command = [_compiler("gcc", "cc"), *flags, "-shared", "-o", str(other), *sources]
    subprocess.run([*command, "-lm", "-lpthread"], check=True)
    packed, asked = packed_of(kind), asked_of(table_of(kind), 300)
    expected = packed.batch(asked), packed.derivatives(asked[:50])
    monkeypatch.setattr(binding, "ready_library", lambda: other)
    binding.kernel.cache_clear()
    try:
        again = packed_of.__wrapped__(kind)
        found = again.batch(asked), again.derivatives(asked[:50])
    finally:
        monkeypatch.undo()
        binding.kernel.cache_clear()
    for one, two in zip((*found[0], found[1]), (*expected[0], expected[1]), strict=True):
        np.testing.assert_array_equal(one, two)


def test_many_python_threads_share_a_table():
    packed, asked = packed_of("solved"), asked_of(table_of("solved"), 400)
    alone = [packed.answer(wrench) for wrench in asked.tolist()]
    with ThreadPoolExecutor(4) as pool:
        for found in pool.map(lambda _: [packed.answer(w) for w in asked.tolist()], range(8)):
            assert found == alone


def test_what_is_no_wrench_or_method_is_refused():
    packed = packed_of("solved")
    for wrong in ([1.0] * 5, [1.0] * 7, [float("nan")] * 6, [float("inf")] + [0.0] * 5, ["x"] * 6):
        with pytest.raises(ValueError, match="wrench"):
            packed.answer(wrong)
    with pytest.raises(ValueError, match="finite"):
        packed.batch([[np.inf] * 6])
    for method in ("cubic", "tangent", "nearest"):
        with pytest.raises(UnknownMethodError, match="one of griddata, additive, kriging, linear"):
            packed.answer([0.0] * 6, None, method)
    assert packed.batch(np.empty((0, 6))).outputs.shape == (0, 6)


def test_without_a_kriging_the_default_method_answers_and_is_named():
    packed = packed_of("linear, two loads unknown")
    default = packed.answer([1.0] * 6)
    assert default.method == packed.answers_by("kriging") == "additive"
    assert packed.answer([1.0] * 6, None, "kriging") == default


@pytest.mark.parametrize(
    "kind",
    [
        *("solved", "few with tangents", "linear", "clean and full", "second derivatives"),
    ],
)
def test_the_inverse_of_a_displacement_is_its_wrench(kind):
    table, packed = table_of(kind), packed_of(kind)
    scale = table.load_range.scale
    for wrench in asked_of(table, 20, span=0.8):
        found = packed.answer(wrench.tolist())
        again, stiffness = packed.inverse(found.outputs)
        np.testing.assert_allclose(again / scale, wrench / scale, atol=1e-9)
        slopes = packed.derivative(again)
        np.testing.assert_allclose(stiffness @ slopes, np.eye(6), atol=1e-9)
        near, _ = packed.inverse(found.outputs, start=wrench + 0.05 * scale)
        np.testing.assert_allclose(near / scale, wrench / scale, atol=1e-9)


def test_the_inverse_of_a_part_soft_one_way_and_stiff_another_ends_at_rounding():
    """Its wrench is no better than what sums over the rows lose: steps of Newton end there."""
    random = np.random.default_rng(2)
    turn = np.linalg.qr(random.normal(size=(6, 6)))[0]
    linear = turn @ np.diag(np.geomspace(1e-3, 1e-11, 6)) @ turn.T
    x, along = random.uniform(-1, 1, (20, 6)), 0.4 * random.normal(size=6)
    bend = 0.3 * np.tanh(x @ along)
    moved = x @ linear + bend[:, None] * (linear @ along)
    slopes = linear + (0.3 - bend**2 / 0.3)[:, None, None] * np.outer(linear @ along, along)
    rows = Rows.of(x * RANGE.high, moved, compliance=slopes / RANGE.high, source=["fea"] * 20)
    packed = PackedTable.from_bytes(b"".join(pack(build(rows, RANGE))))
    wrench, stiffness = np.zeros(6), None
    for time in np.linspace(0, 1, 200):
        target = packed.answer((0.5 * RANGE.high * np.sin(time + np.arange(6))).tolist()).outputs
        wrench, stiffness = packed.inverse(target, wrench, None, stiffness)
        again = np.array(packed.answer(wrench.tolist()).outputs)
        np.testing.assert_allclose(again, target, atol=1e-9 * np.abs(moved).max())


def test_the_inverse_leaves_locked_loads_zero():
    packed = packed_of("linear", locked=(1, 5))
    wrench = np.array([10.0, 0.0, -20.0, 1.0, 2.0, 0.0])
    outputs = np.array(packed.answer(wrench.tolist()).outputs)
    again, stiffness = packed.inverse(outputs, start=[1.0] * 6)
    np.testing.assert_allclose(again, wrench, atol=1e-9)
    assert not stiffness[[1, 5]].any()
    assert not stiffness[:, [1, 5]].any()


def test_a_displacement_without_a_wrench_is_refused():
    with pytest.raises(InverseError, match=r"not known|no inverse|no wrench"):
        packed_of("one row").inverse([1.0] * 6)
    with pytest.raises(InverseError):
        packed_of("solved").inverse([1e3] * 6)
    with pytest.raises(ValueError, match="finite"):
        packed_of("solved").inverse([np.nan] * 6)


def test_a_closed_table_answers_no_more():
    from wrenchbook.surrogate.packed.writer import pack

    packed = PackedTable.from_bytes(b"".join(pack(table_of("linear"))))
    packed.close()
    packed.close()
    with pytest.raises(ValueError, match="closed"):
        packed.answer([0.0] * 6)


def _compiler(*names: str) -> str:
    found = next(filter(None, map(shutil.which, names)), None)
    if found is None:
        if os.environ.get("CI") == "true":
            pytest.fail(f"no {names[0]} (Debian packages gcc, g++)")
        pytest.skip(f"no {names[0]}")
    return found


@pytest.mark.parametrize("language", ["c", "c++"])
@pytest.mark.parametrize("kind", ["solved", "clean"])
def test_the_readmes_program_has_the_bits_of_python(program_text, tmp_path, language, kind):
    """Compiled as C with the sources, and as C++ against the library."""
    assert len(program_text.splitlines()) <= 20
    source = tmp_path / ("program.c" if language == "c" else "program.cpp")
    source.write_text(program_text)
    write_file(tmp_path / "plate.wbt", pack(table_of(kind)))
    program = tmp_path / "program"
    include = ["-O2", f"-I{kernel_build.FOLDER}", "-o", str(program)]
    if language == "c":
        sources = [str(path) for path in kernel_build.FOLDER.glob("wb_*.c")]
        flags = [one for one in kernel_build.FLAGS if one != "-DWB_SHARED"]
        command = [_compiler("gcc", "cc"), *flags, *include, str(source), *sources]
    else:
        built = kernel_build.ready_library()
        link = [str(built), f"-Wl,-rpath,{built.parent}"]
        command = [_compiler("g++", "c++"), *include, str(source), *link]
    subprocess.run([*command, "-lm", "-lpthread"], check=True)
    packed = PackedTable.open(tmp_path / "plate.wbt")
    for wrench in asked_of(table_of(kind), 10).tolist():
        loads = [load.hex() for load in wrench]
        ran = subprocess.run([program, tmp_path / "plate.wbt", *loads], capture_output=True)
        assert not ran.returncode, ran.stderr
        lines = [line.split() for line in ran.stdout.decode().splitlines()]
        reply = packed.answer(wrench)
        assert lines[0] == [reply.coverage, reply.method]
        outputs, errors = zip(*(map(float, line) for line in lines[1:]), strict=True)
        assert outputs == reply.outputs
        unknown = reply.error is None and np.isnan(errors).all()
        assert unknown or errors == reply.error


def test_the_program_says_why_a_table_cannot_be_opened(program_text, tmp_path):
    source = tmp_path / "program.c"
    source.write_text(program_text)
    program = tmp_path / "program"
    sources = [str(path) for path in kernel_build.FOLDER.glob("wb_*.c")]
    include = [f"-I{kernel_build.FOLDER}", "-o", str(program), "-lm", "-lpthread"]
    subprocess.run([_compiler("gcc", "cc"), str(source), *sources, *include], check=True)
    (tmp_path / "plate.wbt").write_bytes(b"no table")
    ran = subprocess.run([program, tmp_path / "plate.wbt", *"123456"], capture_output=True)
    assert ran.returncode == 1
    assert b"not a packed table" in ran.stderr


def test_codes_are_those_of_the_header():
    header = (kernel_build.FOLDER / "wrenchbook.h").read_text()
    for number, name in enumerate(METHODS):
        assert f"WB_{name.upper()} = {number}," in header
    for number, name in enumerate(NAMES):
        assert f"WB_{name.upper()} = {number}" in header
    assert f"WB_ROW = {ANSWERED.index('row')}" in header
    assert f"WB_ESTIMATE = {ANSWERED.index('estimate')}" in header


def test_a_library_of_other_sources_is_compiled_anew(tmp_path, monkeypatch):
    library = tmp_path / kernel_build.library_path().name
    monkeypatch.setattr(kernel_build, "library_path", lambda *_: library)
    assert kernel_build.ready_library() == library
    made = library.stat().st_mtime_ns
    kernel_build.ready_library()
    assert library.stat().st_mtime_ns == made
    monkeypatch.setattr(kernel_build, "sources_hash", lambda: "other")
    kernel_build.ready_library()
    assert library.stat().st_mtime_ns > made
    assert b"wb:other" in library.read_bytes()


def test_without_a_compiler_it_is_said_what_to_do(tmp_path, monkeypatch):
    monkeypatch.setattr(kernel_build, "library_path", lambda *_: tmp_path / "lib.so")
    monkeypatch.setenv("PATH", str(tmp_path))
    monkeypatch.delenv("CC", raising=False)
    monkeypatch.setattr(kernel_build.importlib.util, "find_spec", lambda name: None)
    with pytest.raises(kernel_build.KernelBuildError, match=r"pip install ziglang.*kernel.build"):
        kernel_build.ready_library()
    monkeypatch.setenv("CC", "false")
    with pytest.raises(kernel_build.KernelBuildError, match="ziglang"):
        kernel_build.ready_library()
