"""What is kept of one solve's fields, as its solver leaves it in the attempt's folder.

Two files: the geometry, which all rows of a component share, and the row's own fields. The
displacement is kept to 2^-44 of its largest number, stresses to 2^-24 and slopes to 2^-20, as they
serve interpolation only; a linear component's slopes are its whole answer and kept to 2^-44.
"""

from __future__ import annotations

from hashlib import blake2b
from pathlib import Path
from typing import Any, NamedTuple

from numpy.typing import NDArray

from wrenchbook.service.fields.codec import Column, pack, unpack
from wrenchbook.service.files.durable import write_whole_bytes

GEOMETRY, ROW = "geometry.fields", "row.fields"  # as the solver names them
FINE, STRESS, SLOPES = 44, 24, 20  # bits

Array = NDArray[Any]


class SurfaceGeometry(NamedTuple):
    """The undeformed surface, and the points of stresses; in the interface frame.

    Attributes
    ----------
    vertices, triangles
        Shapes (v, 3), m, and (t, 3).
    whole_vertices
        Of the surface before it was simplified.
    places, materials
        Shapes (p, 3), m, and (p,).
    regions
        Of the materials.
    digest
        Of all this: a row's fields belong to the geometry of the same digest.
    """

    vertices: Array
    triangles: Array
    whole_vertices: int
    places: Array
    materials: Array
    regions: tuple[str, ...]
    digest: str


class RowFields(NamedTuple):
    """The fields of one row; shapes as in `fea.recovery.fields.SolveFields`.

    Attributes
    ----------
    displacement, displacement_slopes
        Shapes (v, 3), m, and (v, 3, 6), m/N and m/(N·m).
    stress, stress_slopes
        Shapes (p, 6), Pa, and (p, 6, 6), Pa/N and Pa/(N·m).
    meta
        ``wrench``, ``linear``, ``geometry`` (its digest), ``largest``, ``at``, ``region``;
        ``weight`` (true) where the fields at zero load are those of the component's own weight.
    """

    displacement: Array
    displacement_slopes: Array
    stress: Array
    stress_slopes: Array
    meta: dict[str, Any]


def leave(folder: Path, wrench: tuple[float, ...], fields: Any) -> None:
    """Write the two files into an attempt's folder, each whole or not at all, on disk for good.

    Parameters
    ----------
    folder
        The attempt's.
    wrench
        Six numbers, N and N·m.
    fields : fea.recovery.fields.SolveFields
        Not imported: readers of the files import no finite elements.

    Raises
    ------
    OSError
        If they cannot be written.
    ValueError
        If a number is not finite.
    """
    geometry = _geometry_file(fields)
    row = _row_file(wrench, fields, digest_of(geometry))
    write_whole_bytes(folder / GEOMETRY, geometry)
    write_whole_bytes(folder / ROW, row)


def _geometry_file(fields: Any) -> bytes:
    return pack(
        {"whole_vertices": fields.whole_vertices, "regions": list(fields.regions)},
        {
            "vertices": Column(fields.vertices),
            "triangles": Column(fields.triangles),
            "places": Column(fields.places),
            "materials": Column(fields.materials),
        },
    )


def _row_file(wrench: tuple[float, ...], fields: Any, geometry: str) -> bytes:
    meta = {
        "wrench": list(wrench),
        "linear": fields.linear,
        "geometry": geometry,
        "largest": fields.largest,
        "at": list(fields.largest_at),
        "region": fields.largest_region,
    }
    if fields.weight:
        meta["weight"] = True
    slopes = FINE if fields.linear else SLOPES
    return pack(
        meta,
        {
            "displacement": Column(fields.displacement, FINE),
            "displacement_slopes": Column(fields.displacement_slopes, slopes),
            "stress": Column(fields.stress, STRESS),
            "stress_slopes": Column(fields.stress_slopes, slopes),
        },
    )


def digest_of(geometry: bytes) -> str:
    """Return the digest that identifies a geometry's file."""
    return blake2b(geometry, digest_size=12).hexdigest()


def read_geometry(content: bytes) -> SurfaceGeometry:
    """Return the geometry of a file.

    Raises
    ------
    DamagedFieldsError
        If it is not as it was written.
    """
    meta, columns = unpack(content)
    return SurfaceGeometry(
        columns["vertices"],
        columns["triangles"],
        int(meta["whole_vertices"]),
        columns["places"],
        columns["materials"],
        tuple(meta["regions"]),
        digest_of(content),
    )


def read_row(content: bytes) -> RowFields:
    """Return the fields of a row's file.

    Raises
    ------
    DamagedFieldsError
        If it is not as it was written.
    """
    meta, columns = unpack(content)
    return RowFields(
        columns["displacement"],
        columns["displacement_slopes"],
        columns["stress"],
        columns["stress_slopes"],
        meta,
    )
