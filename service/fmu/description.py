"""modelDescription.xml of an FMU 2.0: variables, units and dependencies of a table."""

from __future__ import annotations

import re
from xml.etree import ElementTree

from wrenchbook.service.contract import MOMENT_POINT
from wrenchbook.service.fmu.platforms import SOURCES
from wrenchbook.surrogate.table.space import DEFAULT, Space

# Exponents of the base units.
_UNITS: dict[str, dict[str, str]] = {
    "N": {"kg": "1", "m": "1", "s": "-2"},
    "N.m": {"kg": "1", "m": "2", "s": "-2"},
    "m": {"m": "1"},
    "rad": {"rad": "1"},
    "K": {"K": "1"},
    "degC": {"K": "1", "offset": "273.15"},
    "m/s2": {"m": "1", "s": "-2"},
}
_CONTRACT = (
    "wrench acting ON the component at its interface point where it is now (it moves with the "
    "section), in axes fixed to the undeformed interface frame; displacement of the same point in "
    "the same axes, rotation as a rotation vector"
)
_COVERAGE = (
    "0 covered, 1 thin, 2 outside: a displacement that is not covered is an estimate, and its "
    "error bar may be wrong"
)
_WITHIN = (
    "1 if the whole error bar of every displacement is within the tolerance, the solver's own "
    "error included, 0 if not, -1 where that is not known"
)
_STEPS = {"canHandleVariableCommunicationStepSize": "true"}  # attribute of co-simulation only
_TOLERANCE = (
    "limit of a covered answer's interpolation error, and of the whole error bar for "
    "within_tolerance; 0: the component's own. Give both or none"
)


def identifier_of(component: str) -> str:
    """Return a component's name as a C identifier, as FMI requires."""
    word = re.sub(r"[^A-Za-z0-9_]", "_", component)
    return word if word[:1].isalpha() else f"fmu_{word}"


def describe(component: str, guid: str, tool: str, summary: str, space: Space = DEFAULT) -> bytes:
    """Return modelDescription.xml.

    `tool` is program and version, `summary` the table's version, its rows and its method.
    """
    root = ElementTree.Element(
        "fmiModelDescription",
        fmiVersion="2.0",
        modelName=component,
        guid=guid,
        description=f"{summary}; {_CONTRACT}",
        generationTool=tool,
        variableNamingConvention="flat",
        numberOfEventIndicators="0",
    )
    abilities = {
        "modelIdentifier": identifier_of(component),
        "canGetAndSetFMUstate": "true",
        "canSerializeFMUstate": "true",
        "providesDirectionalDerivative": "true",
        "canNotUseMemoryManagementFunctions": "true",  # the table is mapped
    }
    for kind, more in (("ModelExchange", {}), ("CoSimulation", _STEPS)):
        interface = ElementTree.SubElement(root, kind, abilities | more)
        files = ElementTree.SubElement(interface, "SourceFiles")
        for name in SOURCES:
            ElementTree.SubElement(files, "File", name=name)

    definitions = ElementTree.SubElement(root, "UnitDefinitions")
    units = ("N", "N.m", "m", "rad", *(_unit(load.unit) for load in space.inputs))
    for name in dict.fromkeys(units):
        unit = ElementTree.SubElement(definitions, "Unit", name=name)
        ElementTree.SubElement(unit, "BaseUnit", _UNITS.get(name, {}))

    categories = ElementTree.SubElement(root, "LogCategories")
    for name in ("logStatusWarning", "logStatusError"):
        ElementTree.SubElement(categories, "Category", name=name)
    ElementTree.SubElement(root, "DefaultExperiment", startTime="0", stopTime="1")
    variables = ElementTree.SubElement(root, "ModelVariables")
    _add_variables(variables, space)
    _add_structure(ElementTree.SubElement(root, "ModelStructure"), variables)
    ElementTree.indent(root)
    return ElementTree.tostring(root, encoding="UTF-8", xml_declaration=True)


def _add_structure(structure: ElementTree.Element, variables: ElementTree.Element) -> None:
    """Add the dependencies of the outputs, without delay; variables are numbered from 1.

    Each output depends on all inputs, and an Integer on the fixed tolerances too. Only
    InitialUnknowns name these: of the section Outputs inputs alone are knowns (FMI 2.0, 2.2.8).
    """
    numbers: dict[str | None, list[str]] = {}
    for number, variable in enumerate(variables, 1):
        numbers.setdefault(variable.get("causality"), []).append(str(number))
    for part in ("Outputs", "InitialUnknowns"):
        unknowns = ElementTree.SubElement(structure, part)
        for index in numbers["output"]:
            knowns = numbers["input"]
            if part == "InitialUnknowns" and variables[int(index) - 1].find("Integer") is not None:
                knowns = [*knowns, *numbers["parameter"]]
            ElementTree.SubElement(unknowns, "Unknown", index=index, dependencies=" ".join(knowns))


def _unit(text: str) -> str:
    """Return a unit of a table's space in FMI's spelling: ``N.m``, ``m/s2``."""
    return text.replace("·", ".").replace("²", "2")


def _add_variables(root: ElementTree.Element, space: Space) -> None:
    """Add the variables; their value references are their positions, as in c/fmu.h."""
    for load in space.inputs:
        unit = _unit(load.unit)
        kind = "input" if load.kind == "scalar" else "load"
        point = f", about {MOMENT_POINT}" if load.kind == "moment" else ""
        # The loads of a single interface are Fx to Mz.
        only = not load.interface and load.kind != "scalar"
        name = load.name.capitalize() if only else load.name
        start = {"unit": unit, "start": f"{load.zero:.17g}"}
        _add(root, name, "input", f"{kind}, {unit}{point}", start)
    for prefix, text in (("", "displacement"), ("error_", "95 % error bar of the displacement")):
        for output in space.outputs:
            _add(root, prefix + output.name, "output", text, {"unit": output.unit})
    _add(root, "coverage", "output", _COVERAGE, {}, "discrete", "Integer")
    for name, unit in (("translation", "m"), ("rotation", "rad")):
        start = {"unit": unit, "start": "0", "min": "0"}
        _add(root, f"tolerance_{name}", "parameter", _TOLERANCE, start, "fixed")
    _add(root, "within_tolerance", "output", _WITHIN, {}, "discrete", "Integer")


def _add(
    root: ElementTree.Element,
    name: str,
    causality: str,
    description: str,
    attributes: dict[str, str],
    variability: str = "continuous",
    fmi_type: str = "Real",
) -> None:
    """Append a variable of modelDescription.xml; its reference is its index in the file, from 0."""
    variable = ElementTree.SubElement(
        root,
        "ScalarVariable",
        name=name,
        valueReference=str(len(root)),
        causality=causality,
        variability=variability,
        description=description,
    )
    ElementTree.SubElement(variable, fmi_type, attributes)
