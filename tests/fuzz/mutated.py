"""Files made from good ones by chance, and read: runs in the sandbox, many to a child."""

from __future__ import annotations

import io
import random
import tempfile
import zipfile
from collections.abc import Callable, Iterator
from pathlib import Path

import meshio
import numpy as np
import openpyxl
import pyarrow as arrow
from pyarrow.parquet import write_table as write_parquet

from tests.service.table_files import (
    read_csv,
    read_hdf5,
    read_json,
    write_csv,
    write_hdf5,
    write_json,
)
from tests.service.test_rig_files import RUN, tdms
from tests.service.test_table_files import DIALECTS
from wrenchbook.fea.bundle.read import BundleError, read_bundle
from wrenchbook.fea.bundle.shipped import SHIPPED
from wrenchbook.fea.mesh.io.abaqus_content import read_deck
from wrenchbook.fea.mesh.io.read import read_mesh
from wrenchbook.fea.spec.problems import MeshFileError
from wrenchbook.service.formats.options import Options, ParsedTable, ReadReport
from wrenchbook.service.formats.read import read_table_file
from wrenchbook.service.library.bundles import extract
from wrenchbook.service.sandbox import Part
from wrenchbook.surrogate.table.meta import TableMeta
from wrenchbook.surrogate.table.rows import LoadRange, Rows

TOKENS = (b"1e999", b"nan", b"-", b"'", b'"', b"\0", b"\xff", b"[", b"{", b",", b";", b"\r", b"#")
TOKENS += (
    b"9" * 400,
    b"=",
    b".",
    b"0x",
    b"[mm]",
    b"GENERATE",
    b"*NSET, NSET=A",
    b"null",
    b"1e-320",
)


RIG = Options(missing_loads="zero", mapping={"Kraft": "fz", "Weg": "-uz"}, ignore_extra=True)


def rows() -> Rows:
    """Return three rows to write."""
    return Rows.of(
        np.arange(18.0).reshape(3, 6), 1e-6 * np.arange(18.0).reshape(3, 6), source=["fea"] * 3
    )


def seeds() -> dict[str, bytes]:
    """Return a good file of each form."""
    text = (SHIPPED / "plate" / "component.toml").read_bytes()
    packed = io.BytesIO()
    with zipfile.ZipFile(packed, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("component.toml", text)
    span = LoadRange(np.full(6, -9.0), np.full(6, 9.0))
    csv, reported = write_csv(rows()), write_json(rows(), {})
    book, columns = openpyxl.Workbook(), {"Fz [N]": [1.0, 2.0, 4.0], "uz [mm]": [0.1, 0.2, 0.4]}
    for record in (columns, *zip(*columns.values(), strict=True)):
        book.worksheets[0].append(list(record))
    sheet, parquet = io.BytesIO(), io.BytesIO()
    book.save(sheet)
    write_parquet(arrow.table(columns), parquet)
    return {
        "csv": csv.encode() if isinstance(csv, str) else csv,
        "json": reported.encode() if isinstance(reported, str) else reported,
        "hdf5": write_hdf5(rows(), [1, 2, 3], TableMeta("rig", 3, span)),
        "xlsx": sheet.getvalue(),
        "parquet": parquet.getvalue(),
        "tdms": tdms(run=RUN),
        "lvm": DIALECTS["LabVIEW: an X column a channel"]["text"].encode(),
        **meshes(),
        "toml": text,
        "zip": packed.getvalue(),
        "inp": b"*NODE\n1,0,0,0\n2,1,0,0\n3,0,1,0\n4,0,0,1\n"
        b"*ELEMENT, TYPE=C3D4, ELSET=E\n1,1,2,3,4\n*NSET, NSET=A, GENERATE\n1,4,1\n"
        b"*SURFACE, NAME=S\nE, S1\n*NODE\n9,0,0,2\n*COUPLING, REF NODE=9, SURFACE=S\n*KINEMATIC\n"
        b"*MATERIAL, NAME=M\n*ELASTIC\n1.,0.3\n*SOLID SECTION, ELSET=E, MATERIAL=M\n"
        b"*BOUNDARY\nA,1,3\n2,1\n*STEP\n*CLOAD\n9,1,5.\n*END STEP\n",
    }


def meshes() -> dict[str, bytes]:
    """Return one tetrahedron as gmsh, VTK and VTU have it."""
    tet = meshio.Mesh(np.vstack([np.zeros(3), np.eye(3)]), [("tetra", np.arange(4)[None])])
    result = {}
    with tempfile.TemporaryDirectory() as folder:
        for form, kind in (("msh", "gmsh"), ("vtk", "vtk"), ("vtu", "vtu")):
            path = Path(folder) / f"a.{form}"
            meshio.write(path, tet, kind)
            result[form] = path.read_bytes()
    return result


def mutant(good: bytes, seed: int) -> bytes:
    """Return a file with a few places of it changed."""
    chance, bad = random.Random(seed), bytearray(good)
    for _ in range(chance.randint(1, 6)):
        at = chance.randrange(len(bad) + 1)
        length = chance.randint(1, 12)
        change = chance.randrange(4)
        if change == 0:
            bad[at : at + length] = chance.randbytes(length)
        elif change == 1:
            del bad[at : at + length]
        elif change == 2:
            bad[at:at] = chance.choice(TOKENS)
        else:
            bad[at:at] = bad[at : at + length * 8] * chance.randint(1, 4)
    return bytes(bad)


def read(form: str, content: bytes, folder: Path) -> None:
    """Read a file as the server does; what is raised that is no named mistake is one of ours."""
    tables: dict[str, Callable[[bytes], ParsedTable]] = {
        "csv": read_csv,
        "json": read_json,
        "hdf5": read_hdf5,
    }
    if form in tables:
        table = tables[form](content)
        assert np.isfinite(table.wrench).all()
        assert len(table.wrench) == len(table.displacement) == len(table.seq)
        return
    path = folder / {"toml": "component.toml"}.get(form, f"a.{form}")
    path.write_bytes(content)
    if form in ("xlsx", "parquet", "tdms", "lvm"):
        for table in read_table_file(path, RIG, ReadReport()):
            assert np.isfinite(table.wrench).all()
        return
    try:
        if form in ("msh", "vtk", "vtu"):
            read_mesh(path, "mm")
        elif form == "toml":
            read_bundle(folder)
        elif form == "inp":
            read_deck(path)
        else:
            with tempfile.TemporaryDirectory(dir=folder) as target:
                read_bundle(extract(path, Path(target)))
    except (BundleError, MeshFileError):
        return


def fuzzed(form: str, start: int, count: int) -> Iterator[Part]:
    """Read so many mutants; tell those that came to a mistake of ours."""
    good, results = seeds()[form], []
    with tempfile.TemporaryDirectory(prefix="wrenchbook-fuzz-") as folder:
        for seed in range(start, start + count):
            try:
                read(form, mutant(good, seed), Path(folder))
            except Exception as error:
                results.append([seed, f"{type(error).__name__}: {error}"[:300]])
    yield Part({"mistakes": results[:50]})
