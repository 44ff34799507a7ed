"""A scene's table as one file: arrays, and a tree in JSON that says what they are.

The file is an NPZ archive of numbers and texts. Nothing in it is run: the tree names only the kinds
listed here, and each is made by its own constructor. What answers is in it as it is, not what it
would be built from, so that the answers are the same digits on any machine.
"""

from __future__ import annotations

import io
import json
import zipfile
from collections.abc import Callable
from dataclasses import fields, is_dataclass, replace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..allowed import Allowed
from ..bars.error_law import ErrorLaw
from ..composition.composition import AtRest
from ..doubt import Doubt
from ..kriging import Hyperparameters, Kriging, KrigingSettings
from ..kriging.calibration import Calibration
from ..kriging.dense import Dense, Spread
from ..kriging.equations import Equations, Scaling
from ..kriging.factor import Factor
from ..kriging.neighbourhood import Finder, LocalFactor
from ..solver_error import SolverError
from ..table.axes import AXES, Axis, AxisRows
from ..table.compliance import ComplianceFit
from ..table.rows import LoadRange, Rows, Tolerance
from .need import Need
from .part import Axes, Part
from .scene_table import SceneTable

FORMAT = 3
_TREE = "tree"
_KINDS: dict[str, type] = {
    kind.__name__: kind
    for kind in (
        Allowed, AtRest, Axes, AxisRows, Calibration, ComplianceFit, Dense, Doubt, Equations,
        ErrorLaw, Factor,
        Hyperparameters, Kriging, KrigingSettings, LoadRange, LocalFactor, Need, Part, Rows,
        Scaling, Spread, Tolerance,
    )
}  # fmt: skip


class SceneFileError(ValueError):
    """Bytes that are no scene's table, or one of another version."""


class _Finding(NamedTuple):
    """A finder before the equations are there that it looks among."""

    rows: NDArray[np.intp]
    most_rows: int
    most_equations: int


def write_scene(table: SceneTable) -> bytes:
    """Return a scene's table as a file."""
    arrays: dict[str, Any] = {}
    tree = {
        "format": FORMAT,
        "need": _packed(table.need, arrays),
        "parts": _packed(table.parts, arrays),
        "rows": _packed(table.rows, arrays),
        "version": table.version,
        "default": table.default,
        "plan": table.plan,
        "solver_error": table.solver_error and table.solver_error.told,
    }
    content = io.BytesIO()
    np.savez_compressed(
        content, allow_pickle=False, **{_TREE: np.array(json.dumps(tree))}, **arrays
    )
    return content.getvalue()


def read_scene(content: bytes) -> SceneTable:
    """Return the scene's table of a file.

    Raises
    ------
    SceneFileError
        If the bytes are no such file, or one of a version that this one does not read.
    """
    try:
        with np.load(io.BytesIO(content), allow_pickle=False) as arrays:
            tree = json.loads(str(arrays[_TREE]))
            if tree["format"] != FORMAT:
                raise SceneFileError(
                    f"a scene's table of form {tree['format']}; this version reads {FORMAT}: have "
                    "the same version of wrenchbook on both sides"
                )
            need, parts, rows = (_made(tree[name], arrays) for name in ("need", "parts", "rows"))
            named = tree["version"], tree["default"], tree["plan"]
            error = SolverError.read(tree.get("solver_error"))
    except SceneFileError:
        raise
    except (ValueError, KeyError, TypeError, OSError, EOFError, zipfile.BadZipFile) as error:
        raise SceneFileError(f"no scene's table: {error}") from error
    return SceneTable(need, parts, rows, *named, error)


def _packed(value: Any, arrays: dict[str, Any]) -> Any:
    """Return a value as JSON has it; its arrays are put with the others, by a number."""
    if isinstance(value, np.ndarray):
        name = f"a{len(arrays)}"
        arrays[name] = value
        return {"array": name}
    if isinstance(value, Axis):
        return {"axis": value.name}
    if isinstance(value, Finder):
        finding = _Finding(value.rows, value.most_rows, value.most_equations)
        return {"finder": [_packed(one, arrays) for one in finding]}
    if isinstance(value, tuple | list):
        return {"tuple": [_packed(one, arrays) for one in value]}
    if is_dataclass(value) and not isinstance(value, type):
        held = {one.name: _packed(getattr(value, one.name), arrays) for one in fields(value)}
        return {"kind": type(value).__name__, "fields": held}
    return value.item() if isinstance(value, np.generic) else value


def _made(node: Any, arrays: Any) -> Any:
    """Return the value of a node of the tree."""
    if not isinstance(node, dict):
        return node
    ((how, what), *_) = node.items()
    if how == "kind":
        given = {name: _made(one, arrays) for name, one in node["fields"].items()}
        return _MAKERS.get(what, _KINDS[what])(**given)
    if how == "array":
        return arrays[what]
    if how == "axis":
        return next(axis for axis in AXES if axis.name == what)
    made = [_made(one, arrays) for one in what]
    return _Finding(*made) if how == "finder" else tuple(made)


def _dense(equations: Equations, held: Hyperparameters, shares: Any, **rest: Any) -> Dense:
    """Return a dense kriging, its finders over its equations."""
    whole = tuple(
        replace(share, finder=Finder(equations, finder.rows, held, *finder[1:]))
        for share in shares
        for finder in (share.finder,)
    )
    return Dense(equations=equations, held=held, shares=whole, **rest)


_MAKERS: dict[str, Callable[..., Any]] = {"Dense": _dense}
