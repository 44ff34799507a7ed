"""What the kernel promises whatever the law: threads, batches, inverses, C programs."""

import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
import pytest

from tests.surrogate.kernel.kinds import RANGE, asked_of, packed_of, table_of
from wrenchbook.surrogate.answer import ANSWERED, METHODS, NAMES, UnknownMethodError
from wrenchbook.surrogate.build import build
from wrenchbook.surrogate.kernel import binding
from wrenchbook.surrogate.kernel import build as kernel_build
from wrenchbook.surrogate.kernel.binding import PackedTable
from wrenchbook.surrogate.kernel.replies import InverseError
from wrenchbook.surrogate.packed.writer import pack
from wrenchbook.surrogate.table.rows import Rows


@pytest.fixture(scope="module")
def plain_library(tmp_path_factory) -> Path:
    """The kernel as on a processor without AVX2, and by another compiler's choice."""
    sources = [str(path) for path in kernel_build.FOLDER.glob("wb_*.c")]
    library = tmp_path_factory.mktemp("plain") / "plain.so"
    flags = ["-std=c11", "-O1", "-ffp-contract=off", "-DWB_SHARED", "-DWB_VECTORS=", "-fPIC"]
    command = [*kernel_build.compiler_command(), *flags, "-shared", "-o", str(library)]
    subprocess.run([*command, *sources, "-lm", "-lpthread"], check=True)
    return library


@pytest.mark.parametrize("kind", ["solved", "clean and full", "uncertain", "second derivatives"])
def test_other_optimisation_and_vectors_change_no_bit(kind, plain_library, monkeypatch):
    packed, asked = packed_of(kind), asked_of(table_of(kind), 300)
    expected = packed.batch(asked), packed.derivatives(asked[:50])
    monkeypatch.setattr(binding, "ready_library", lambda: plain_library)
    binding.kernel.cache_clear()
    try:
        again = packed_of.__wrapped__(kind)
        result = again.batch(asked), again.derivatives(asked[:50])
    finally:
        monkeypatch.undo()
        binding.kernel.cache_clear()
    for one, two in zip((*result[0], result[1]), (*expected[0], expected[1]), strict=True):
        np.testing.assert_array_equal(one, two)


def test_many_python_threads_share_a_table():
    packed, asked = packed_of("solved"), asked_of(table_of("solved"), 400)
    alone = [packed.answer(wrench) for wrench in asked.tolist()]
    with ThreadPoolExecutor(4) as pool:
        for result in pool.map(lambda _: [packed.answer(w) for w in asked.tolist()], range(8)):
            assert result == alone


def test_what_is_no_wrench_or_method_is_refused():
    packed = packed_of("solved")
    for wrong in ([1.0] * 5, [1.0] * 7, [float("nan")] * 6, [float("inf")] + [0.0] * 5, ["x"] * 6):
        with pytest.raises(ValueError, match=r"wrench must be 6 numbers|fx must be finite"):
            packed.answer(wrong)
    with pytest.raises(ValueError, match="wrench 1: fy must be finite, not inf"):
        packed.batch([[0.0] * 6, [0.0, np.inf, 0.0, 0.0, 0.0, 0.0]])
    with pytest.raises(ValueError, match=r"tolerance must be 6 numbers .*, not 2"):
        packed.answer([0.0] * 6, (1e-6, 1e-5))
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
        result = packed.answer(wrench.tolist())
        again, stiffness = packed.inverse(result.outputs)
        np.testing.assert_allclose(again / scale, wrench / scale, atol=1e-9)
        slopes = packed.derivative(again)
        np.testing.assert_allclose(stiffness @ slopes, np.eye(6), atol=1e-9)
        near, _ = packed.inverse(result.outputs, start=wrench + 0.05 * scale)
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
    with pytest.raises(InverseError, match=r"not known|singular|no wrench"):
        packed_of("one row").inverse([1.0] * 6)
    last = r"for ux = 1000 m.*; its last wrench was .*fx = .* N.*, outside the load range"
    with pytest.raises(InverseError, match=last):
        packed_of("solved").inverse([1e3] * 6)
    with pytest.raises(ValueError, match="uy must be finite, not nan"):
        packed_of("solved").inverse([0.0, np.nan, 0.0, 0.0, 0.0, 0.0])
    with pytest.raises(ValueError, match=r"start wrench must be 6 numbers, not of shape \(5,\)"):
        packed_of("solved").inverse([0.0] * 6, start=[0.0] * 5)


def test_a_rate_of_a_joint_without_a_mass_names_the_matrix():
    unit = np.eye(6)
    with pytest.raises(ValueError, match=r"stiffness .* entry \[0, 1\] is nan"):
        PackedTable.joint_rate(np.where(np.eye(6, k=1), np.nan, unit), unit, 1e-3, 0.0)
    with pytest.raises(ValueError, match=r"smallest eigenvalue -1; give every freedom"):
        PackedTable.joint_rate(unit, -unit, 1e-3, 0.0)


def test_a_closed_table_answers_no_more():
    from wrenchbook.surrogate.packed.writer import pack

    packed = PackedTable.from_bytes(b"".join(pack(table_of("linear"))))
    packed.close()
    packed.close()
    with pytest.raises(ValueError, match="closed"):
        packed.answer([0.0] * 6)


@pytest.mark.parametrize(
    ("call", "arguments"),
    [
        ("batch", (np.zeros((1, 6)),)),
        ("derivatives", (np.zeros((1, 6)),)),
        ("inverse", (np.zeros(6),)),
        ("axis", (0, 0, [0.0] * 6)),
        ("joints", (1,)),
    ],
)
def test_a_closed_table_refuses_every_call(call, arguments):
    """All calls but two gave the kernel a null pointer, which ended the process."""
    from wrenchbook.surrogate.packed.writer import pack

    packed = PackedTable.from_bytes(b"".join(pack(table_of("linear"))))
    packed.close()
    with pytest.raises(ValueError, match="closed"):
        getattr(packed, call)(*arguments)


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
    quick = tuple(flag for flag in kernel_build.FLAGS if not flag.startswith("-O"))
    monkeypatch.setattr(kernel_build, "FLAGS", quick)
    monkeypatch.setattr(kernel_build, "library_path", lambda *_: library)
    assert kernel_build.ready_library() == library
    created = library.stat().st_mtime_ns
    kernel_build.ready_library()
    assert library.stat().st_mtime_ns == created
    monkeypatch.setattr(kernel_build, "sources_hash", lambda: "other")
    kernel_build.ready_library()
    assert library.stat().st_mtime_ns > created
    assert b"wb:other" in library.read_bytes()


def compiler(folder, monkeypatch, script):
    """Make a shell script the C compiler; the path of its output is $OUT."""
    file = folder / "compiler"
    find = 'while [ "$1" != -o ]; do shift; done; OUT=$2'
    file.write_text(f"#!/bin/sh\n{find}\n{script}\n")
    file.chmod(0o755)
    monkeypatch.setenv("CC", str(file))


@pytest.mark.skipif(sys.platform == "win32", reason="the compiler is a shell script")
def test_a_library_that_cannot_be_moved_into_place_is_no_fault_of_the_compiler(
    tmp_path, monkeypatch
):
    compiler(tmp_path, monkeypatch, 'touch "$OUT"')
    library = tmp_path / "lib.so"
    library.mkdir()
    with pytest.raises(kernel_build.KernelBuildError, match="was compiled, but cannot be moved"):
        kernel_build.compile_library(library, [], [])


@pytest.mark.skipif(sys.platform == "win32", reason="the compiler is a shell script")
def test_the_output_of_a_compiler_need_not_be_utf_8(tmp_path, monkeypatch):
    compiler(tmp_path, monkeypatch, r"printf 'wrong \351 here' >&2; exit 1")
    with pytest.raises(kernel_build.KernelBuildError, match="wrong \N{REPLACEMENT CHARACTER} here"):
        kernel_build.compile_library(tmp_path / "lib.so", [], [])


def test_without_a_compiler_it_is_said_what_to_do(tmp_path, monkeypatch):
    monkeypatch.setattr(kernel_build, "library_path", lambda *_: tmp_path / "lib.so")
    monkeypatch.setenv("PATH", str(tmp_path))
    monkeypatch.delenv("CC", raising=False)
    monkeypatch.setattr(kernel_build.importlib.util, "find_spec", lambda name: None)
    with pytest.raises(kernel_build.KernelBuildError, match=r"pip install ziglang.*kernel.build"):
        kernel_build.ready_library()


def test_a_compiler_that_cc_names_and_that_is_missing_is_named_and_no_other_is_taken(monkeypatch):
    monkeypatch.setenv("CC", "nonexistent-cc -m64")
    with pytest.raises(kernel_build.KernelBuildError, match=r"'nonexistent-cc'.*CC.*unset"):
        kernel_build.compiler_command()
