"""Deformed surfaces, for a simulator that shows the bent part."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from urllib.parse import urlencode

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..contract import LOADS
from .errors import InvalidArgument, Json
from .request import Call, Request, component_path, sync_and_async
from .wrenches import one_wrench

FORMATS = {".glb": "gltf", ".vtu": "vtu", ".json": "json"}
"""The format of each file ending."""


@dataclass(frozen=True)
class Stress:
    """The largest von Mises stress of a component.

    Attributes
    ----------
    largest, error : float, Pa
        And its 95 % error bar, of the table alone: without what the mesh is off. None where it is
        not known.
    at : ndarray, shape (3,), m
        Where, undeformed, in the interface frame from the interface point.
    region : str
        The material there.
    yield_strength : float, Pa
        Of that material; None if its bundle does not say it.
    yields : bool
        Whether it yields there; None where the strength is not known, or the bar lies across it.
    """

    largest: float
    error: float | None
    at: NDArray[np.float64]
    region: str
    yield_strength: float | None
    yields: bool | None


@dataclass(frozen=True, eq=False)
class DeformedShape:
    """A component's surface under one wrench, in the undeformed interface frame from its point.

    Attributes
    ----------
    vertices : ndarray, shape (v, 3), m
        Undeformed.
    triangles : ndarray of int, shape (t, 3)
        Vertices, anticlockwise seen from outside.
    displacement : ndarray, shape (v, 3), m
    error : ndarray, shape (v,), m
        95 % error bar of each vertex's displacement; None where it is not known. What the
        solver's own mesh is off is in it if ``error_parts["mesh"]`` is not None.
    stress : Stress
        None where it is not known.
    coverage, reason : str
        ``covered``, ``thin`` or ``outside``, and why: of the interpolation error alone.
    source : str
        ``row``: a solve of this very wrench; ``rows``: between them; ``linear``.
    error_parts : mapping
        The largest of each share that `error` is the sum of, m: ``table``, ``mesh`` and of a
        linear component ``linearity``, None where it is not known; ``mesh_basis`` in words. None
        where `error` is.
    within_tolerance : bool
        Whether every bar is within the component's tolerance; None where it has none, or the
        discretisation error is not known.
    raw : mapping
        The whole reply.
    """

    vertices: NDArray[np.float64]
    triangles: NDArray[np.int64]
    displacement: NDArray[np.float64]
    error: NDArray[np.float64] | None
    stress: Stress | None
    coverage: str
    reason: str
    source: str
    raw: Mapping[str, Json]
    error_parts: Mapping[str, Json] | None = None
    within_tolerance: bool | None = None

    @property
    def is_covered(self) -> bool:
        """Whether the interpolation error is within the component's tolerance."""
        return self.coverage == "covered"

    def deformed(self, scale: float = 1.0) -> NDArray[np.float64]:
        """Return the displaced vertices, shape (v, 3), m, exaggerated by `scale`."""
        return self.vertices + scale * self.displacement

    @classmethod
    def of(cls, raw: Mapping[str, Json]) -> DeformedShape:
        """Return the shape of a reply."""
        error, stress = raw["error"], raw["stress"]
        return cls(
            vertices=np.array(raw["vertices"], dtype=float).reshape(-1, 3),
            triangles=np.array(raw["triangles"], dtype=np.int64).reshape(-1, 3),
            displacement=np.array(raw["displacement"], dtype=float).reshape(-1, 3),
            error=None if error is None else np.array(error, dtype=float),
            stress=None if stress is None else Stress(**{**stress, "at": np.array(stress["at"])}),
            coverage=raw["coverage"],
            reason=raw.get("reason", ""),
            source=raw["source"],
            raw=raw,
            error_parts=raw.get("error_parts"),
            within_tolerance=raw.get("within_tolerance"),
        )


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


class SurfaceCalls:
    """Deformed surfaces, as arrays and as files."""

    @sync_and_async
    def deformed(
        self, name: str, force: ArrayLike, moment: ArrayLike | None = None
    ) -> Call[DeformedShape]:
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
        return DeformedShape.of((yield Request("GET", _path(name, force, moment, "json"))).json())

    @sync_and_async
    def deformed_file(
        self,
        name: str,
        force: ArrayLike,
        moment: ArrayLike | None = None,
        format: str = "gltf",  # noqa: A002 (the contract's word)
    ) -> Call[bytes]:
        """Return the same as the content of a file: ``gltf`` (.glb), ``vtu`` or ``json``.

        Parameters are those of `deformed`: force and moment of shape (3,), N and N·m. Lengths in
        the file are m.
        """
        return (yield Request("GET", _path(name, force, moment, format))).content


def _path(name: str, force: ArrayLike, moment: ArrayLike | None, form: str) -> str:
    loads = one_wrench(force, moment).tolist()
    query = {load: repr(value) for load, value in zip(LOADS, loads, strict=True)}
    return f"{component_path(name, 'deformed')}?{urlencode({**query, 'format': form})}"
