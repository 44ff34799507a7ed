"""Making an FMU: names, tables that none can hold, no compiler, the command."""

import subprocess
import zipfile
from io import BytesIO
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest
from typer import BadParameter

from tests.service.fmu.made import LOADS, OUTPUTS, Opened, need_compiler, packed
from tests.service.live import FULL, add_table, as_rows, full_wrenches, moved, served, tangents
from wrenchbook.service.cli.main import app
from wrenchbook.service.fmu import platforms
from wrenchbook.service.fmu.description import describe, identifier_of
from wrenchbook.service.fmu.export import Fmu, NotExportableError, make_fmu, make_library
from wrenchbook.service.fmu.platforms import FLAGS
from wrenchbook.surrogate.answer import UnknownMethodError
from wrenchbook.surrogate.build import build
from wrenchbook.surrogate.kernel.build import KernelBuildError
from wrenchbook.surrogate.table.rows import LoadRange, Rows
from wrenchbook.surrogate.table.space import Input, space_of

RANGE = LoadRange(-FULL, FULL)


@pytest.mark.parametrize(
    ("name", "identifier"),
    [("plate-2", "plate_2"), ("1rig", "fmu_1rig"), ("plate_thin", "plate_thin"), ("-x", "fmu__x")],
)
def test_a_name_that_is_no_c_identifier_is_made_one(name, identifier):
    assert identifier_of(name) == identifier


@pytest.mark.parametrize("name", ["plate-2", "1rig"])
def test_a_component_of_any_name_instantiates(table, tmp_path, name):
    need_compiler()
    created = Opened(make_fmu(name, packed(table)), tmp_path, name)
    assert created.description.modelName == name
    with created.running() as instance:
        instance.setReal(LOADS, [1.0] * 6)
        assert np.isfinite(instance.getReal(OUTPUTS)).all()


def test_the_same_table_gives_the_same_guid_and_another_table_another(table):
    first, again = (make_fmu("plate", packed(table)).content for _ in range(2))
    assert guid(first) == guid(again)
    assert guid(first) != guid(make_fmu("plate", packed(table), "griddata").content)
    assert guid(first) != guid(make_fmu("plate2", packed(table)).content)


def test_the_description_of_one_interface_is_the_stored_one():
    summary = "table version 1, 38 rows, method kriging"
    written = (Path(__file__).parent / "modelDescription.xml").read_bytes()
    assert describe("plate", "{0}", "wrenchbook 1", summary) == written


def test_initial_coverage_and_judgement_depend_on_the_tolerances_too():
    root = ElementTree.fromstring(describe("bar", "{}", "wrenchbook", "version 1"))
    names = [variable.get("name") for variable in root.iter("ScalarVariable")]
    tolerances = {"tolerance_translation", "tolerance_rotation"}
    depends = {}
    for unknown in root.iterfind("ModelStructure/InitialUnknowns/Unknown"):
        knowns = {names[int(index) - 1] for index in unknown.get("dependencies", "").split()}
        depends[names[int(unknown.get("index", "")) - 1]] = knowns - set(names[:6])
    judged = {"coverage": tolerances, "within_tolerance": tolerances}
    assert depends == {name: set() for name in names[6:18]} | judged
    for unknown in root.iterfind("ModelStructure/Outputs/Unknown"):
        assert unknown.get("dependencies") == "1 2 3 4 5 6"


def test_variables_of_several_interfaces_have_the_names_and_units_of_the_space():
    hot = Input("temperature", "degC", "scalar", zero=20.0)
    space = space_of(("left", "right"), [hot])
    root = ElementTree.fromstring(describe("ends", "{0}", "now", "a table", space))
    result = [(item.get("name"), item.find("*").attrib) for item in root.iter("ScalarVariable")]
    assert (result[0][0], result[0][1]["unit"]) == ("left.fx", "N")
    assert result[12] == ("temperature", {"unit": "degC", "start": "20"})
    names = [name for name, _ in result[13:]]
    assert names[:12] == list(space.output_names)
    assert names[12] == "error_left.ux"
    assert [item.get("name") for item in root.iter("Unit")][-1] == "degC"


def guid(content):
    with zipfile.ZipFile(BytesIO(content)) as archive:
        text = archive.read("modelDescription.xml").decode()
    return text.split('guid="')[1].split('"')[0]


@pytest.mark.parametrize("make", [make_fmu, make_library])
def test_a_table_without_rows_is_refused_with_what_to_do(make):
    with pytest.raises(NotExportableError, match="no rows; run wrenchbook fill"):
        make("plate", packed(build(Rows.empty(), RANGE)))


@pytest.mark.parametrize("make", [make_fmu, make_library])
def test_a_table_with_rows_only_beyond_its_range_is_refused(make):
    far = Rows.of([[1e6, 0, 0, 0, 0, 0]], [[1e-3, 0, 0, 0, 0, 0]])
    with pytest.raises(NotExportableError, match="outside its load range"):
        make("plate", packed(build(far, RANGE)))


def test_an_unknown_method_is_refused_by_name(table):
    with pytest.raises(UnknownMethodError, match="magic"):
        make_fmu("plate", packed(table), "magic")


def test_without_a_compiler_the_fmu_holds_sources_that_compile_elsewhere(
    table, tmp_path, monkeypatch
):
    compiler = need_compiler()
    with monkeypatch.context() as patch:
        patch.setenv("PATH", "")
        patch.delenv("CC", raising=False)
        patch.setattr(platforms.build.importlib.util, "find_spec", lambda name: None)
        created = make_fmu("plate-2", packed(table))
    assert created.platforms == ()
    result = Opened(created, tmp_path)
    assert not (result.folder / "binaries").exists()
    sources = result.folder / "sources"
    root = ElementTree.parse(result.folder / "modelDescription.xml")
    named = [item.get("name") for item in root.findall("CoSimulation/SourceFiles/File")]
    assert named == [item.get("name") for item in root.findall("ModelExchange/SourceFiles/File")]
    assert set(named) < {path.name for path in sources.iterdir()}
    assert "SHARED" in (sources / "CMakeLists.txt").read_text()
    assert "2-Clause BSD License" in (sources / "fmi2Functions.h").read_text()
    binary = result.folder / "binaries" / "linux64" / "plate_2.so"
    binary.parent.mkdir(parents=True)
    warn = ["-Wall", "-Wextra", "-pedantic", "-Werror"]
    command = [
        *compiler,
        *FLAGS,
        *warn,
        "-fPIC",
        "-shared",
        "-o",
        str(binary),
        *named,
        "-lm",
        "-lpthread",
    ]
    subprocess.run([*command, "-lm", "-lpthread"], cwd=sources, check=True, timeout=600)
    asked = table.rows.wrench[3] * 0.7
    with result.running() as instance:
        instance.setReal(LOADS, asked)
        reported = instance.getReal(OUTPUTS)
    np.testing.assert_array_equal(reported, packed(table).batch([asked]).outputs[0])


def test_a_compiler_that_fails_is_told_with_what_it_said(table, tmp_path, monkeypatch):
    broken = tmp_path / "cc"
    broken.write_text("#!/bin/sh\necho 'out of registers' >&2\nexit 1\n")
    broken.chmod(0o755)
    monkeypatch.setenv("CC", str(broken))
    platforms._compiled.cache_clear()
    with pytest.raises(KernelBuildError, match="out of registers"):
        make_fmu("plate", packed(table))


def test_undefined_behaviour_and_stray_reads_are_found_by_the_compilers_own_checks(table, tmp_path):
    """The whole of it, answered by a program with address and undefined-behaviour sanitizers."""
    compiler = need_compiler()
    created = Opened(make_fmu("plate", packed(table), "griddata"), tmp_path)
    program, wrenches = tmp_path / "rate", tmp_path / "wrenches.bin"
    asked = np.concatenate((full_wrenches(60) * 30, np.full((1, 6), 1e300), np.zeros((1, 6))))
    asked.astype("<f8").tofile(wrenches)
    sources = created.folder / "sources"
    flags = [
        "-std=c11",
        "-fopenmp-simd",
        "-g",
        "-O1",
        "-fsanitize=address,undefined",
        "-fno-sanitize-recover=all",
    ]
    library = tmp_path / "checked.so"
    files = [str(path) for path in sources.glob("*.c")]
    driver = str(Path(__file__).parent / "rate.c")
    for extra in (
        ["-fPIC", "-shared", *flags, "-o", str(library), *files, "-lm", "-lpthread"],
        [*flags, f"-I{sources}", "-rdynamic", "-o", str(program), driver, "-ldl"],
    ):
        subprocess.run([*compiler, *extra], check=True, timeout=600)
    resources = (created.folder / "resources").as_uri()
    command = [program, library, resources, created.guid, wrenches, "0.2"]
    ran = subprocess.run(list(map(str, command)), capture_output=True, text=True, timeout=600)
    assert ran.returncode == 0, ran.stderr[-3000:]


def test_the_command_downloads_the_table_and_writes_the_fmu(tmp_path, capsys):
    need_compiler()
    wrenches = full_wrenches(30)
    with served(tmp_path / "workspace") as client:
        add_table(client, "1rig", as_rows(wrenches, moved(wrenches), tangents(wrenches)))
        path = tmp_path / "rig.fmu"
        run(["export", "1rig", str(path), "--server", client.url, "--method", "griddata"])
        assert "griddata" in capsys.readouterr().out
        there = client.displacements("1rig", wrenches * 0.5, on_thin="estimate", method="griddata")
    with Opened(Fmu(path.read_bytes(), (), ""), tmp_path, "again").running() as instance:
        instance.setReal(LOADS, wrenches[0] * 0.5)
        reported = instance.getReal(OUTPUTS)
    np.testing.assert_allclose(reported, there.displacements[0], rtol=0, atol=1e-12)
    assert not list(tmp_path.glob("*.part"))


def test_the_command_refuses_a_method_for_other_formats(tmp_path):
    with pytest.raises(BadParameter, match=r"\.fmu"):
        run(["export", "plate", str(tmp_path / "t.csv"), "--method", "griddata"])


def run(text):
    app(text, standalone_mode=False)
