"""The exported C library, and the examples in C++ and C# that use it."""

import math
import os
import re
import shutil
import subprocess
import sys
import zipfile
from io import BytesIO
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from tests.service.fmu.made import cpp_compiler, need_compiler, packed, wrenches_of
from tests.service.stub_server import Answer, running_stub
from tests.slow import slow
from tests.surrogate.kernel.kinds import packed_of as packed_kind
from wrenchbook.service.cli.main import app
from wrenchbook.service.fmu.export import LIBRARY_FILES, make_library
from wrenchbook.surrogate.kernel import build as kernel_build
from wrenchbook.surrogate.packed.writer import pack

ROOT = Path(__file__).parents[3]
SCENES = ROOT / "data" / "scenes"
HEADER = (kernel_build.FOLDER / "wrenchbook.h").read_text()


@pytest.fixture(scope="module")
def folder(table, tmp_path_factory):
    """The exported library, unpacked."""
    result = tmp_path_factory.mktemp("library")
    with zipfile.ZipFile(BytesIO(make_library("plate_thin", packed(table)))) as archive:
        archive.extractall(result)
    return result


def run(program, *text, **more):
    command = [str(program), *map(str, text)]
    ran = subprocess.run(command, capture_output=True, text=True, timeout=600, check=False, **more)
    return ran.returncode, ran.stdout.splitlines(), ran.stderr


def compiled(command, **more):
    ran = subprocess.run(
        list(map(str, command)), capture_output=True, text=True, timeout=600, check=False, **more
    )
    assert ran.returncode == 0, ran.stdout + ran.stderr


def assert_answers_are_those_of_python(program, folder, table, mark=None):
    """A program's displacements and error bars are the kernel's to the bit."""
    known = packed(table)
    for wrench in wrenches_of(table, 8, span=1.2).tolist():
        code, lines, error = run(program, folder / "plate_thin.wbt", *map(repr, wrench))
        assert code == 0, error
        reply = known.answer(wrench)
        assert lines[0].split()[0] == reply.coverage
        pairs = [tuple(map(float, line.split(mark))) for line in lines[1:]]
        assert tuple(pair[0] for pair in pairs) == reply.outputs
        unknown = (math.nan,) * len(pairs)
        np.testing.assert_array_equal([pair[1] for pair in pairs], reply.error or unknown)


def assert_a_text_is_no_load(program, folder):
    """A program refuses a load that is no number, such as one with a decimal comma."""
    for text in ("1,5", "x", ""):
        code, lines, error = run(program, folder / "plate_thin.wbt", *"12345", text)
        assert (code, lines) == (1, [])
        assert f"'{text}' is not a number" in error


def readmes_line(folder, word):
    """The command of a README that begins with a word."""
    lines = [line.strip() for line in (folder / "README.txt").read_text().splitlines()]
    return next(line for line in lines if line.startswith(word))


@pytest.fixture(scope="module")
def example(folder):
    """The example, compiled by the README's line."""
    line = " ".join([*need_compiler(), readmes_line(folder, "cc ").removeprefix("cc ")])
    subprocess.run(line, shell=True, cwd=folder, check=True, timeout=600)
    return folder / "example"


def test_the_library_compiles_by_the_readmes_line_and_has_the_bits_of_python(
    example, folder, table
):
    subprocess.run(readmes_line(folder, "./"), shell=True, cwd=folder, check=True, timeout=600)
    assert_answers_are_those_of_python(example, folder, table)
    code, _, error = run(example, folder / "README.txt", *"123456")
    assert (code, "not a packed table" in error) == (1, True)
    assert_a_text_is_no_load(example, folder)


def test_the_example_takes_all_inputs_of_several_interfaces(example, tmp_path):
    known = packed_kind("two interfaces")
    with zipfile.ZipFile(BytesIO(make_library("ends", known))) as archive:
        archive.extractall(tmp_path)
    texts = readmes_line(tmp_path, "./example ").split()[1:]
    code, lines, error = run(example, *texts, cwd=tmp_path)
    assert code == 0, error
    assert tuple(float(line.split()[0]) for line in lines[1:]) == known.answer([1.0] * 12).outputs


@pytest.mark.parametrize("shared", ["ON", slow("OFF")])
def test_cmake_builds_and_installs_the_library_with_the_bits_of_python(
    folder, table, tmp_path, shared
):
    beside = Path(sys.executable).parent  # the wheel's
    cmake = shutil.which("cmake", path=f"{beside}{os.pathsep}{os.environ['PATH']}")
    if cmake is None or not any(map(shutil.which, ("make", "ninja"))):
        pytest.skip("no cmake, or neither make nor ninja")
    place = tmp_path / "build"
    environment = {**os.environ, "CC": " ".join(need_compiler())}
    shared_libs = f"-DBUILD_SHARED_LIBS={shared}"
    compiled([cmake, "-S", folder, "-B", place, shared_libs], env=environment)
    compiled([cmake, "--build", place])
    assert_answers_are_those_of_python(place / "example", folder, table)
    compiled([cmake, "--install", place, "--prefix", tmp_path / "out"])
    result = {path.name for path in (tmp_path / "out").rglob("*") if path.is_file()}
    assert result == {"wrenchbook.h", f"libwrenchbook.{'so' if shared == 'ON' else 'a'}"}


@pytest.fixture(scope="module")
def objects(folder, tmp_path_factory):
    """The library's sources, compiled."""
    result = tmp_path_factory.mktemp("objects")
    sources = [str(path) for path in (folder / "src").glob("*.c")]
    flags = [flag for flag in kernel_build.FLAGS if flag != "-DWB_SHARED"]
    compiled([*need_compiler(), *flags, f"-I{folder / 'include'}", "-c", *sources], cwd=result)
    return sorted(result.glob("*.o"))


def compiled_cpp(source, program, folder, objects):
    """Compile a program in C++ that includes the header, and link it with the library."""
    warn = ["-std=c++17", "-Wall", "-Wextra", "-pedantic", "-Werror"]
    places = [f"-I{place}" for place in (folder / "include", SCENES)]
    link = [*objects, "-lm", "-lpthread"]
    compiled([*cpp_compiler(), *warn, *places, "-o", program, source, *link])


def test_the_example_in_cpp_has_the_bits_of_python(folder, objects, table, tmp_path):
    program = tmp_path / "lookup"
    compiled_cpp(SCENES / "lookup.cpp", program, folder, objects)
    assert_answers_are_those_of_python(program, folder, table, "+-")
    assert run(program, folder / "plate_thin.wbt", 1, 2)[::2] == (1, "the table has 6 loads\n")
    code, _, error = run(program, folder / "README.txt", *"123456")
    assert (code, "not a packed table" in error) == (1, True)
    assert_a_text_is_no_load(program, folder)


JOINT = """
#include "joint.hpp"
#include <cstdio>
#include <cstdlib>
int main(int, char **words) {
    wrenchbook::Joint joint(words[1], 1e-3, 0.02);
    std::array<double, 36> inverse_mass{};
    for (int k = 0; k < 6; k++) inverse_mass[7 * k] = k < 3 ? 0.05 : 10;
    for (int k = 1; k <= 3; k++) {
        const auto wrench = joint.step({0, 0, -1e-4 * k, 1, 0, 0, 0}, {0, 0, -0.01}, inverse_mass);
        for (double load : wrench) std::printf("%.17g ", load);
        std::puts("");
    }
}
"""


def test_the_joint_in_cpp_has_the_bits_of_python(folder, objects, table, tmp_path):
    (tmp_path / "joint.cpp").write_text(JOINT)
    compiled_cpp(tmp_path / "joint.cpp", tmp_path / "joint", folder, objects)
    code, lines, error = run(tmp_path / "joint", folder / "plate_thin.wbt")
    assert code == 0, error
    steps = packed(table).joints(1)
    steps.velocities[0, 2] = -0.01
    steps.inverse_masses[0] = np.diag([0.05] * 3 + [10.0] * 3)
    for number, line in enumerate(lines, 1):
        steps.poses[0, 2] = -1e-4 * number
        steps.step(1e-3, 0.02)
        assert [float(load) for load in line.split()] == steps.replies["wrench"][0].tolist()
    assert number == 3


@pytest.mark.parametrize("name", ["gz_joint.cpp", "ros2_joint.cpp"])
def test_the_joints_examples_compile_against_stubs_of_their_engines(name, tmp_path):
    """Gazebo and ROS are not here: engine_stubs.hpp has their declarations."""
    source, here = SCENES / name, Path(__file__).parent
    for header in re.findall(r"#include <(\w+/.*)>", source.read_text()):
        (tmp_path / header).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / header).write_text('#include "engine_stubs.hpp"')
    warn = ["-std=c++17", "-Wall", "-Wextra", "-Werror", "-c", "-o", tmp_path / "example.o"]
    places = [f"-I{place}" for place in (kernel_build.FOLDER, tmp_path, here)]
    compiled([*cpp_compiler(), *warn, *places, source])


def test_the_zip_holds_the_table_the_sources_and_the_header_of_the_kernel(folder, table):
    assert (folder / "plate_thin.wbt").read_bytes() == b"".join(pack(table))
    for path in kernel_build.sources():
        place = "include" if path.name == "wrenchbook.h" else "src"
        assert (folder / place / path.name).read_bytes() == path.read_bytes()
    assert {path.name for path in folder.iterdir()} >= {"CMakeLists.txt", "example.c", "README.txt"}
    texts = [(folder / name).read_text() for name in ("CMakeLists.txt", "README.txt")]
    assert not re.search("@[A-Z]+@", "".join(texts))


def test_the_same_table_gives_the_same_zip(table):
    assert make_library("plate", packed(table)) == make_library("plate", packed(table))


def test_the_page_on_c_shows_the_example_of_the_zip():
    page = (ROOT / "data/docs/how-to/c.md").read_text()
    assert page.split("```c\n")[1].split("```")[0] == (LIBRARY_FILES / "example.c").read_text()


def test_the_command_writes_the_library_and_describes_it_as_json(table, tmp_path):
    path = tmp_path / "plate.zip"
    with running_stub() as stub:
        stub.answers(Answer(b"".join(pack(table)), kind="application/octet-stream"))
        words = ["export", "plate", str(path), "--json", "--server", stub.url]
        result = CliRunner().invoke(app, words)
    assert result.exit_code == 0, result.output
    assert f'"bytes": {path.stat().st_size}' in result.stdout
    assert path.read_bytes() == make_library("plate", packed(table))


C_SHARP = {"int32_t": "int", "int": "int", "int64_t": "long", "uint64_t": "ulong"}
C_SHARP |= {"double": "double", "const double *": "double*"}


def fields_of_header(name):
    """Type, name and whether an array, of each field of a struct of wrenchbook.h."""
    body = re.search(rf"typedef struct \{{([^}}]*)\}} {name};", HEADER)[1]
    body = re.sub(r"/\*.*?\*/", "", body, flags=re.S)
    results = []
    for kind, text in re.findall(r"((?:const )?\w+ \*?)\s*([^;]+);", body):
        for word in text.split(","):
            short = re.sub(r"\[.*", "", word).strip()
            results.append((C_SHARP.get(kind.strip(), kind.strip()), short, "[" in word))
    return results


def fields_of_csharp(name):
    """The same of a struct of Lookup.cs."""
    text = (SCENES / "Lookup.cs").read_text()
    body = re.search(rf"internal struct {name}\s*\{{([^}}]*)\}}", text)[1]
    result = []
    for fixed, kind, texts in re.findall(r"public (fixed )?(\S+) ([^;]+);", body):
        names = (re.sub(r"\[.*", "", word).strip() for word in texts.split(","))
        result += [(kind, short, bool(fixed)) for short in names]
    return result


@pytest.mark.parametrize("name", ["options", "reason", "reply"])
def test_the_structs_of_the_example_in_csharp_are_those_of_the_header(name):
    there = fields_of_header(f"wb_{name}")
    there = [("byte", *item[1:]) if item[0] == "wb_reason" else item for item in there]
    assert fields_of_csharp(name.capitalize()) == there
    assert len(there) > 1


def test_the_entry_points_of_the_example_in_csharp_are_those_of_the_header():
    text = (SCENES / "Lookup.cs").read_text()
    declared = dict(re.findall(r"WB_API [^;(]*?(\w+)\(([^;]*?)\);", HEADER))
    used = dict(re.findall(r"extern \w+ (\w+)\(\s*([^)]*)\);", text))
    assert len(used) == 6
    for name, parameters in used.items():
        there = [re.sub(r".*\W", "", part.strip()) for part in declared[name].split(",")]
        assert [part.split()[-1] for part in parameters.split(",")] == there
    assert set(re.findall(r"Native\.(wb_\w+)", text)) == set(used)


def test_the_sizes_in_the_example_in_csharp_are_those_of_the_header():
    text = (SCENES / "Lookup.cs").read_text()
    most, reasons = re.search(r"WB_MAX = (\d+), WB_MAX_REASONS = (\d+)", HEADER).groups()
    assert f"Max = {most}, MaxReasons = {reasons};" in text
    assert "reason[MaxReasons * 32]" in text  # 4 x int32 and 2 x double
