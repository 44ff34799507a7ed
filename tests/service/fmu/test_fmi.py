"""How an FMU behaves in a simulation tool, and under attack."""

import shutil
import threading

import fmpy
import numpy as np
import pytest
from fmpy.fmi2 import FMU2Model, FMU2Slave
from fmpy.simulation import simulate_fmu
from fmpy.validation import validate_fmu

from tests.service.fmu.made import (
    BARS,
    COVERAGE,
    LOADS,
    OUTPUTS,
    TOLERANCE,
    WITHIN,
    answers,
    opened,
    packed,
    wrenches_of,
)

NAMES = ["Fx", "Fy", "Fz", "Mx", "My", "Mz", "ux", "uy", "uz", "rx", "ry", "rz"]
INNER = [150.0, -100.0, -600.0, 10.0, 20.0, 5.0]


def test_fmpy_finds_nothing_to_object_to(fmu):
    assert validate_fmu(str(fmu.path)) == []


def test_the_variables_their_units_and_their_causality_are_those_of_the_contract(fmu):
    reported = {variable.name: variable for variable in fmu.description.modelVariables}
    assert list(reported) == [
        *NAMES,
        *[f"error_{name}" for name in NAMES[6:]],
        "coverage",
        "tolerance_translation",
        "tolerance_rotation",
        "within_tolerance",
    ]
    assert [reported[name].unit for name in ("Fx", "Mz", "uz", "rx", "error_rz")] == [
        "N",
        "N.m",
        "m",
        "rad",
        "rad",
    ]
    assert {reported[name].causality for name in NAMES[:6]} == {"input"}
    for name in ("coverage", "within_tolerance"):
        assert (reported[name].type, reported[name].causality) == ("Integer", "output")
    units = {definition.name: definition.baseUnit for definition in fmu.description.unitDefinitions}
    assert (units["N.m"].kg, units["N.m"].m, units["N.m"].s) == (1, 2, -2)


@pytest.mark.parametrize(("kind", "lag"), [("CoSimulation", 0.25), ("ModelExchange", 0.0)])
def test_fmpy_simulates_it_either_way_with_the_tables_numbers(fmu, table, kind, lag):
    asked = wrenches_of(table, 2)
    names = [variable.name for variable in fmu.description.modelVariables]
    columns = [(name, float) for name in ("time", *names[:6])]
    ramp = np.array([(0.0, *asked[0]), (1.0, *asked[1])], dtype=columns)
    outputs = names[6:12]
    reported = simulate_fmu(
        str(fmu.path),
        stop_time=1.0,
        output_interval=0.25,
        input=ramp,
        output=outputs,
        fmi_type=kind,
    )
    assert len(reported) >= 5
    for row in reported[1:]:  # in co-simulation FMPy sets inputs before a step and reads after it
        wrench = asked[0] + (row["time"] - lag) * (asked[1] - asked[0])
        expected = packed(table).batch([wrench]).outputs[0]
        np.testing.assert_allclose([row[name] for name in outputs], expected, rtol=0, atol=1e-12)


def test_inputs_are_zero_at_first_and_after_a_reset(fmu):
    with fmu.running() as instance:
        first = instance.getReal(LOADS + OUTPUTS)
        instance.setReal(LOADS, INNER)
        assert instance.getReal(OUTPUTS) != first[6:]
        instance.reset()
        instance.setupExperiment()
        instance.enterInitializationMode()
        assert instance.getReal(LOADS + OUTPUTS) == first


def test_a_state_is_kept_put_back_and_written(fmu):
    with fmu.running() as instance, fmu.running() as other:
        instance.setReal(LOADS, INNER)
        reported = instance.getReal(OUTPUTS + BARS)
        state = instance.getFMUstate()
        written = instance.serializeFMUstate(state)
        instance.setReal(LOADS, [0.0] * 6)
        assert instance.getReal(OUTPUTS + BARS) != reported
        instance.setFMUstate(state)
        assert instance.getReal(OUTPUTS + BARS) == reported
        instance.freeFMUstate(state)
        again = other.deSerializeFMUstate(written)
        other.setFMUstate(again)
        assert other.getReal(LOADS + OUTPUTS) == INNER + reported[:6]
        other.freeFMUstate(again)


def test_instances_in_many_threads_do_not_disturb_each_other(fmu, table):
    asked = [wrenches_of(table, 300, seed=seed) for seed in range(6)]
    results = [None] * len(asked)

    def run(place):
        with fmu.running() as instance:
            results[place] = answers(instance, asked[place])

    threads = [threading.Thread(target=run, args=(place,)) for place in range(len(asked))]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join(600)
    with fmu.running() as alone:
        for reported, wrenches in zip(results, asked, strict=True):
            for mine, theirs in zip(answers(alone, wrenches), reported, strict=True):
                np.testing.assert_array_equal(mine, theirs)


# --- attacks


def serialized(instance):
    state = instance.getFMUstate()
    written = instance.serializeFMUstate(state)
    instance.freeFMUstate(state)
    return written


# fmt: off
NO_NUMBERS = (np.nan, np.inf, -np.inf)
WRONG = {
    **{f"load {x}": lambda on, x=x: on.setReal(LOADS, [1.0] * 5 + [x]) for x in NO_NUMBERS},
    **{f"step {x}": lambda on, x=x: on.doStep(0.0, x) for x in (-1.0, np.nan, np.inf)},
    **{f"set {x}": lambda on, x=x: on.setReal(x, [1.0] * len(x))
       for x in ([6], [18], [99], [2**32 - 1], [0, 6], TOLERANCE)},
    "read a real that is none": lambda on: on.getReal([99]),
    "read an integer that is none": lambda on: on.getInteger([0]),
    "state cut off": lambda on: on.deSerializeFMUstate(serialized(on)[:-1]),
    "state of another table": lambda on: on.deSerializeFMUstate(b"x" + serialized(on)[1:]),
    "state of nothing": lambda on: on.deSerializeFMUstate(b""),
    "state of zeros": lambda on: on.deSerializeFMUstate(bytes(len(serialized(on)))),
}
EARLY = {
    **{f"tolerance {x}": lambda on, x=x: on.setReal(TOLERANCE, [x, 1.0])
       for x in (-1.0, np.nan, np.inf)},
    "exit": lambda on: on.exitInitializationMode(),
    "terminate": lambda on: on.terminate(),
    "step": lambda on: on.doStep(0.0, 0.1),
}
# fmt: on


@pytest.mark.parametrize("call", WRONG.values(), ids=WRONG)
def test_a_call_that_is_wrong_is_refused_and_changes_nothing(fmu, call):
    with fmu.running() as instance:
        instance.setReal(LOADS, INNER)
        before = instance.getReal(LOADS + OUTPUTS + BARS)
        with pytest.raises(fmpy.fmi1.FMICallException):
            call(instance)
        assert instance.getReal(LOADS + OUTPUTS + BARS) == before


@pytest.mark.parametrize("call", EARLY.values(), ids=EARLY)
def test_a_call_before_its_time_or_a_tolerance_that_is_none_is_refused(fmu, call):
    instance = fmu.instance()
    with pytest.raises(fmpy.fmi1.FMICallException):
        call(instance)
    instance.freeInstance()


def test_a_refusal_says_why(fmu):
    with fmu.running() as instance:
        with pytest.raises(fmpy.fmi1.FMICallException):
            instance.setReal(LOADS, [np.nan] * 6)
        assert "finite" in instance.said[-1]


@pytest.mark.parametrize("method", ["kriging", "griddata", "additive", "linear"])
def test_a_huge_or_tiny_load_is_flagged_and_never_ends_the_program(table, tmp_path, method):
    with opened(table, tmp_path, method).running() as instance:
        for load in LOADS:
            for number in (1e300, -1e300, 1.7e308, 1e9):
                instance.setReal(LOADS, [0.0] * load + [number] + [0.0] * (5 - load))
                assert instance.getInteger(COVERAGE) == [2]
                instance.getReal(OUTPUTS + BARS)
                instance.getDirectionalDerivative(OUTPUTS, [load], [1.0])
            instance.setReal(LOADS, [0.0] * load + [5e-324] + [0.0] * (5 - load))
            assert np.isfinite(instance.getReal(OUTPUTS)).all()
        instance.setReal(LOADS, [1e300] * 6)
        assert instance.getInteger(COVERAGE) == [2]


def test_nothing_is_set_once_it_is_terminated(fmu):
    with fmu.running() as instance:
        instance.setReal(LOADS, INNER)
        reported = instance.getReal(OUTPUTS)
        instance.terminate()
        with pytest.raises(fmpy.fmi1.FMICallException):
            instance.setReal(LOADS, INNER)
        assert "reset" in instance.said[-1]
        assert instance.getReal(OUTPUTS) == reported
        with pytest.raises(fmpy.fmi1.FMICallException):
            instance.doStep(0.0, 0.1)
        instance.reset()
        instance.setReal(LOADS, INNER)


def test_a_wrong_guid_is_refused_by_name(fmu, capfd):
    with pytest.raises(Exception, match="nstantiate"):
        fmu.instance(guid="{00000000-0000-0000-0000-000000000000}")


@pytest.mark.parametrize("damage", ["gone", "short", "long", "bit", "empty", "stranger"])
def test_a_table_that_is_gone_or_damaged_is_refused(fmu, tmp_path, damage):
    folder = tmp_path / "a folder ü%"
    shutil.copytree(fmu.folder, folder)
    table = folder / "resources" / "table.wbt"
    content = bytearray(table.read_bytes())
    if damage == "bit":
        content[len(content) // 2] ^= 1
    kept = {
        "short": content[:-8],
        "long": content + bytes(8),
        "bit": content,
        "empty": b"",
        "stranger": b"x" * 4096,
    }
    if damage == "gone":
        table.unlink()
    else:
        table.write_bytes(kept[damage])
    with pytest.raises(Exception, match="nstantiate"):
        fmu.instance(folder=folder)


def test_a_folder_with_blanks_and_letters_of_any_language_is_found(fmu, tmp_path):
    folder = tmp_path / "a folder ü%20"
    shutil.copytree(fmu.folder, folder)
    instance = fmu.instance(folder=folder)
    instance.setReal(LOADS, INNER)
    assert instance.getInteger(COVERAGE)[0] in (0, 1)
    instance.freeInstance()


def test_a_change_of_coverage_is_an_event_of_model_exchange(fmu):
    with fmu.running(FMU2Model) as instance:
        assert instance.completedIntegratorStep() == (False, False)
        instance.setReal(LOADS, [1e6] * 6)
        assert instance.completedIntegratorStep() == (True, False)
        instance.enterEventMode()
        instance.newDiscreteStates()
        instance.enterContinuousTimeMode()
        assert instance.completedIntegratorStep() == (False, False)


def test_coverage_keeps_its_value_between_events_of_model_exchange(fmu):
    with fmu.running(FMU2Model) as instance:
        flags = [*COVERAGE, *WITHIN]
        before = instance.getInteger(flags)
        instance.setReal(LOADS, [1e6] * 6)
        assert instance.getInteger(flags) == before
        instance.enterEventMode()
        assert instance.getInteger(COVERAGE) == [2]
        instance.newDiscreteStates()
        instance.enterContinuousTimeMode()
        instance.setReal(LOADS, [0.0] * 6)
        assert instance.getInteger(COVERAGE) == [2]


def test_instances_come_and_go_without_leaving_memory_behind(fmu):
    resource = pytest.importorskip("resource")
    for _ in range(3):
        fmu.instance(FMU2Slave).freeInstance()
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    for _ in range(40):  # of some 3 MB each
        fmu.instance(FMU2Slave).freeInstance()
    assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before < 40_000  # kB


def test_every_moment_says_about_which_point_it_is(fmu):
    reported = {variable.name: variable.description for variable in fmu.description.modelVariables}
    for name in ("Mx", "My", "Mz"):
        assert reported[name] == "load, N.m, about the interface point where it is now"
    assert "interface point where it is now" in fmu.description.description


def test_a_directional_derivative_of_error_bars_is_what_they_differ_by(fmu, table):
    asked, step = wrenches_of(table, 1, 0.5)[0], 1e-4 * table.load_range.scale
    low, high = packed(table).batch([asked - step, asked + step]).errors
    with fmu.running() as instance:
        instance.setReal(LOADS, asked)
        result = instance.getDirectionalDerivative(BARS, LOADS, step)
    np.testing.assert_allclose(result, (high - low) / 2, rtol=1e-2)
