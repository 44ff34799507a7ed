"""Reading ``[[material]]``: isotropic, orthotropic or neo-Hookean."""

from __future__ import annotations

from wrenchbook.fea.bundle.axes import read_axes
from wrenchbook.fea.spec.orthotropic import MOST_ISOTROPIC_RATIO, Orthotropic
from wrenchbook.fea.spec.schema import LAWS, Material
from wrenchbook.fea.spec.toml_table import Keys


def read_material(keys: Keys) -> Material | None:
    """Return one ``[[material]]``."""
    region = keys.text("region")
    law = keys.choice("law", LAWS, required=False) or "isotropic"
    if law == "orthotropic":
        own = _orthotropic(keys)
        constants = None if own is None else (max(own.youngs_moduli), own.isotropic_ratio)
    else:
        own, constants = None, _isotropic(keys)
    density = keys.number("density", "kg/m^3", above=0.0, required=False)
    strength = keys.number("yield_strength", "Pa", above=0.0, required=False)
    keys.close()
    if region is None or constants is None:
        return None
    return Material(region, *constants, density, strength, law, own)


def _isotropic(keys: Keys) -> tuple[float, float] | None:
    modulus = keys.number("youngs_modulus", "Pa", above=0.0)
    ratio = keys.number("poisson_ratio", "no unit", above=-1.0, below=0.5)
    return None if modulus is None or ratio is None else (modulus, ratio)


def _orthotropic(keys: Keys) -> Orthotropic | None:
    """Return nine constants and their directions; None if no material can have them."""
    young = _three(keys, "youngs_modulus", "E1, E2, E3", "Pa", positive=True)
    ratios = _three(keys, "poisson_ratio", "nu12, nu13, nu23", "no unit", positive=False)
    shears = _three(keys, "shear_modulus", "G12, G13, G23", "Pa", positive=True)
    axes = read_axes(keys)
    if young is None or ratios is None or shears is None or axes is None:
        return None
    x, y, z = ((float(row[0]), float(row[1]), float(row[2])) for row in axes)
    own = Orthotropic(young, ratios, shears, (x, y, z))
    if not own.stable:
        message = (
            "no material has these: some strain would give energy back. Each |nu_ij| must be below "
            "sqrt(E_i / E_j); nu12 is the strain along 2 when pulled along 1 (nu21 = nu12 E2 / E1)"
        )
        keys.wrong("poisson_ratio", message)
        return None
    if own.isotropic_ratio > MOST_ISOTROPIC_RATIO:
        message = (
            f"the material keeps its volume like an isotropic one of {own.isotropic_ratio:.3g}; "
            f"orthotropic cells lock (are too stiff) above {MOST_ISOTROPIC_RATIO:g}"
        )
        keys.wrong("poisson_ratio", message)
        return None
    return own


def _three(
    keys: Keys, key: str, which: str, unit: str, positive: bool
) -> tuple[float, float, float] | None:
    values = keys.numbers(key, 3, f"{unit} ({which})")
    if values is None:
        return None
    if positive and min(values) <= 0.0:
        keys.wrong(key, f"must be above 0 ({unit}), all three")
        return None
    return values[0], values[1], values[2]
