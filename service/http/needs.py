"""Requirements on a table, from the bodies of scenes and fills."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from wrenchbook.service.http import bodies
from wrenchbook.service.http.problems import bad_body
from wrenchbook.service.library.component import Component
from wrenchbook.service.mistakes import MAX_VALUE
from wrenchbook.surrogate.scene.plan import Need, NeedError, need_of
from wrenchbook.surrogate.table.rows import Floats, LoadRange
from wrenchbook.surrogate.table.space import Space


def scene_need(component: Component, wanted: bodies.SceneComponent, where: str) -> Need:
    """Return a scene's requirements on a component; `where`: the path of `wanted` in the body.

    Raises HttpProblemError (422) for unknown names and ends beyond the range.
    """
    return _need(component, wanted, wanted.outputs, wanted.tolerance, where, f"{where}.outputs")


def fill_need(component: Component, order: bodies.FillBody) -> Need:
    """Return the requirements of a fill of a part of a table; raises as `scene_need`."""
    return _need(component, order.range, order.outputs, order.tolerance, "range", "outputs")


def _need(
    component: Component,
    span: bodies.SpaceSpan | None,
    outputs: Sequence[str] | None,
    tolerance: bodies.ToleranceBody | None,
    of_span: str,
    of_outputs: str,
) -> Need:
    """Return requirements; `of_span` and `of_outputs` are the paths of two of them in the body."""
    load_range, names = component.load_range, component.space.output_names
    mistakes = [] if span is None else _unknown(span, load_range.space, of_span)
    for index, name in enumerate(outputs or ()):
        if name not in names:
            message = f"must be one of {', '.join(names)}, not {name[:MAX_VALUE]!r}"
            mistakes.append({"loc": f"{of_outputs}.{index}", "msg": message})
    if mistakes:
        raise bad_body(mistakes)

    bounds = None if span is None else _bounds(span, load_range)
    read = None if outputs is None else [names.index(name) for name in outputs]
    try:
        return need_of(load_range, bounds, read, bodies.tolerance_of(tolerance), component.idle)
    except NeedError as error:
        places = [(_path_of(load_range.space, index), text) for index, text in error.mistakes]
        raise bad_body(
            [{"loc": f"{of_span}.{path}", "msg": text} for path, text in places]
        ) from None


def _path_of(space: Space, index: int) -> str:
    """Return an input's path in a span: ``force.0``, ``loads.left.force.0``, ``inputs.NAME``."""
    load = space.inputs[index]
    if load.kind == "scalar":
        return f"inputs.{load.name}"
    front = f"loads.{load.interface}." if load.interface else ""
    return f"{front}{load.kind}.{index % 3}"  # interfaces come first, with three loads of a kind


def _unknown(span: bodies.SpaceSpan, space: Space, where: str) -> list[dict[str, str]]:
    """Return the mistakes of interfaces and inputs that the component lacks."""
    interfaces = ", ".join(space.interfaces)
    further = [load.name for load in space.scalars]
    mistakes = []
    for name in ("force", "moment"):
        if space.several and getattr(span, name) is not None:
            text = f"the component has the interfaces {interfaces}; give 'loads' by interface"
            mistakes.append((name, text))
    for name in span.loads or ():
        if not space.several:
            text = "the component has one interface; give 'force' and 'moment'"
            mistakes.append(("loads", text))
        elif name not in space.interfaces:
            text = f"is not an interface of the component; name one of {interfaces}"
            mistakes.append((f"loads.{name}", text))
    for name in span.inputs or ():
        if name not in further:
            remedy = ": the component has none; leave inputs out"
            if further:
                remedy = f"; name one of {', '.join(further)}"
            mistakes.append((f"inputs.{name}", f"is not a further input here{remedy}"))
    return [{"loc": f"{where}.{path}", "msg": text} for path, text in mistakes]


def _bounds(span: bodies.SpaceSpan, load_range: LoadRange) -> Floats:
    """Return the low and the high end of each input, shape (n, 2), N, N·m and further units."""
    loads, further = span.loads or {}, span.inputs or {}
    zero = [[0.0, 0.0]] * 3
    spans = []
    for name in load_range.space.interfaces:
        of_interface = loads.get(name, bodies.InterfaceSpan()) if name else span
        spans += [*(of_interface.force or zero), *(of_interface.moment or zero)]
    # Further inputs come after the loads.
    for load, low, high in zip(
        load_range.space.inputs, load_range.low, load_range.high, strict=True
    ):
        if load.kind == "scalar":
            spans.append(further.get(load.name, [low, high]))
    return np.array([[-ends, ends] if isinstance(ends, int | float) else ends for ends in spans])
