"""An FMU with binaries of all platforms, compiled on one machine by ziglang."""

import importlib.util
import os
import platform
import re
import struct
import zipfile
from io import BytesIO
from pathlib import Path

import numpy as np
import pytest
from fmpy.validation import validate_fmu
from typer.testing import CliRunner

from tests.service.fmu import binaries
from tests.service.fmu.made import BARS, LOADS, OUTPUTS, Opened, packed, wrenches_of
from tests.service.stub_server import Answer, running_stub
from tests.slow import slow
from wrenchbook.service.cli.main import app
from wrenchbook.service.fmu import platforms
from wrenchbook.service.fmu.export import Fmu, make_fmu
from wrenchbook.service.fmu.platforms import PLATFORMS, platforms_of, universal
from wrenchbook.surrogate.kernel.build import KernelBuildError
from wrenchbook.surrogate.packed.writer import pack

X86_64, ARM64 = 0x01000007, 0x0100000C  # processors of Mach-O
LINKERS = {"__dso_handle", "_mh_dylib_header"}  # symbols that the linker of ziglang defines
HEADER = Path(platforms.__file__).parent / "c" / "fmi2Functions.h"
# Of FMI 2.0, for co-simulation and model exchange.
FUNCTIONS = set(re.findall(r"^#define (fmi2\w+)\s+fmi2FullName", HEADER.read_text(), re.M))


@pytest.fixture(scope="module", params=["linux64", slow("all")])
def fmu(request, table, tmp_path_factory):
    """The FMU of one platform or all, written by the command."""
    if importlib.util.find_spec("ziglang") is None:
        assert os.environ.get("CI") != "true", "ziglang is not installed"
        pytest.skip("no ziglang")
    folder = tmp_path_factory.mktemp(request.param)
    path = folder / "plate_thin.fmu"
    with running_stub() as stub:
        stub.answers(Answer(b"".join(pack(table)), kind="application/octet-stream"))
        words = ["export", "plate_thin", str(path), "--platforms", request.param]
        run = CliRunner().invoke(app, [*words, "--server", stub.url])
    assert run.exit_code == 0, run.output
    assert ", ".join(platforms_of(request.param)) in " ".join(run.output.split())
    return Opened(Fmu(path.read_bytes(), (), ""), folder, "plate_thin")


OF_ALL = pytest.mark.parametrize("fmu", [slow("all")], indirect=True)


def binary(fmu, place, ending):
    return (fmu.folder / "binaries" / place / f"plate_thin{ending}").read_bytes()


def test_fmpy_finds_nothing_to_object_to_in_an_fmu_of_several_platforms(fmu, request):
    assert validate_fmu(str(fmu.path)) == []
    platforms = set(platforms_of(request.node.callspec.params["fmu"]))
    assert {path.name for path in (fmu.folder / "binaries").iterdir()} == platforms


@pytest.mark.skipif(
    (platform.system(), platform.machine()) != ("Linux", "x86_64"), reason="runs linux64"
)
def test_the_linux_binary_of_ziglang_has_the_bits_of_the_kernel(fmu, table):
    asked = wrenches_of(table, 50, span=1.2)
    batch = packed(table).batch(asked)
    with fmu.running() as instance:
        for place, wrench in enumerate(asked):
            instance.setReal(LOADS, wrench)
            np.testing.assert_array_equal(instance.getReal(OUTPUTS), batch.outputs[place])
            np.testing.assert_array_equal(instance.getReal(BARS), batch.errors[place])


@OF_ALL
def test_the_arm_linux_binary_is_one_of_that_processor(fmu):
    content = binary(fmu, "aarch64-linux", ".so")
    assert content[:4] == b"\x7fELF"
    assert struct.unpack_from("<H", content, 18)[0] == 183  # EM_AARCH64
    assert all(name.encode() in content for name in FUNCTIONS)


@OF_ALL
def test_the_windows_binary_exports_the_functions_of_fmi_and_no_others(fmu):
    content = binary(fmu, "win64", ".dll")
    assert binaries.pe_machine(content) == 0x8664
    assert binaries.pe_exports(content) == FUNCTIONS


@OF_ALL
def test_the_macos_binary_has_a_signed_slice_for_each_processor_with_the_functions_of_fmi(fmu):
    slices = binaries.macho_slices(binary(fmu, "darwin64", ".dylib"))
    assert [item.processor for item in slices] == [X86_64, ARM64]
    for item in slices:
        assert item.offset % 2**14 == 0
        assert item.exponent == 14
        assert struct.unpack_from("<I", item.content, 4)[0] == item.processor
        assert binaries.macho_exports(item.content) - LINKERS == FUNCTIONS
        assert binaries.macho_name(item.content) == "@rpath/fmu.dylib"
    # macOS on arm64 loads no code without a signature.
    kinds = [kind for kind, _ in binaries.macho_commands(slices[1].content)]
    assert binaries.CODE_SIGNATURE in kinds


def test_no_binary_holds_a_path_of_the_machine_that_compiled_it(fmu, request):
    for place in platforms_of(request.node.callspec.params["fmu"]):
        content = binary(fmu, place, PLATFORMS[place].ending)
        assert str(HEADER.parents[3]).encode() not in content
        assert str(Path.home() / ".cache").encode() not in content


def test_a_universal_file_holds_its_slices_as_they_were():
    parts = [struct.pack("<3I", 0xFEEDFACF, kind, 3) + bytes(20000) for kind in (X86_64, ARM64)]
    slices = binaries.macho_slices(universal(parts))
    assert [item.content for item in slices] == parts
    assert [item.offset for item in slices] == [2**14, 3 * 2**14]


def test_an_unknown_platform_is_refused_with_those_there_are():
    with pytest.raises(
        platforms.UnknownPlatformError,
        match=r"platforms names 'amiga', for .* linux64, aarch64-linux",
    ):
        platforms_of("linux64,amiga")


def test_a_list_of_platforms_keeps_its_order_without_repetition(monkeypatch):
    monkeypatch.setattr(platforms.build, "compiler_command", lambda target: ["zig"])
    assert platforms_of("win64, linux64,win64") == ("win64", "linux64")
    assert platforms_of("all") == tuple(PLATFORMS)


def test_without_ziglang_platforms_are_refused_before_the_server_is_called(monkeypatch, tmp_path):
    monkeypatch.setattr(platforms.build.importlib.util, "find_spec", lambda name: None)
    with running_stub() as stub:
        words = ["export", "bar", str(tmp_path / "bar.fmu"), "--platforms", "all"]
        run = CliRunner().invoke(app, [*words, "--server", stub.url])
        assert stub.seen == []
    assert isinstance(run.exception, KernelBuildError)
    assert "pip install ziglang" in str(run.exception)


def test_an_fmu_of_this_machine_needs_no_ziglang(table, monkeypatch):
    monkeypatch.setattr(platforms, "_compiled", lambda ending, target=None: repr(target).encode())
    monkeypatch.setattr(platforms.build, "compiler_command", lambda target=None: ["cc"])
    monkeypatch.setattr(platforms.platform, "system", lambda: "Linux")
    monkeypatch.setattr(platforms.platform, "machine", lambda: "x86_64")
    created = make_fmu("plate", packed(table))
    assert created.platforms == ("linux64",)
    with zipfile.ZipFile(BytesIO(created.content)) as archive:
        assert archive.read("binaries/linux64/plate.so") == b"None"
