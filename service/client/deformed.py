"""Deformed surfaces, for a simulator that shows the bent part."""

from __future__ import annotations

from pathlib import Path
from urllib.parse import urlencode

from numpy.typing import ArrayLike

from ..contract import LOADS
from ..messages import DeformedShape
from .errors import InvalidArgument
from .transport import Connection, component_path
from .wrenches import one_wrench

FORMATS = {".glb": "gltf", ".vtu": "vtu", ".json": "json"}
"""The format of each file ending."""


def deformed_format(file: str | Path) -> str:
    """Return the form of a surface's file by its ending.

    Raises
    ------
    ValueError
        If the ending is none of a surface's; the message lists those there are.
    """
    suffix = Path(file).suffix
    if suffix.lower() not in FORMATS:
        named = f"the ending {suffix}" if suffix else "no ending"
        raise InvalidArgument(
            f"{file} has {named}, which is no form of a surface; there are {', '.join(FORMATS)}"
        )
    return FORMATS[suffix.lower()]


class SurfaceCalls(Connection):
    """Deformed surfaces, as arrays and as files."""

    def deformed(
        self, name: str, force: ArrayLike, moment: ArrayLike | None = None
    ) -> DeformedShape:
        """Return a component's deformed surface under one wrench.

        Parameters
        ----------
        name : str
            The component.
        force, moment : array_like
            Shape (3,), N, and shape (3,), N·m, acting ON the component about its interface point
            where it is now, in axes fixed to the undeformed interface frame; or the whole wrench as
            the force alone, shape (6,).

        Raises
        ------
        ValueError
            If a number is not finite or a shape is wrong; nothing was sent.
        ProblemError
            If there is no such component (404); if no row of it has a surface, or the wrench is
            far beyond the load range (409): the message says what to do.
        """
        return DeformedShape.read(self.call_json("GET", _path(name, force, moment, "json")))

    def deformed_file(
        self,
        name: str,
        force: ArrayLike,
        moment: ArrayLike | None = None,
        format: str = "gltf",  # noqa: A002 (the contract's word)
    ) -> bytes:
        """Return the same as the content of a file: ``gltf`` (.glb), ``vtu`` or ``json``.

        Parameters are those of `deformed`: force and moment of shape (3,), N and N·m. Lengths in
        the file are m.
        """
        return self.call("GET", _path(name, force, moment, format)).content


def _path(name: str, force: ArrayLike, moment: ArrayLike | None, form: str) -> str:
    loads = one_wrench(force, moment).tolist()
    query = {load: repr(value) for load, value in zip(LOADS, loads, strict=True)}
    return f"{component_path(name, 'deformed')}?{urlencode({**query, 'format': form})}"
