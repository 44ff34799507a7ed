"""A scene: what one simulation needs of its components."""

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


class SceneError(InvalidArgument):
    """A scene is not valid; the text names the place and what is valid there."""


class ComponentPlan(Plan):
    """What a scene needs of one `component`, see `Plan`."""

    component: str


class Scene:
    """What one simulation needs: its components, loads that can occur, outputs it reads.

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
            raise SceneError("a scene needs a component, as {'plate': {'force': [...], ...}}")
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
            if unknown := body.keys() - {"components", "title"}:
                raise SceneError(f"unknown key {', '.join(sorted(unknown))}; use components, title")
            return cls(body.get("components", {}))
        except (tomllib.TOMLDecodeError, UnicodeDecodeError, SceneError) as error:
            raise SceneError(f"{path}: {error}") from error

    def __iter__(self) -> Iterator[str]:
        return iter(self.components)

    def __contains__(self, name: object) -> bool:
        return name in self.components

    def wanted(self, name: str) -> Document:
        """Return what ``Client.fill`` and ``fill_until`` take: range, outputs, tolerance.

        Raises
        ------
        SceneError
            If the scene has no such component.
        """
        need = self.component(name)
        return {
            "range": {field: need[field] for field in _FIELDS[:4] if field in need},
            "outputs": need.get("outputs"),
            "tolerance": need.get("tolerance"),
        }

    def component(self, name: str) -> Document:
        """Return what it needs of one component, as the wire has it.

        Raises
        ------
        SceneError
            If the scene has no such component.
        """
        if name not in self.components:
            raise SceneError(f"the scene has no component {name!r}; it has {', '.join(self)}")
        return self.components[name]

    @overload
    def plan(self, client: Connection) -> dict[str, ComponentPlan]: ...
    @overload
    def plan(self, client: AsyncClient) -> Coroutine[Any, Any, dict[str, ComponentPlan]]: ...
    def plan(self, client: Connection | AsyncClient) -> object:
        """Return what the scene needs of each component, and what that saves.

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
        reply = client.call_json("POST", "/v1/scenes/plan", {"components": self.components})
        return {
            name: ComponentPlan.read({**plan, "component": name})
            for name, plan in reply["components"].items()
        }

    def query(self, name: str) -> str:
        """Return one component's need as a query parameter."""
        return json.dumps(self.component(name), sort_keys=True)


def _checked(name: str, need: Json) -> Document:
    """Return one component's need as the wire has it."""
    where = f"components.{name}"
    if not isinstance(need, Mapping):
        raise SceneError(f"{where}: must be a table of {', '.join(_FIELDS)}, not {need!r}")
    if unknown := need.keys() - set(_FIELDS):
        raise SceneError(
            f"{where}: unknown key {', '.join(sorted(unknown))}; write {', '.join(_FIELDS)}"
        )
    if (loads := need.get("loads")) is None:
        body: Document = _wrench(where, need, ("force", "moment"))
    else:
        by_name = _named(f"{where}.loads", loads).items()
        body = {"loads": {k: _wrench(f"{where}.loads.{k}", load, load) for k, load in by_name}}
    if (further := need.get("inputs")) is not None:
        spans = _named(f"{where}.inputs", further).items()
        body["inputs"] = {k: _span(f"{where}.inputs.{k}", span) for k, span in spans}
    if (outputs := need.get("outputs")) is not None:
        listed = isinstance(outputs, Sequence) and not isinstance(outputs, str)
        parts = [str(output).rpartition(".") for output in outputs] if listed else []
        if not parts or any(output not in OUTPUTS for _, _, output in parts):
            raise SceneError(
                f"{where}.outputs: must be one or more of {', '.join(OUTPUTS)}, not {outputs!r}"
            )
        ordered = sorted({(interface, OUTPUTS.index(output)) for interface, _, output in parts})
        body["outputs"] = [f"{k}.{OUTPUTS[place]}".lstrip(".") for k, place in ordered]
    if need.get("tolerance") is not None:
        try:
            body["tolerance"] = tolerance_body(need["tolerance"])
        except ValueError as error:
            raise SceneError(f"{where}.tolerance: {error}") from None
    return body


def _named(where: str, value: Json) -> Mapping[str, Json]:
    if not isinstance(value, Mapping):
        raise SceneError(f"{where}: must be a table, NAME = value, not {value!r}")
    return value


def _wrench(where: str, need: Json, parts: Iterable[str]) -> Document:
    """Return the spans of force and moment; those that `parts` names must be there."""
    if unknown := set(parts) - {"force", "moment"}:
        raise SceneError(f"{where}: unknown key {', '.join(sorted(unknown))}; write force, moment")
    body: Document = {}
    for part in parts:
        spans, place = need.get(part), f"{where}.{part}"
        if spans is None:
            raise SceneError(
                f"{place} is missing; write three [low, high], [0, 0] where none can occur"
            )
        listed = isinstance(spans, Sequence | np.ndarray) and not isinstance(spans, str)
        if not listed or len(spans) != 3:
            raise SceneError(f"{place}: write three loads (x, y, z), each [low, high] or a number")
        body[part] = [_span(f"{place}.{k}", span) for k, span in enumerate(spans)]
    return body


def _span(where: str, span: Json) -> list[float]:
    try:
        ends = np.asarray(span)
    except ValueError:  # ragged
        ends = np.asarray("")
    if ends.dtype.kind not in "fiu" or ends.shape not in ((), (2,)) or not np.isfinite(ends).all():
        raise SceneError(f"{where}: must be [low, high], or one finite number, not {span!r}")
    low, high = (-ends, ends) if ends.shape == () else ends
    if low > high:
        raise SceneError(f"{where}: the low end {low:g} must not be above the high end {high:g}")
    return [float(low) + 0.0, float(high) + 0.0]
