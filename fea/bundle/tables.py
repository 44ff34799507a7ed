"""Reading the tables of ``component.toml``, each into its part of the bundle.

Each reader notes its mistakes on the `Keys` it is given and returns None, or what could be read,
when there are any; `fea.bundle.read` raises them all together.
"""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from wrenchbook.fea.readers import reader_named, reader_names
from wrenchbook.fea.spec.orthotropic import MOST_ISOTROPIC_RATIO, Orthotropic
from wrenchbook.fea.spec.problems import BundleProblem
from wrenchbook.fea.spec.schema import (
    ACCELERATIONS,
    COUPLINGS,
    FREEDOMS,
    INTEGRATIONS,
    LAWS,
    MOMENTS,
    ON_YIELD,
    TEMPERATURE,
    UNITS,
    Analysis,
    Bushing,
    Deck,
    DeclaredRange,
    DeclaredTolerance,
    Interface,
    Material,
    ScalarInput,
    Sliding,
    Supports,
)
from wrenchbook.fea.spec.toml_table import Keys, bundle_file

# Tables square loads and divide by them; the square root of the largest double, 1e154, is too near
# since sums of such squares must be numbers too.
LARGEST_LOAD = 1e100

_DIRECTIONS = ("x", "y", "z")

_ROUNDING = 1e-9  # of a stiffness, relative to its diagonal
_NO_LOADS = DeclaredRange(np.zeros(len(FREEDOMS)), np.zeros(len(FREEDOMS)))
"""Of an interface that is held."""

_SLUG = re.compile(r"[a-z0-9][a-z0-9_-]{0,63}")


def is_slug(name: str) -> bool:
    """Return whether a name does as a component's: as a folder and in a URL."""
    return _SLUG.fullmatch(name) is not None


def read_name(top: Keys) -> str | None:
    """Return the name, which serves as a folder and in a URL."""
    name = top.text("name")
    if name is not None and not is_slug(name):
        top.wrong(
            "name",
            f'"{name}" will not do as a folder and in a URL; use 1 to 64 of a-z, 0-9, _ and -, '
            "beginning with a letter or digit",
        )
        return None
    return name


def read_supports(keys: Keys | None) -> Supports | None:
    """Return ``[supports]``."""
    if keys is None:
        return None
    fixed = keys.texts("fixed", required=False, least=1)
    sliding = [_sliding(table) for table in keys.tables("sliding", required=False)]
    bushings = [_bushing(entry) for entry in keys.tables("bushing", required=False)]
    if not any(keys):
        message = "holds nothing; write fixed, [[supports.sliding]] or [[supports.bushing]]"
        keys.problems.append(BundleProblem(keys.where, message))
    keys.close()
    return Supports(fixed or (), tuple(filter(None, sliding)), tuple(filter(None, bushings)))


def _sliding(keys: Keys) -> Sliding | None:
    """Return one ``[[supports.sliding]]``."""
    group = keys.text("group")
    names = keys.texts("directions", least=1) or ()
    for name in names:
        if name not in _DIRECTIONS:
            keys.wrong("directions", f'"{name}" is none of {", ".join(_DIRECTIONS)}')
    axes = read_axes(keys)
    keys.close()
    if group is None or axes is None or not set(names) <= set(_DIRECTIONS):
        return None
    return Sliding(group, axes[[_DIRECTIONS.index(name) for name in sorted(names)]])


def _bushing(keys: Keys) -> Bushing | None:
    """Return one ``[[supports.bushing]]``."""
    stiffness = _stiffness(keys)
    hold = _hold(keys, "group")
    keys.close()
    return None if hold is None or stiffness is None else Bushing(hold, stiffness)


def _stiffness(keys: Keys) -> np.ndarray | None:
    """Return six stiffnesses, or 6 x 6, as a matrix whose energy is never negative."""
    rows, unit = keys.raw("stiffness", list), "N/m, N/rad and N·m/rad"
    if rows is None:
        return None
    if len(rows) == len(FREEDOMS) and type(rows[0]) is list:
        count = len(FREEDOMS)
        read = [keys.as_numbers(f"stiffness[{i}]", row, count, unit) for i, row in enumerate(rows)]
        matrix = None if None in read else np.array(read)
    else:
        diagonal = keys.as_numbers("stiffness", rows, len(FREEDOMS), unit)
        matrix = None if diagonal is None else np.diag(diagonal)
    if matrix is None:
        return None
    scale = np.sqrt(np.where(np.diagonal(matrix) > 0, np.diagonal(matrix), 1.0))
    scaled = matrix / scale / scale[:, None]
    if np.abs(scaled - scaled.T).max() > _ROUNDING:
        keys.wrong("stiffness", "must be symmetric")
    elif np.linalg.eigvalsh(scaled)[0] < -_ROUNDING:
        keys.wrong("stiffness", "some motion would give energy back: no eigenvalue may be negative")
    elif not matrix.any():
        keys.wrong("stiffness", "is zero; leave the bushing out")
    else:
        return 0.5 * (matrix + matrix.T)
    return None


def read_interfaces(top: Keys) -> list[tuple[Interface | None, DeclaredRange | None]]:
    """Return ``[interface]``, without a range, or every ``[[interface]]`` with its own."""
    if not top.is_array("interface"):
        keys = top.table("interface", required=False)
        return [] if keys is None else [(_interface(keys), None)]
    has_mesh = "mesh" in top or "deck" in top
    pairs = [_named_interface(keys, has_mesh) for keys in top.tables("interface")]
    if len(pairs) == 1:
        top.wrong("interface", "is one alone; write [interface], without a name, or add others")
    names = [interface.name for interface, _ in pairs if interface is not None]
    if len(set(names)) < len(names):
        top.wrong("interface", "a name is there twice; each interface needs its own")
    if sum(interface is not None and interface.held for interface, _ in pairs) > 1:
        top.wrong("interface", "only one can be held: it is the reference of all displacements")
    return pairs


def _named_interface(keys: Keys, has_mesh: bool) -> tuple[Interface | None, DeclaredRange | None]:
    """Return one ``[[interface]]`` and its range; of a measured part it has no section."""
    name = read_name(keys)
    if not has_mesh:
        loads = _loads(keys.table("range"), may_rest=True)
        keys.close()
        return (Interface("", None, np.eye(3), "", name=name) if name else None), loads
    held = keys.flag("held", required=False) or False
    loads = keys.table("range", required=not held)
    if held and ("locked" in keys or loads is not None):
        keys.wrong("held", "an interface that is held takes neither locked nor range; leave it out")
    return _interface(keys, name or "", held), _loads(loads, may_rest=True) or _NO_LOADS


def read_range(
    top: Keys, interfaces: list[tuple[Interface | None, DeclaredRange | None]]
) -> DeclaredRange | None:
    """Return ``[range]``, or the ranges of several interfaces, as `read_interfaces` has them."""
    ranges = [loads for _, loads in interfaces if loads is not None]
    if not ranges:
        return _loads(top.table("range"))
    if top.table("range", required=False) is not None:
        top.wrong("range", "each [[interface]] has its own; write range = {force, moment} there")
    low, high = (
        np.concatenate([getattr(loads, end) for loads in ranges]) for end in ("low", "high")
    )
    return DeclaredRange(low, high)


def _interface(keys: Keys, name: str = "", held: bool = False) -> Interface | None:
    hold = _hold(keys, "section")
    locked = keys.texts("locked", required=False) or ()
    for freedom in locked:
        if freedom not in FREEDOMS:
            keys.wrong("locked", f'"{freedom}" is none of {", ".join(FREEDOMS)}')
    if len(locked) == len(FREEDOMS):
        keys.wrong("locked", "holds every freedom; nothing is left to move")
    locked = tuple(freedom for freedom in FREEDOMS if freedom in locked)
    keys.close()
    return hold and replace(hold, locked=FREEDOMS if held else locked, name=name)


def _hold(keys: Keys, group: str) -> Interface | None:
    """Return a group of nodes as a section, with what moves with it."""
    section = keys.text(group)
    point = keys.numbers("point", 3, "m", required=False)
    axes = read_axes(keys)
    coupling = keys.choice("coupling", COUPLINGS)
    if section is None or axes is None or coupling is None:
        return None
    return Interface(section, None if point is None else np.array(point), axes, coupling)


def read_analysis(keys: Keys | None, of_deck: Sequence[str] = ()) -> Analysis:
    """Return ``[analysis]``; a component without one claims nothing, so: nonlinear.

    `of_deck` are the integrations of the cells in an input deck: the default of its component.
    """
    if keys is None:
        return Analysis()
    nonlinear = keys.flag("nonlinear")
    integration = keys.choice("integration", INTEGRATIONS, required=False)
    if "integration" not in keys and len(of_deck) > 1:
        message = "missing; the deck has C3D20 (full) and C3D20R (reduced): one is for all cells"
        keys.wrong("integration", message)
    on_yield = keys.choice("on_yield", ON_YIELD, required=False)
    gravity = keys.numbers("gravity", 3, "m/s^2", required=False)
    keys.close()
    weight = (gravity[0], gravity[1], gravity[2]) if gravity and any(gravity) else None
    points = integration or next(iter(of_deck), "reduced")
    return Analysis(nonlinear is not False, points, weight, on_yield or ON_YIELD[0])


def _loads(keys: Keys | None, *, may_rest: bool = False) -> DeclaredRange | None:
    """Return the loads expected in N and N·m; of one interface of several some may be 0."""
    if keys is None:
        return None
    bounds = _bounds(keys, "force", "N", may_rest) + _bounds(keys, "moment", "N·m", may_rest)
    keys.close()
    if len(bounds) != len(FREEDOMS):
        return None
    low, high = np.array(bounds).T
    return DeclaredRange(low, high)


def _bounds(keys: Keys, key: str, unit: str, may_rest: bool) -> list[tuple[float, float]]:
    """Return (low, high) of three loads, each given as a number or as [low, high]."""
    loads = keys.raw(key, list)
    if loads is None:
        return []
    if len(loads) != 3:
        keys.wrong(key, f"must be three loads in {unit}, each a number or [low, high]")
        return []
    pairs = [
        (0.0, 0.0) if may_rest and load == 0 else _bound(keys, f"{key}[{i}]", load, unit)
        for i, load in enumerate(loads)
    ]
    return [pair for pair in pairs if pair is not None]


def _bound(keys: Keys, key: str, load: object, unit: str) -> tuple[float, float] | None:
    if type(load) is not list:
        most = keys.as_number(key, load, unit, above=0.0)
        return None if most is None else _countable(keys, key, -most, most, unit)
    pair = keys.as_numbers(key, load, 2, unit)
    if pair is None:
        return None
    if pair[0] >= pair[1]:
        keys.wrong(key, f"must rise from low to high, not [{pair[0]:g}, {pair[1]:g}]")
        return None
    return _countable(keys, key, pair[0], pair[1], unit)


def _countable(
    keys: Keys, key: str, low: float, high: float, unit: str
) -> tuple[float, float] | None:
    """Return a load's range unless its squares, or what is divided by them, have no number."""
    size = max(-low, high)
    if size <= LARGEST_LOAD and high - low >= 1 / LARGEST_LOAD:
        return low, high
    keys.wrong(
        key,
        f"must be at least {1 / LARGEST_LOAD:g} {unit} wide and within plus and minus "
        f"{LARGEST_LOAD:g} {unit}, not [{low:g}, {high:g}]",
    )
    return None


def read_tolerance(keys: Keys | None) -> DeclaredTolerance | None:
    """Return ``[tolerance]`` in m and rad."""
    if keys is None:
        return None
    translation = keys.number("translation", "m", above=0.0)
    rotation = keys.number("rotation", "rad", above=0.0)
    keys.close()
    if translation is None or rotation is None:
        return None
    return DeclaredTolerance(translation, rotation)


def read_material(keys: Keys) -> Material | None:
    """Return one ``[[material]]``."""
    region = keys.text("region")
    law = keys.choice("law", LAWS, required=False) or "isotropic"
    if law == "orthotropic":
        orthotropic = _orthotropic(keys)
        constants = (
            None
            if orthotropic is None
            else (max(orthotropic.youngs_moduli), orthotropic.isotropic_ratio)
        )
    else:
        modulus = keys.number("youngs_modulus", "Pa", above=0.0)
        ratio = keys.number("poisson_ratio", "no unit", above=-1.0, below=0.5)
        orthotropic, constants = (
            None,
            None if modulus is None or ratio is None else (modulus, ratio),
        )
    density = keys.number("density", "kg/m^3", above=0.0, required=False)
    strength = keys.number("yield_strength", "Pa", above=0.0, required=False)
    expansion = read_expansion(keys, law)
    keys.close()
    if region is None or constants is None:
        return None
    return Material(region, *constants, density, strength, law, orthotropic, expansion)


def _orthotropic(keys: Keys) -> Orthotropic | None:
    """Return nine constants and their directions; None if no material can have them."""
    young = _three(keys, "youngs_modulus", "E1, E2, E3", "Pa", positive=True)
    ratios = _three(keys, "poisson_ratio", "nu12, nu13, nu23", "no unit", positive=False)
    shears = _three(keys, "shear_modulus", "G12, G13, G23", "Pa", positive=True)
    # ``cylinder``: a point and the direction of its axis, exactly a unit; None for none.
    table = keys.table("cylinder", required=False)
    if table is None:
        cylinder = None
    else:
        point, axis = table.numbers("point", 3, "m"), table.numbers("axis", 3, "no unit")
        table.close()
        if "axes" in keys:
            keys.wrong(
                "axes", "is for directions that are the same everywhere: leave it or cylinder out"
            )
        if point is None or axis is None:
            cylinder = None
        elif not 1e-6 < math.sqrt(sum(x * x for x in axis)) < 1e6:
            table.wrong("axis", "must be a direction: three numbers that are not all zero")
            cylinder = None
        else:
            x, y, z = _unit(axis)
            cylinder = (point[0], point[1], point[2]), (x, y, z)
    axes = read_axes(keys)
    if young is None or ratios is None or shears is None or axes is None:
        return None
    x, y, z = ((float(row[0]), float(row[1]), float(row[2])) for row in axes)
    material = Orthotropic(young, ratios, shears, (x, y, z), cylinder)
    if not material.stable:
        message = (
            "no material has these: some strain would give energy back. Each |nu_ij| must be below "
            "sqrt(E_i / E_j); nu12 is the strain along 2 when pulled along 1 (nu21 = nu12 E2 / E1)"
        )
        keys.wrong("poisson_ratio", message)
        return None
    if material.isotropic_ratio > MOST_ISOTROPIC_RATIO:
        message = (
            f"the material keeps its volume like an isotropic one of {material.isotropic_ratio:.3g}"
            f"; orthotropic cells lock (are too stiff) above {MOST_ISOTROPIC_RATIO:g}"
        )
        keys.wrong("poisson_ratio", message)
        return None
    return material


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


def read_axes(keys: Keys) -> np.ndarray | None:
    """Return ``axes`` exactly orthonormal, shape (3, 3), dimensionless; by default the mesh's."""
    rows = keys.raw("axes", list, required=False)
    if rows is None:
        return np.eye(3)
    if len(rows) != 3:
        keys.wrong("axes", "must be three directions, the frame's x, y and z")
        return None
    read = [keys.as_numbers(f"axes[{i}]", row, 3, "no unit") for i, row in enumerate(rows)]
    if None in read:
        return None
    axes = np.array(read)
    # A direction that is far from a unit's length would overflow in the product.
    if np.abs(axes).max() > 2.0 or np.abs(axes @ axes.T - np.eye(3)).max() > 1e-6:
        keys.wrong("axes", "must be three unit directions square to each other (to 1e-6)")
    elif np.linalg.det(axes) < 0.0:
        keys.wrong("axes", "must be right-handed; turn one direction round")
    else:
        # An exact frame with the same x, in plain floats: the digits go into the fingerprint, so
        # they must not depend on a machine's linear algebra library.
        first, second, _ = axes.tolist()
        x = _unit(first)
        z = _unit(_cross(x, second))
        return np.array([x, _unit(_cross(z, x)), z])
    return None


def _unit(v: list[float]) -> list[float]:
    length = math.sqrt(v[0] * v[0] + v[1] * v[1] + v[2] * v[2])
    return [each / length for each in v]


def _cross(a: list[float], b: list[float]) -> list[float]:
    return [a[i - 2] * b[i - 1] - a[i - 1] * b[i - 2] for i in range(3)]


_LONGEST = 1e7  # seconds


def read_deck(keys: Keys | None, folder: Path) -> Deck | None:
    """Return ``[deck]``."""
    if keys is None:
        return None
    file = bundle_file(keys, "file", folder)
    command = keys.texts("command", least=1, repeats=True)
    output = keys.table("output")
    reader, options = None, {}
    name = None if output is None else output.choice("reader", reader_names())
    if output is not None and name is not None:
        reader = reader_named(name)
        read = {key: output.text(key) for key in reader.keys}
        output.close()
        options = {"reader": name} | {key: text for key, text in read.items() if text is not None}
    # The further files; all are put into one folder, so none may be in a subfolder.
    names = keys.texts("files", required=False) or ()
    others = []
    for i, name in enumerate(names):
        key = f"files[{i}]"
        if Path(name).name != name:
            keys.wrong(key, f'"{name}" is not directly in the bundle\'s folder; put it there')
        elif file is not None and name == file.name:
            keys.wrong(key, "is the deck itself; leave it out")
        else:
            each = bundle_file(Keys({key: name}, keys.problems, keys.where), key, folder)
            others += [] if each is None else [each]
    files = tuple(others)
    unit = keys.choice("unit", tuple(UNITS), required=False) or "m"
    timeout = keys.number("timeout", "s", above=0.0, below=_LONGEST, required=False)
    moment = keys.choice("moment", MOMENTS, required=False)
    keys.close()
    if file is None or command is None or reader is None:
        return None
    moment = moment or reader.moment
    return Deck(file, command, options, files, unit, timeout or 3600.0, moment)


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
    further = [] if warm is None else [_temperature(top, warm, folder)]
    if pulled is not None:
        sizes = pulled.numbers("range", len(ACCELERATIONS), "m/s^2") or []
        pulled.close()
        if sizes and min(sizes) <= 0:
            message = "must be three numbers above 0 in m/s^2: each plus and minus its own"
            pulled.wrong("range", message)
        pairs = zip(ACCELERATIONS, sizes, strict=False)
        further += [ScalarInput(name, "m/s^2", -size, size) for name, size in pairs]
    return tuple(filter(None, further))


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
    names = [scalar.name for scalar in further]
    if not names:
        return
    if "deck" in top:
        message = "a [deck] takes none; the embedded solver and measured tables do"
        top.wrong(further[0].key, message)
    for interface in interfaces:
        if interface is not None and interface.name in names:
            top.wrong(
                "interface", f'none may have the name "{interface.name}", which is an input\'s'
            )
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
