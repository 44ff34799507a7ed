"""What a body says that a scene needs of a component."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from wrenchbook.service.http.bodies import RangeBody, ToleranceBody
from wrenchbook.service.http.problems import bad_body
from wrenchbook.service.library.component import Component
from wrenchbook.surrogate.scene.need import Need, NeedError, need_of
from wrenchbook.surrogate.table.rows import OUTPUTS, Tolerance


def need_from(
    component: Component,
    span: RangeBody | None,
    outputs: Sequence[str] | None,
    tolerance: ToleranceBody | None,
    where: str,
) -> Need:
    """Return what a scene needs of a component, from the parts of a body.

    Raises
    ------
    ProblemError
        422, if an end is beyond the component's load range or the two ends are the wrong way round.
    """
    bounds = None if span is None else np.array(span.bounds())
    read = range(6) if outputs is None else [OUTPUTS.index(name) for name in outputs]
    limit = Tolerance(tolerance.translation, tolerance.rotation) if tolerance else None
    try:
        return need_of(component.load_range, bounds, read, limit, component.idle)
    except NeedError as error:
        raise bad_body([_mistake(where, *one) for one in error.mistakes]) from None


def _mistake(where: str, load: int, message: str) -> dict[str, str]:
    word, place = ("force", load) if load < 3 else ("moment", load - 3)
    return {"loc": f"{where}.{word}.{place}", "msg": message}
