"""modelDescription.xml: what a simulation tool reads of an FMU."""

from __future__ import annotations

import re
from xml.etree import ElementTree

from wrenchbook.surrogate.kernel.build import sources as kernel_sources
from wrenchbook.surrogate.table.rows import OUTPUTS

LOADS = ("Fx", "Fy", "Fz", "Mx", "My", "Mz")
LOAD_UNITS = ("N",) * 3 + ("N.m",) * 3
OUTPUT_UNITS = ("m",) * 3 + ("rad",) * 3
SOURCES = (
    "fmu_instance.c",
    "fmu_variables.c",
    "fmu_simulation.c",
    *sorted(path.name for path in kernel_sources() if path.suffix == ".c"),
)
# Exponents of the base units.
_UNITS: dict[str, dict[str, str]] = {
    "N": {"kg": "1", "m": "1", "s": "-2"},
    "N.m": {"kg": "1", "m": "2", "s": "-2"},
    "m": {"m": "1"},
    "rad": {"rad": "1"},
}
_CONTRACT = (
    "wrench acting ON the component at its interface point, in the undeformed interface frame; "
    "displacement of the same point in the same frame, rotation as a rotation vector"
)
_COVERAGE = (
    "0 covered, 1 thin, 2 outside: a displacement that is not covered is an estimate, and its "
    "error bar may be wrong"
)
_WITHIN = (
    "1 if the whole bar of every displacement is within the tolerance, the solver's own error "
    "included, 0 if not, -1 where that is not known"
)
_TOLERANCE = "largest error bar of a covered answer; 0: the component's own. Give both or none"


def identifier_of(component: str) -> str:
    """Return a component's name as a C identifier, as FMI requires."""
    word = re.sub(r"[^A-Za-z0-9_]", "_", component)
    return word if word[:1].isalpha() else f"fmu_{word}"


def describe(component: str, guid: str, made_by: str, summary: str) -> bytes:
    """Return modelDescription.xml.

    Parameters
    ----------
    component, guid : str
    made_by : str
        Program and version.
    summary : str
        What answers: the table's version, its rows and its method.
    """
    identifier = identifier_of(component)
    root = ElementTree.Element(
        "fmiModelDescription",
        fmiVersion="2.0",
        modelName=component,
        guid=guid,
        description=f"{summary}; {_CONTRACT}",
        generationTool=made_by,
        variableNamingConvention="flat",
        numberOfEventIndicators="0",
    )
    abilities = {
        "modelIdentifier": identifier,
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
    _add_units(root)
    categories = ElementTree.SubElement(root, "LogCategories")
    for name in ("logStatusWarning", "logStatusError"):
        ElementTree.SubElement(categories, "Category", name=name)
    ElementTree.SubElement(root, "DefaultExperiment", startTime="0", stopTime="1")
    _add_variables(ElementTree.SubElement(root, "ModelVariables"))
    _add_structure(ElementTree.SubElement(root, "ModelStructure"))
    ElementTree.indent(root)
    return ElementTree.tostring(root, encoding="UTF-8", xml_declaration=True)


_INTEGERS = ("coverage", "within_tolerance")
_STEPS = {"canHandleVariableCommunicationStepSize": "true"}


def _add_units(root: ElementTree.Element) -> None:
    units = ElementTree.SubElement(root, "UnitDefinitions")
    for name, exponents in _UNITS.items():
        unit = ElementTree.SubElement(units, "Unit", name=name)
        ElementTree.SubElement(unit, "BaseUnit", exponents)


def _add_variables(root: ElementTree.Element) -> None:
    """Add the variables; their value references are their places, as c/fmu.h has them."""
    for name, unit in zip(LOADS, LOAD_UNITS, strict=True):
        _add(root, name, "input", f"load, {unit}", {"unit": unit, "start": "0"})
    for prefix, about in (("", "displacement"), ("error_", "95 % error bar of the displacement")):
        for name, unit in zip(OUTPUTS, OUTPUT_UNITS, strict=True):
            _add(root, prefix + name, "output", about, {"unit": unit})
    _add(root, "coverage", "output", _COVERAGE, {}, "discrete")
    for name, unit in (("translation", "m"), ("rotation", "rad")):
        start = {"unit": unit, "start": "0", "min": "0"}
        _add(root, f"tolerance_{name}", "parameter", _TOLERANCE, start, "fixed")
    _add(root, "within_tolerance", "output", _WITHIN, {}, "discrete")


def _add(
    root: ElementTree.Element,
    name: str,
    causality: str,
    about: str,
    attributes: dict[str, str],
    variability: str = "continuous",
) -> None:
    variable = ElementTree.SubElement(
        root,
        "ScalarVariable",
        name=name,
        valueReference=str(len(root)),
        causality=causality,
        variability=variability,
        description=about,
    )
    ElementTree.SubElement(variable, "Integer" if name in _INTEGERS else "Real", attributes)


def _add_structure(root: ElementTree.Element) -> None:
    """Add which outputs follow which inputs: each follows all six, at once."""
    inputs = " ".join(map(str, range(1, 7)))
    outputs = [*range(7, 20), len(LOADS) + 2 * len(OUTPUTS) + 1 + 2 + 1]  # the last variable
    for part in ("Outputs", "InitialUnknowns"):
        unknowns = ElementTree.SubElement(root, part)
        for index in outputs:
            ElementTree.SubElement(unknowns, "Unknown", index=str(index), dependencies=inputs)
