"""Reading ``[inputs]``, and what the materials need for it."""

from __future__ import annotations

from pathlib import Path

from wrenchbook.fea.spec.schema import ACCELERATIONS, TEMPERATURE, Interface, Material, ScalarInput
from wrenchbook.fea.spec.toml_table import Keys, bundle_file

_UNITS = ("degC", "K")
_ABSOLUTE_ZERO = {"degC": -273.15, "K": 0.0}
_LARGEST_EXPANSION = 1e-2  # 1/K: rubber has 2e-4; a number without its 1e-6 is above


def read_inputs(top: Keys, folder: Path) -> tuple[ScalarInput, ...]:
    """Return ``[inputs]``: the temperature and the three accelerations, those that are given."""
    keys = top.table("inputs", required=False)
    if keys is None:
        return ()
    warm = keys.table(TEMPERATURE, required=False)
    pulled = keys.table("acceleration", required=False)
    keys.close()
    found = [] if warm is None else [_temperature(top, warm, folder)]
    found += [] if pulled is None else _acceleration(pulled)
    return tuple(one for one in found if one is not None)


def _temperature(top: Keys, keys: Keys, folder: Path) -> ScalarInput | None:
    unit = keys.choice("unit", _UNITS, required=False) or _UNITS[0]
    ends = keys.numbers("range", 2, unit)
    reference = keys.number("reference", unit)
    field = bundle_file(keys, "field", folder, required=False)
    if field is not None and "mesh" not in top:
        keys.wrong("field", "needs a [mesh]: a measured part has no nodes; leave it out")
    keys.close()
    if ends is None or reference is None:
        return None
    if ends[0] >= ends[1]:
        keys.wrong("range", f"must rise from low to high, not [{ends[0]:g}, {ends[1]:g}]")
    for key, lowest in (("range", min(ends)), ("reference", reference)):
        if lowest < _ABSOLUTE_ZERO[unit]:
            message = f"{lowest:g} {unit} is below absolute zero, {_ABSOLUTE_ZERO[unit]:g} {unit}"
            keys.wrong(key, message)
    return ScalarInput(TEMPERATURE, unit, ends[0], ends[1], reference, field)


def _acceleration(keys: Keys) -> list[ScalarInput]:
    most = keys.numbers("range", len(ACCELERATIONS), "m/s^2") or []
    keys.close()
    if most and min(most) <= 0:
        keys.wrong("range", "must be three numbers above 0 in m/s^2: each plus and minus its own")
    return [
        ScalarInput(name, "m/s^2", -own, own)
        for name, own in zip(ACCELERATIONS, most, strict=False)
    ]


def read_expansion(keys: Keys, law: str | None) -> tuple[float, float, float] | None:
    """Return a material's ``thermal_expansion`` in 1/K: a number, or three if it is orthotropic."""
    key = "thermal_expansion"
    if law == "orthotropic":
        values = keys.numbers(key, 3, "1/K (along its axes)", required=False)
    else:
        value = keys.number(key, "1/K", required=False)
        values = None if value is None else [value] * 3
    if values is None:
        return None
    if max(map(abs, values)) > _LARGEST_EXPANSION:
        message = f"is above {_LARGEST_EXPANSION:g} 1/K, more than any solid's; aluminium has 23e-6"
        keys.wrong(key, message)
    return values[0], values[1], values[2]


def check_inputs(
    top: Keys,
    further: tuple[ScalarInput, ...],
    materials: tuple[Material | None, ...],
    interfaces: list[Interface | None],
) -> None:
    """Note what a component with further inputs lacks, or cannot have."""
    names = [one.name for one in further]
    if not names:
        return
    if "deck" in top:
        message = "a [deck] takes none; the embedded solver and measured tables do"
        top.wrong(further[0].key, message)
    for one in interfaces:
        if one is not None and one.name in names:
            top.wrong("interface", f'none may have the name "{one.name}", which is an input\'s')
    if TEMPERATURE in names:
        for i, material in enumerate(materials):
            if material is not None and material.thermal_expansion is None:
                message = "missing; with [inputs.temperature] every material needs it, in 1/K"
                top.wrong(f"material[{i}].thermal_expansion", message)
            if material is not None and material.law == "neo-hookean":
                message = (
                    'takes no [inputs.temperature]; of small strains "isotropic" is the same law'
                )
                top.wrong(f"material[{i}].law", message)
    if ACCELERATIONS[0] in names:
        check_densities(top, materials, "[inputs.acceleration]")


def check_densities(top: Keys, materials: tuple[Material | None, ...], key: str) -> None:
    """Note the materials without the density that `key` needs."""
    for i, material in enumerate(materials):
        if material is not None and material.density is None:
            message = f"missing; {key} needs each material's density, in kg/m^3"
            top.wrong(f"material[{i}].density", message)
