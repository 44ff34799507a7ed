"""A scene: the loads, outputs and tolerances that one simulation needs of its components."""

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

_RANGE_FIELDS = ("force", "moment", "loads", "inputs")  # the part of the load range
_FIELDS = (*_RANGE_FIELDS, "outputs", "tolerance")
_EXAMPLE = "[[-100, 100], [0, 0], [-600, 0]]"  # three loads, in the syntax of TOML and of Python


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
                f"such as {_EXAMPLE}, or in Python Scene({{NAME: {{'force': ..., 'moment': ...}}}})"
            )
        self.components = {str(name): _body(name, needs) for name, needs in components.items()}

    @classmethod
    def read(cls, path: str | Path) -> Self:
        """Return the scene of a TOML file, which has a table ``[components.NAME]`` for each.

        Raises
        ------
        OSError
            If the file cannot be read.
        SceneError
            If it is not TOML or not a scene; the message names the file.
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
        needs = self.component(name)
        return {
            "range": {field: needs[field] for field in _RANGE_FIELDS if field in needs},
            "outputs": needs.get("outputs"),
            "tolerance": needs.get("tolerance"),
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

        With an `AsyncClient` the result is awaited.

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


def _body(name: str, needs: Json) -> Document:
    """Return one component's needs in the form of the request; raises SceneError."""
    where = f"components.{name}"
    if not isinstance(needs, Mapping):
        raise SceneError(
            f"{where} is {needs!r}, but must be a table; write [{where}] with force and moment"
        )
    _refuse_unknown(where, needs, _FIELDS)
    body: Document = {}
    if needs.get("loads") is None:
        body = _wrench(where, needs, ("force", "moment"))
    else:
        loads = _table(f"{where}.loads", needs["loads"])
        body["loads"] = {
            name: _wrench(f"{where}.loads.{name}", load) for name, load in loads.items()
        }
    if needs.get("inputs") is not None:
        inputs = _table(f"{where}.inputs", needs["inputs"])
        body["inputs"] = {k: _span(f"{where}.inputs.{k}", span) for k, span in inputs.items()}
    if needs.get("outputs") is not None:
        body["outputs"] = _ordered_outputs(f"{where}.outputs", needs["outputs"])
    if needs.get("tolerance") is not None:
        try:
            body["tolerance"] = tolerance_body(needs["tolerance"])
        except ValueError as error:
            raise SceneError(f"{where}.{error}") from None
    return body


def _refuse_unknown(where: str, keys: Iterable[object], known: Sequence[str]) -> None:
    """Raise SceneError if a key is not a known one; `where` is its table, "" for the whole file."""
    unknown = [str(key) for key in keys if key not in known]
    if unknown:
        place = f"{where}: " if where else ""
        raise SceneError(f"{place}{', '.join(unknown)} is not a key here; use {', '.join(known)}")


def _ordered_outputs(where: str, outputs: Json) -> list[str]:
    """Return names of outputs, ``uz`` or ``left.uz``, by interface, then in the table's order."""
    if not isinstance(outputs, Sequence) or isinstance(outputs, str) or not outputs:
        raise SceneError(f'{where} is {outputs!r}; write a list of outputs, such as ["uz", "ry"]')
    indices = set()
    for name in map(str, outputs):
        interface, _, output = name.rpartition(".")
        if output not in OUTPUTS:
            raise SceneError(
                f"{where}: {name!r} is not an output; use {', '.join(OUTPUTS)}, with several "
                "interfaces in the form INTERFACE.uz"
            )
        indices.add((interface, OUTPUTS.index(output)))
    return [f"{interface}.{OUTPUTS[k]}".removeprefix(".") for interface, k in sorted(indices)]


def _table(where: str, value: Json) -> Mapping[str, Json]:
    """Return the value; raise SceneError if it is not a table."""
    if not isinstance(value, Mapping):
        raise SceneError(f"{where} is {value!r}, but must be a table of values, {{NAME = VALUE}}")
    return value


def _wrench(where: str, needs: Json, parts: Iterable[str] | None = None) -> Document:
    """Return the spans of the loads of each part, ``force`` or ``moment``; by default of all."""
    needs = _table(where, needs)
    names = list(needs) if parts is None else list(parts)
    _refuse_unknown(where, names, ("force", "moment"))
    body: Document = {}
    for part in names:
        spans = needs.get(part)
        place = f"{where}.{part}"
        if spans is None:
            raise SceneError(
                f"{place} is missing; write a range [low, high] for x, y and z, such as "
                f"{_EXAMPLE}, with [0, 0] where no load can occur"
            )
        is_list = isinstance(spans, Sequence | np.ndarray) and not isinstance(spans, str)
        if not is_list or len(spans) != 3:
            raise SceneError(
                f"{place} is {spans!r}, but must have three loads (x, y, z), each [low, high] or "
                f"a number, such as {_EXAMPLE}"
            )
        body[part] = [_span(f"{place}.{k}", span) for k, span in enumerate(spans)]
    return body


def _span(where: str, span: Json) -> list[float]:
    """Return the lowest and the highest value of ``[low, high]``, or of a number: both signs."""
    try:
        ends = np.asarray(span)
    except ValueError:  # lists of different lengths
        ends = np.empty(0)
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
    return [float(low) + 0.0, float(high) + 0.0]  # + 0.0: -0.0 is written as 0.0
