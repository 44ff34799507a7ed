"""Materials: isotropic ones, and orthotropic ones with their directions."""

from __future__ import annotations

from typing import Annotated, Literal

import numpy as np
from pydantic import AfterValidator, BeforeValidator

from wrenchbook.fea.spec.keys import (
    Axes,
    MistakesError,
    Number,
    Positive,
    Text,
    Three,
    array_table,
    counted,
    either,
    key,
    mesh_axes,
    table,
    unit_vector,
)

LAWS = ("isotropic", "orthotropic", "neo-hookean")
EXPANDING = ("isotropic", "orthotropic")  # the laws whose cells have a thermal strain

MAX_ISOTROPIC_RATIO = 0.4
"""Smallest value of `Orthotropic.isotropic_ratio` at which any kind of cells locks."""
_MAX_MODULUS = 1e100  # Pa: products of three, and their inverses, are finite numbers
_DIRECTION_LENGTHS = 1e-6, 1e6  # limits of a direction's length: two points in any length unit
# Least eigenvalue of the scaled compliance: below it a material is stable only by roundoff.
_MIN_EIGENVALUE = 1e-9
_MAX_EXPANSION = 1e-2  # 1/K: rubber has 2e-4; a number without its 1e-6 is above


def _small(expansion: tuple[float, float, float]) -> tuple[float, float, float]:
    """Refuse coefficients, 1/K, that lack their factor of 1e-6."""
    if abs(most := max(expansion, key=abs)) > _MAX_EXPANSION:
        end = f"{_MAX_EXPANSION:g} 1/K in size, not {most:g}"
        raise ValueError(f"must be at most {end}; for aluminium write 23e-6")
    return expansion


def _no_list(expansion: object) -> object:
    """Refuse a list, the form of the file; a tuple comes from a material that was read before."""
    if isinstance(expansion, list):
        raise ValueError("must be one finite number in 1/K; only an orthotropic material has three")
    return expansion


Expansion = Annotated[
    tuple[float, float, float],
    either(Number, Three),
    AfterValidator(lambda value: _small(value if isinstance(value, tuple) else (value,) * 3)),
    BeforeValidator(_no_list),
]


def _modulus(value: float) -> float:
    if not 1 / _MAX_MODULUS <= value <= _MAX_MODULUS:
        ends = f"from {1 / _MAX_MODULUS:g} to {_MAX_MODULUS:g} {{unit}}"
        raise ValueError(f"must be {ends}, not {value:g}; for steel write 210e9")
    return value


Modulus = Annotated[Positive, AfterValidator(_modulus)]
_Moduli = tuple[Modulus, Modulus, Modulus]


def _direction(axis: tuple[float, float, float]) -> tuple[float, float, float]:
    """Return a direction's unit vector; refuse one that is almost zero, or huge."""
    low, high = _DIRECTION_LENGTHS
    if not low < np.sqrt(sum(x * x for x in axis)) < high:
        wanted = f"a direction of a length from {low:g} to {high:g}"
        raise ValueError(f"must be {wanted}, such as [0, 0, 1], not {list(axis)}")
    return unit_vector(axis)


Direction = Annotated[Three, AfterValidator(_direction)]


@table
class Solid:
    """Keys of every material."""

    region: Text = key("", '"all"')
    """a cell group of the mesh; `all` is the cells without another material"""
    density: Positive | None = key("kg/m^3", "2700.0", default=None, kw_only=True)
    """for mass and natural frequency; required with `gravity` and `[inputs.acceleration]`"""
    yield_strength: Positive | None = key("Pa", "240e6", default=None, kw_only=True)
    """compared with the von Mises stress; `check` prints the largest under the full range"""


@table
class Material(Solid):
    """An isotropic elastic material; `thermal_expansion` is along x, y and z, all equal."""

    youngs_modulus: Modulus = key("Pa", "70e9")
    """Young's modulus; orthotropic: `[E1, E2, E3]`"""
    poisson_ratio: Number = key(
        "", "0.33", gt=-1, lt=0.5, expected_text="a number above -1 and below 0.5"
    )
    """Poisson's ratio, above -1 and below 0.5; orthotropic: `[nu12, nu13, nu23]`, where nu12 is
    along 2 when pulled along 1"""
    law: Literal["isotropic", "neo-hookean"] = key(
        "", '"neo-hookean"', default="isotropic", choices=LAWS, kw_only=True
    )
    """`isotropic`, `neo-hookean` (rubber; the constants are those of small strains) or
    `orthotropic`"""
    thermal_expansion: Expansion | None = key("1/K", "23e-6", default=None, kw_only=True)
    """required with `[inputs.temperature]`; orthotropic: three, along 1, 2, 3"""

    @property
    def orthotropic(self) -> Orthotropic | None:
        """The constants of the orthotropic law: none."""
        return None


@table
class Cylinder:
    """An axis about which directions are radial, circumferential and axial, in the mesh's axes."""

    point: Three = key("m", "[0, 0, 0]")
    """on the axis"""
    axis: Direction = key("", "[0, 0, 1]")
    """its direction, made a unit vector"""


@array_table
class Orthotropic(Solid):
    """An elastic material of nine constants in three directions square to each other."""

    youngs_moduli: Annotated[_Moduli, counted(3, names="[E1, E2, E3]")] = key(
        "Pa", "[135e9, 10e9, 10e9]", name="youngs_modulus"
    )
    """orthotropic: `[E1, E2, E3]`"""
    # Strain across over strain along, less, when pulled along the first of the two directions;
    # nu21 = nu12 E2 / E1.
    poisson_ratios: Annotated[Three, counted(3, names="[nu12, nu13, nu23]")] = key(
        "", "[0.3, 0.3, 0.4]", name="poisson_ratio"
    )
    """orthotropic: `[nu12, nu13, nu23]`; nu12 is along 2 when pulled along 1"""
    shear_moduli: Annotated[_Moduli, counted(3, names="[G12, G13, G23]")] = key(
        "Pa", "[5e9, 5e9, 3.5e9]", name="shear_modulus"
    )
    """orthotropic only: `[G12, G13, G23]`"""
    axes: Axes = key(
        "", "[[0, 1, 0], [-1, 0, 0], [0, 0, 1]]", default=mesh_axes, default_text="mesh's"
    )
    """orthotropic only: the directions 1, 2, 3 in the mesh's axes"""
    cylinder: Cylinder | None = key("", "{point = [0, 0, 0], axis = [0, 0, 1]}", default=None)
    """orthotropic only, in place of `axes`: 1, 2, 3 are radial, circumferential and axial about
    this axis, at each integration point"""
    law: Literal["orthotropic"] = key("", '"orthotropic"', default="orthotropic", kw_only=True)
    """`orthotropic`; or `isotropic` or `neo-hookean`, with other keys"""
    thermal_expansion: Annotated[Three, AfterValidator(_small)] | None = key(
        "1/K", "[1e-6, 30e-6, 30e-6]", default=None, kw_only=True
    )
    """orthotropic: three, along 1, 2, 3"""

    def __post_init__(self) -> None:
        if not self.stable:
            rule = "must not let any strain release energy:"
            for (i, j), ratio in zip(((1, 2), (1, 3), (2, 3)), self.poisson_ratios, strict=True):
                bound = np.sqrt(self.youngs_moduli[i - 1] / self.youngs_moduli[j - 1])
                if abs(ratio) >= bound:
                    limit = f"|nu{i}{j}| must be below sqrt(E{i} / E{j}) = {bound:.4g}"
                    used = f"if nu{j}{i} was meant, nu{i}{j} = nu{j}{i} E{i} / E{j}"
                    message = f"{rule} {limit}, not {abs(ratio):.4g}; {used}"
                    raise MistakesError(("poisson_ratio", message))
            volume = np.linalg.det(self._compliance) * np.prod(self.youngs_moduli)
            sum_of = "1 - nu12 nu21 - nu13 nu31 - nu23 nu32 - 2 nu12 nu23 nu31"
            message = f"{rule} {sum_of} is {volume:.3g}, but must be above 0; lower the ratios"
            raise MistakesError(("poisson_ratio", message))
        if (ratio := self.isotropic_ratio) > MAX_ISOTROPIC_RATIO:
            message = (
                f"makes the material as incompressible as an isotropic one of {ratio:.3g}; "
                f"orthotropic cells lock (are too stiff) above {MAX_ISOTROPIC_RATIO:g}, so write "
                "lower ratios"
            )
            raise MistakesError(("poisson_ratio", message))

    @property
    def orthotropic(self) -> Orthotropic | None:
        """The constants of the orthotropic law: these."""
        return self

    @property
    def youngs_modulus(self) -> float:
        """The largest of the three moduli, Pa."""
        return max(self.youngs_moduli)

    @property
    def poisson_ratio(self) -> float:
        """The `isotropic_ratio`, which identifies cells that would lock."""
        return self.isotropic_ratio

    def directions(self, points: np.ndarray) -> np.ndarray:
        """Return the directions 1, 2 and 3 at points (..., 3), m: shape (..., 3, 3), in rows.

        Points and directions are in the mesh's axes. On the axis any radial direction is right.
        """
        if self.cylinder is None:
            return np.broadcast_to(self.axes, (*points.shape[:-1], 3, 3))
        point, axial = np.array(self.cylinder.point), np.array(self.cylinder.axis)
        off = points - point
        off = off - (off @ axial)[..., None] * axial
        size = np.linalg.norm(off, axis=-1, keepdims=True)
        any_radial = np.cross(axial, np.eye(3)[np.abs(axial).argmin()])
        radial = np.where(size > 0, off / np.where(size > 0, size, 1.0), any_radial)
        radial = radial / np.linalg.norm(radial, axis=-1, keepdims=True)
        around = np.cross(axial, radial)
        return np.stack([radial, around, np.broadcast_to(axial, radial.shape)], axis=-2)

    @property
    def elasticity(self) -> np.ndarray:
        """Stresses (11, 22, 33, 12, 13, 23) by strains, the shears 2 E_ij: shape (6, 6), Pa."""
        matrix = np.diag([0.0, 0.0, 0.0, *self.shear_moduli])
        matrix[:3, :3] = np.linalg.inv(self._compliance)
        return 0.5 * (matrix + matrix.T)

    @property
    def stable(self) -> bool:
        """Whether every strain costs energy (Lempriere 1968)."""
        # Scaled to a unit diagonal, as a modulus of 1e11 beside one of 1e6 would decide it.
        scale = np.sqrt(np.array(self.youngs_moduli))
        with np.errstate(over="ignore"):
            scaled = self._compliance * np.outer(scale, scale)
        return bool(np.isfinite(scaled).all() and np.linalg.eigvalsh(scaled)[0] > _MIN_EIGENVALUE)

    @property
    def isotropic_ratio(self) -> float:
        """Poisson's ratio of the isotropic material nearest to it (Voigt's mean of directions)."""
        matrix = self.elasticity
        pulls = np.trace(matrix[:3, :3])
        shears = np.trace(matrix[3:, 3:])
        across = matrix[0, 1] + matrix[0, 2] + matrix[1, 2]
        bulk = (pulls + 2 * across) / 9
        shear = (pulls - across + 3 * shears) / 15
        return float((3 * bulk - 2 * shear) / (6 * bulk + 2 * shear))

    @property
    def _compliance(self) -> np.ndarray:
        """Strains (11, 22, 33) by stresses (11, 22, 33): shape (3, 3), 1/Pa."""
        e1, e2, e3 = self.youngs_moduli
        nu12, nu13, nu23 = self.poisson_ratios
        return np.array(
            [
                [1 / e1, -nu12 / e1, -nu13 / e1],
                [-nu12 / e1, 1 / e2, -nu23 / e2],
                [-nu13 / e1, -nu23 / e2, 1 / e3],
            ]
        )


AnyMaterial = Material | Orthotropic
