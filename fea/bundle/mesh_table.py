"""Reading ``[mesh]``: a mesh file, a geometry file and how to mesh it, or a generator."""

from __future__ import annotations

from dataclasses import MISSING, fields
from pathlib import Path

from wrenchbook.fea.mesh.generators import GENERATORS
from wrenchbook.fea.spec.schema import (
    GEOMETRY_ENDINGS,
    UNITS,
    GeometryMeshing,
    MeshSource,
    Selector,
)
from wrenchbook.fea.spec.toml_table import Keys, bundle_file

_AXES = ("x", "y", "z")
_FACE_WAYS = ("faces", "near", "plane", "radius")
_BODY_WAYS = ("bodies", "near")


def read_mesh(keys: Keys | None, folder: Path) -> MeshSource | None:
    """Return ``[mesh]``: a file and what belongs to it, or a generator and its parameters."""
    if keys is None:
        return None
    if "generator" in keys and "file" in keys:
        keys.wrong("generator", 'name a "file" or a "generator", not both')
    source = _generated(keys) if "generator" in keys else _from_file(keys, folder)
    keys.close()
    return source


def _generated(keys: Keys) -> MeshSource | None:
    keys.raw("file", str, required=False)
    name = keys.choice("generator", tuple(GENERATORS))
    if name is None:
        return None
    generator = GENERATORS[name]
    before = len(keys.problems)
    parameters = {}
    for entry in fields(generator):
        required = entry.default is MISSING
        if "least" in entry.metadata:
            value = keys.whole(entry.name, entry.metadata["least"], required)
        else:
            value = keys.number(entry.name, entry.metadata["unit"], above=0.0, required=required)
        parameters[entry.name] = entry.default if value is None else value
    if len(keys.problems) > before:
        return None
    for key, message in generator(**parameters).mistakes():
        keys.wrong(key, message)
    return MeshSource(generator=name, parameters=parameters)


def _from_file(keys: Keys, folder: Path) -> MeshSource | None:
    if "file" not in keys:
        keys.wrong("file", 'missing; name a mesh "file" or a "generator"')
    file = bundle_file(keys, "file", folder, required="file" in keys)
    if file is not None and file.suffix.lower() in GEOMETRY_ENDINGS:
        # The meshing of a geometry file; its cells are of second order.
        if "unit" in keys:
            keys.raw("unit", str)
            keys.wrong("unit", "a STEP file holds its own length unit; leave this key out")
        size = keys.number("size", "m", above=0.0)
        curvature = keys.whole("curvature", 3, required=False)
        _order(keys)
        groups = _choices(keys, "groups", _FACE_WAYS)
        regions = _choices(keys, "regions", _BODY_WAYS)
        if "all" in regions:
            keys.wrong("regions.all", '"all" is every cell of the mesh; take another name')
        if size is None:
            return None
        return MeshSource(
            file=file, geometry=GeometryMeshing(size, curvature or 0, groups, regions)
        )
    unit = keys.choice("unit", tuple(UNITS), required="file" in keys)
    order = _order(keys)
    if file is None or unit is None:
        return None
    return MeshSource(file=file, unit=unit, order=order)


def _order(keys: Keys) -> int | None:
    """Return 2 or None; no other order is solved."""
    order = keys.whole("order", 1, required=False)
    if order in (None, 2):
        return order
    keys.wrong(
        "order",
        f"must be 2, not {order}: first-order cells are too stiff in bending; "
        "order = 2 gives a first-order mesh midside nodes",
    )
    return None


def _choices(keys: Keys, key: str, ways: tuple[str, ...]) -> dict[str, Selector]:
    """Return the named choices of the table `key`."""
    table = keys.table(key, required=False)
    if table is None:
        return {}
    selectors = {}
    for name in table:
        ways_of_one = table.table(name)
        if ways_of_one is not None:
            chosen_ways = [way for way in ways if way in ways_of_one]
            if not chosen_ways:
                ways_of_one.wrong(
                    ways[0], f"missing; choose by {', '.join(ways[:-1])} or {ways[-1]}"
                )
            selectors[name] = Selector(
                numbers=_numbers(ways_of_one, ways[0]),
                near=_points(ways_of_one),
                plane=_plane(ways_of_one) if "plane" in ways else None,
                radius=ways_of_one.number("radius", "m", above=0.0, required=False)
                if "radius" in ways
                else None,
            )
            ways_of_one.close()
    return selectors


def _numbers(keys: Keys, key: str) -> tuple[int, ...]:
    values = keys.raw(key, list, required=False)
    if values is None:
        return ()
    if not values or any(type(value) is not int or value < 1 for value in values):
        keys.wrong(key, "must be a list of whole numbers from 1 up, as wrenchbook check lists them")
        return ()
    if len(set(values)) < len(values):
        keys.wrong(key, "names something twice; keep one of the two")
    return tuple(sorted(values))


def _points(keys: Keys) -> tuple[tuple[float, float, float], ...]:
    """Return ``near``: one point, or a list of points."""
    values = keys.raw("near", list, required=False)
    if values is None:
        return ()
    several = bool(values) and type(values[0]) is list
    named = [(f"near[{i}]", v) for i, v in enumerate(values)] if several else [("near", values)]
    read = [keys.as_numbers(key, value, 3, "m") for key, value in named]
    return tuple(sorted((p[0], p[1], p[2]) for p in read if p is not None))


def _plane(keys: Keys) -> tuple[int, float] | None:
    """Return ``plane`` and ``at``: the axis a plane is square to, and where it is."""
    axis = keys.choice("plane", _AXES, required=False)
    if "plane" not in keys and "at" in keys:
        keys.wrong("plane", 'missing; "at" is a place along plane = "x", "y" or "z"')
    at = keys.number("at", "m", required="plane" in keys)
    return None if axis is None or at is None else (_AXES.index(axis), at)
