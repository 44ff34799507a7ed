"""A scene: the requirements of one simulation on its components."""

from __future__ import annotations

import json
import tomllib
from collections.abc import Coroutine, Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Self, overload

import numpy as np

from ..contract import OUTPUTS
from ..messages import Plan
from .errors import Document, InvalidArgument, Json
from .transport import Connection
from .wrenches import tolerance_body

if TYPE_CHECKING:
    from .async_client import AsyncClient

_FIELDS = ("force", "moment", "loads", "inputs", "outputs", "tolerance")
_RANGE_FIELDS = _FIELDS[:4]  # the part of the load range that a scene needs
_SPANS = "[[-100, 100], [0, 0], [-600, 0]]"  # three loads, in the syntax of TOML and of Python


class SceneError(InvalidArgument):
    """A scene is not valid; the message has the place and the valid values."""


class ComponentPlan(Plan):
    """The plan of a scene for one `component`, see `Plan`."""

    component: str


class Scene:
    """Needs of one simulation: its components, loads that can occur, outputs it reads.

    Parameters
    ----------
    components : mapping
        Per name ``force`` and ``moment``, three loads each, N and N·m: ``[low, high]``, or a number
        for plus and minus that; of several interfaces ``loads``, these by interface, and
        ``inputs``, a span each; ``outputs``, which of ux uy uz rx ry rz (``left.ux``) are read, all
        if left out; ``tolerance``, ``{"translation": m, "rotation": rad}``, the component's own if
        left out.

    Raises
    ------
    SceneError
        If it is none of these; no server is called.

    Examples
    --------
    >>> planar = [[-100, 100], 0, [-600, 0]]
    >>> scene = Scene({"plate": {"force": planar, "moment": [0, 20, 0], "outputs": ["uz", "ry"]}})
    >>> plan = scene.plan(client)                                   # doctest: +SKIP
    >>> client.fill_until("plate", **scene.wanted("plate"))         # doctest: +SKIP
    >>> table = client.download("plate", scene=scene)               # doctest: +SKIP
    """

    def __init__(self, components: Mapping[str, Mapping[str, Json]]) -> None:
        if not isinstance(components, Mapping) or not components:
            raise SceneError(
                "the scene has no component; add [components.NAME] with force and moment, each "
                f"such as {_SPANS}, or in Python Scene({{NAME: {{'force': ..., 'moment': ...}}}})"
            )
        self.components = {str(name): _checked(name, need) for name, need in components.items()}

    @classmethod
    def read(cls, path: str | Path) -> Self:
        """Return the scene of a TOML file: a table ``[components.NAME]`` each.

        Raises
        ------
        OSError
            If the file cannot be read.
        SceneError
            If it is no TOML or no scene; the text names the file.
        """
        try:
            with Path(path).open("rb") as file:
                body = tomllib.load(file)
            _refuse_unknown("", body, ("components", "title"))
            return cls(body.get("components", {}))
        except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
            raise SceneError(
                f"{path} is not valid TOML: {error}; name the .toml file of a scene"
            ) from error
        except SceneError as error:
            raise SceneError(f"{path}: {error}") from error

    def __iter__(self) -> Iterator[str]:
        return iter(self.components)

    def __contains__(self, name: object) -> bool:
        return name in self.components

    def wanted(self, name: str) -> Document:
        """Return the parameters of ``Client.fill`` and ``fill_until``: range, outputs, tolerance.

        Raises
        ------
        SceneError
            If the scene has no such component.
        """
        need = self.component(name)
        return {
            "range": {field: need[field] for field in _RANGE_FIELDS if field in need},
            "outputs": need.get("outputs"),
            "tolerance": need.get("tolerance"),
        }

    def component(self, name: str) -> Document:
        """Return the needs of one component, in the form of the request.

        Raises
        ------
        SceneError
            If the scene has no such component.
        """
        if name not in self.components:
            raise SceneError(f"the scene has no component {name!r}; name one of: {', '.join(self)}")
        return self.components[name]

    @overload
    def plan(self, client: Connection) -> dict[str, ComponentPlan]: ...
    @overload
    def plan(self, client: AsyncClient) -> Coroutine[Any, Any, dict[str, ComponentPlan]]: ...
    def plan(self, client: Connection | AsyncClient) -> object:
        """Return the plan of each component: the rows that the scene needs, and those it saves.

        The call of an `AsyncClient` is awaited.

        Raises
        ------
        ProblemError
            If there is no such component (404), or a load lies outside its load range (422).
        ServerUnreachable, ServerTimeout
            See `Connection.call`.
        """
        if isinstance(client, Connection):
            return self._plan(client)
        if not hasattr(client, "run"):
            raise InvalidArgument(f"plan needs a Client or an AsyncClient, not {client!r}")
        return client.run(self._plan)

    def _plan(self, client: Connection) -> dict[str, ComponentPlan]:
        """Return the plan of each component from the server."""
        reply = client.call_json("POST", "/v1/scenes/plan", {"components": self.components})
        return {
            name: ComponentPlan.read({**plan, "component": name})
            for name, plan in reply["components"].items()
        }

    def query(self, name: str) -> str:
        """Return one component's needs as a query parameter."""
        return json.dumps(self.component(name), sort_keys=True)


def _checked(name: str, need: Json) -> Document:
    """Return one component's requirements in the form of the request."""
    where = f"components.{name}"
    if not isinstance(need, Mapping):
        raise SceneError(
            f"{where} is {need!r}, but must be a table; write [{where}] with force and moment"
        )
    _refuse_unknown(where, need, _FIELDS)
    loads, further, outputs = (need.get(field) for field in ("loads", "inputs", "outputs"))
    if loads is None:
        body: Document = _wrench(where, need, ("force", "moment"))
    else:
        by_name = _named(f"{where}.loads", loads).items()
        body = {"loads": {k: _wrench(f"{where}.loads.{k}", load, load) for k, load in by_name}}
    if further is not None:
        spans = _named(f"{where}.inputs", further).items()
        body["inputs"] = {k: _span(f"{where}.inputs.{k}", span) for k, span in spans}
    if outputs is not None:
        body["outputs"] = _ordered_outputs(f"{where}.outputs", outputs)
    if need.get("tolerance") is not None:
        try:
            body["tolerance"] = tolerance_body(need["tolerance"])
        except ValueError as error:
            raise SceneError(f"{where}.{error}") from None
    return body


def _refuse_unknown(where: str, keys: Iterable[object], known: Sequence[str]) -> None:
    """Raise SceneError if a key at a place of the scene is not among the known ones."""
    unknown = [str(key) for key in keys if key not in known]
    if unknown:
        place = f"{where}: " if where else ""
        raise SceneError(f"{place}{', '.join(unknown)} is not a key here; use {', '.join(known)}")


def _ordered_outputs(where: str, outputs: Json) -> list[str]:
    """Return the names of outputs, ``uz`` or ``left.uz``, by interface and in table order."""
    if not isinstance(outputs, Sequence) or isinstance(outputs, str) or not outputs:
        raise SceneError(f'{where} is {outputs!r}; write a list of outputs, such as ["uz", "ry"]')
    places = set()
    for name in map(str, outputs):
        interface, _, output = name.rpartition(".")
        if output not in OUTPUTS:
            raise SceneError(
                f"{where}: {name!r} is not an output; use {', '.join(OUTPUTS)}, with several "
                "interfaces in the form INTERFACE.uz"
            )
        places.add((interface, OUTPUTS.index(output)))
    return [f"{k}.{OUTPUTS[place]}".lstrip(".") for k, place in sorted(places)]


def _named(where: str, value: Json) -> Mapping[str, Json]:
    if not isinstance(value, Mapping):
        raise SceneError(f"{where} is {value!r}, but must be a table of values, {{NAME = VALUE}}")
    return value


def _wrench(where: str, need: Json, parts: Iterable[str]) -> Document:
    """Return the spans of force and moment; `parts`: those that must be present."""
    _refuse_unknown(where, parts, ("force", "moment"))
    body: Document = {}
    for part in parts:
        spans = need.get(part)
        place = f"{where}.{part}"
        if spans is None:
            raise SceneError(
                f"{place} is missing; write a range [low, high] for x, y and z, such as {_SPANS}, "
                "with [0, 0] where no load can occur"
            )
        listed = isinstance(spans, Sequence | np.ndarray) and not isinstance(spans, str)
        if not listed or len(spans) != 3:
            raise SceneError(
                f"{place} is {spans!r}, but must have three loads (x, y, z), each [low, high] or "
                f"a number, such as {_SPANS}"
            )
        body[part] = [_span(f"{place}.{k}", span) for k, span in enumerate(spans)]
    return body


def _span(where: str, span: Json) -> list[float]:
    """Return the lowest and the highest value of ``[low, high]``, or of a number: both signs."""
    try:
        ends = np.asarray(span)
    except ValueError:  # lists of different lengths
        ends = np.asarray("")
    if ends.dtype.kind not in "fiu" or ends.shape not in ((), (2,)) or not np.isfinite(ends).all():
        raise SceneError(f"{where} must be [low, high] or one finite number, not {span!r}")
    if ends.shape == () and ends < 0.0:
        raise SceneError(
            f"{where} is {ends:g}, but a single number must be 0 or more, because it stands for "
            f"both signs; write {-ends:g}, or [{ends:g}, 0] for the negative sign alone"
        )
    low, high = (-ends, ends) if ends.shape == () else ends
    if low > high:
        raise SceneError(f"{where}: the low end {low:g} is above the high end {high:g}; swap them")
    return [float(low) + 0.0, float(high) + 0.0]
