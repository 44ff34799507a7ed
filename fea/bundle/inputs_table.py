"""Reading ``[inputs]``, and what the materials need for it."""

from __future__ import annotations

from wrenchbook.fea.spec.problems import BundleProblem
from wrenchbook.fea.spec.schema import Interface, Material, Temperature
from wrenchbook.fea.spec.toml_table import Keys

_UNIT = "K or °C"
_LARGEST_EXPANSION = 1e-2  # 1/K: rubber has 2e-4; a number without its 1e-6 is above


def read_inputs(top: Keys) -> Temperature | None:
    """Return ``[inputs]``: the temperature, if it is one."""
    keys = top.table("inputs", required=False)
    if keys is None:
        return None
    own = keys.table("temperature")
    keys.close()
    return None if own is None else _temperature(own)


def _temperature(keys: Keys) -> Temperature | None:
    ends = keys.numbers("range", 2, _UNIT)
    reference = keys.number("reference", _UNIT)
    keys.close()
    if ends is None or reference is None:
        return None
    if ends[0] >= ends[1]:
        keys.wrong("range", f"must rise from low to high, not [{ends[0]:g}, {ends[1]:g}]")
    return Temperature(ends[0], ends[1], reference)


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


def check_temperature(
    top: Keys,
    temperature: Temperature | None,
    materials: tuple[Material | None, ...],
    interfaces: list[Interface | None],
) -> None:
    """Note what a component with a temperature lacks, or cannot have."""
    if temperature is None:
        return
    key = "inputs.temperature"
    if "deck" in top or "mesh" not in top:
        top.wrong(key, "needs a [mesh] and no [deck]: the embedded solver alone takes it")
    if any(one is not None and one.name == "temperature" for one in interfaces):
        top.wrong("interface", 'none may have the name "temperature", which is an input\'s')
    for i, material in enumerate(materials):
        if material is None:
            continue
        if material.thermal_expansion is None:
            message = f"missing; with [{key}] every material needs it, in 1/K"
            where = f"material[{i}].thermal_expansion"
            top.problems.append(BundleProblem(where, message))
        if material.law == "neo-hookean":
            message = f'takes no [{key}]; of small strains "isotropic" is the same law'
            top.problems.append(BundleProblem(f"material[{i}].law", message))
