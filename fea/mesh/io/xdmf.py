"""XDMF files before they are read: they name files that hold their numbers, and may name any."""

from __future__ import annotations

import xml.etree.ElementTree as ET
from pathlib import Path

from wrenchbook.fea.mesh.io.raw import MeshFileError

ENDINGS = (".xdmf", ".xmf")


def refuse_outside(path: Path) -> None:
    """Refuse an XDMF file whose numbers lie in a file outside its folder.

    A stranger's bundle could else have whatever this machine holds read as a mesh, and look at it
    as a deformed shape.

    Raises
    ------
    MeshFileError
        If it names a file elsewhere, one of plain bytes (which is looked for where the program
        runs), or is no XML.
    """
    try:
        items = list(ET.parse(path).iter("DataItem"))
    except (ET.ParseError, ValueError, LookupError) as error:
        raise MeshFileError(f"cannot be read as a {path.suffix} file ({error})") from None
    for item in items:
        kind, text = item.get("Format"), (item.text or "").strip()
        if kind == "Binary":
            raise MeshFileError('holds numbers in another file as bytes; write Format="HDF"')
        if kind == "HDF" and not _in_same_folder(path, text.partition(":")[0]):
            raise MeshFileError(
                f'holds numbers in "{text[:100]}", which is outside the bundle; put that file '
                "beside it and name it without a folder"
            )


def _in_same_folder(path: Path, name: str) -> bool:
    """Tell whether a name is that of a file in the same folder, and no link out of it."""
    folder = path.parent.resolve()
    return Path(name).name == name and (folder / name).resolve().parent == folder
