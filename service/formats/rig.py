"""From readings of a test rig to rows of the interface: zero offset, frame, reference points.

Forces and translations are polar vectors. Moments and rotations are axial vectors: left-handed axes
change their sign. Points are in the interface's frame, from the interface's point.
"""

from __future__ import annotations

import hashlib
import json
import re
import tomllib
from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from wrenchbook.fea.spec.problems import suggest
from wrenchbook.service.formats.cells import text_problem
from wrenchbook.service.formats.limits import LOAD_LIMIT, largest_loads
from wrenchbook.service.formats.options import (
    FEA,
    MEASURED,
    Array,
    Options,
    ParsedTable,
    Problem,
    ReadReport,
    picked,
)
from wrenchbook.surrogate.table.space import PER_INTERFACE

MAX_RIG = 8000  # characters of a TOML: it is sent in a URL, whose head has 64 KiB at most
_MAX_NAME = 100  # characters of a rig's name
# Largest deviation of axes: those written as 0.707 are perpendicular unit vectors to 2e-4.
_SKEW = 1e-3
_ROUNDOFF = 1e-12  # error of the nearest rotation by a singular value decomposition
_FARTHEST = 100.0  # m: a point given in mm is refused
_LOAD_POINT, _DISPLACEMENT_POINT = "load_point", "displacement_point"
_FRAME_KEYS = ("frame", _LOAD_POINT, _DISPLACEMENT_POINT, "load_cell")
_OWN = "import"  # the table of one import's options, which replace those of the profile
# Keys of a profile beside those of the frame, with the names of the import's own options.
OPTIONS = (
    *("columns", "ignore", "ignore_extra", "decimal", "missing_loads", "tare", "lag", "sheet"),
    *("skip_cycles", "branch", "thin", "mean_cycles"),
)
NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9_.-]{0,63}")  # name of a stored or shipped profile
_LOAD_CELLS = ("moving", "fixed")
_SMALL_SHIFT = 0.01  # part of the moment's range: the default tolerance of an output
_FEW_ROWS = 0.1  # part of the rows: outliers and corners of the load range alone are not enough
_AXES = dict(zip("xyz", np.eye(3), strict=True))
_PART = re.compile(r"\s*([xyz])\s*=\s*([+-]?)\s*([xyz])\s*")
_MARK = ", rig "  # stands in a row's source before the rig's name
_DONE = (
    "is already in the interface frame, as a solve, a tangent or an earlier import with a rig; "
    "load such rows without frame, load_point, displacement_point, load_cell and rig"
)
_ROTATIONS_MISSING = (
    "is not measured, but a displacement_point needs all three rotations; measure them, or measure "
    "at the interface's point and leave displacement_point out"
)
_TRANSLATIONS_MISSING = (
    "is not measured, but in this frame all three are needed; measure them, or leave the frame out "
    "and name the columns by the interface's axes"
)
_NO_SHIFT = (
    "is not measured, but load_cell=fixed subtracts translation x force from the moment; measure "
    "it, or give the moment about the moved interface point with load_cell=moving"
)
_ONE_INTERFACE = (
    "a rig needs a component with one interface and no further inputs; convert the rows, and leave "
    "frame, load_point and displacement_point out"
)
_WHICH_POINT = (
    "translation x force exceeds 1 % of the moment's range{more} in {count} of {rows} rows (row "
    "{row}: {value:.3g} N*m, {share:.2g} %). Check the translations' unit. For moments about the "
    "moved point set load_cell=moving (--load-cell moving), else load_cell=fixed"
)


class RigError(ValueError):
    """A rig cannot be read; the message has the remedy."""


@dataclass(frozen=True)
class Rig:
    """Axes and reference points of the readings of a test."""

    axes: Array  # (3, 3), the rig's x, y and z axis in the interface's frame, a row each
    load_point: Array  # (3,), m: the point that moments are about
    displacement_point: Array  # (3,), m: the point whose translation was measured
    name: str = ""
    # Whether the load point moves with the interface or stays in place: moving, fixed; empty if
    # unknown.
    load_cell: str = ""
    options: dict[str, Any] = field(default_factory=dict)  # options of an import, by `OPTIONS`

    @classmethod
    def read(cls, text: str) -> Rig:
        """Return the rig of a TOML text; raises RigError if a key or a value is wrong.

        Values of its table ``import`` replace those of the top level.
        """
        try:
            values = tomllib.loads(text)
        except (tomllib.TOMLDecodeError, RecursionError) as error:
            raise RigError(f"the rig is not TOML ({error}); correct it there") from None
        table = values.pop(_OWN, {})
        values |= table if isinstance(table, dict) else {_OWN: table}
        known = "name", *_FRAME_KEYS, *OPTIONS

        if unknown := [key for key in values if key not in known]:
            near = suggest(unknown[0][:100], known)
            named = f"the rig has no key {unknown[0][:100]!r}{near}"
            raise RigError(f"{named}{' Known: ' if near else '; use '}{', '.join(known)}")
        name = values.get("name", cls.digest(text))
        if not isinstance(name, str):
            raise RigError(
                f"name: must be a string, not {str(name)[:100]}; put it in quotation marks"
            )
        if len(name) > _MAX_NAME:
            raise RigError(f"name: has {len(name)} characters, over {_MAX_NAME}; shorten it")
        if problem := text_problem(name):
            raise RigError(f"name: {problem}")
        cell = values.get("load_cell", "")
        if cell not in ("", *_LOAD_CELLS):
            raise RigError(f"load_cell: must be moving or fixed, not {str(cell)[:100]!r}")

        points = (_LOAD_POINT, _DISPLACEMENT_POINT)
        loads, moved = (_numbers(key, values.get(key, [0, 0, 0]), 3) for key in points)
        options = {key: values[key] for key in OPTIONS if key in values}
        axes = _axes(values.get("frame", "x=x,y=y,z=z"))
        return cls(axes, loads, moved, name.strip(), cell, options)

    @staticmethod
    def digest(text: str) -> str:
        """Return the name of a rig whose TOML has none."""
        return hashlib.sha256(text.encode()).hexdigest()[:8]

    @property
    def turn(self) -> Array:
        """The matrix that rotates six rig components, as rows, to the interface's frame, (6, 6)."""
        return np.kron(np.diag([1.0, np.sign(np.linalg.det(self.axes))]), self.axes)

    def loads(self, wrench: Array) -> Array:
        """Return wrenches at the interface's point, (n, 6), from the rig's, N and N·m."""
        turned = wrench @ self.turn
        turned[:, 3:] += np.cross(self.load_point, turned[:, :3])
        return turned

    def displacements(self, moved: Array) -> Array:
        """Return displacements of the interface's point, (n, 6), m and rad; NaN if unknown."""
        turned = _product(moved, self.turn)
        if self.displacement_point.any():
            turned[:, :3] -= _swing(turned[:, 3:], self.displacement_point)
        return turned

    def uncertainties(self, uncertainty: Array) -> Array:
        """Return 95 % half widths, (n, 6), from the rig's, m and rad, of independent errors."""
        lever = np.eye(6)
        lever[3:, :3] = -np.cross(np.eye(3), self.displacement_point)
        return np.sqrt(_product(uncertainty**2, (self.turn @ lever) ** 2))

    def as_json(self) -> dict[str, Any]:
        """Return the rig as JSON-able values."""
        return {
            "name": self.name,
            "left_handed": bool(np.linalg.det(self.axes) < 0),
            "frame": self.axes.tolist(),
            _LOAD_POINT: self.load_point.tolist(),
            _DISPLACEMENT_POINT: self.displacement_point.tolist(),
            "load_cell": self.load_cell or None,
        }


def rig_text(*parts: str, of: str = "") -> str:
    """Return the TOML of frame, load point, displacement point and load cell, without empty ones.

    They replace those of the TOML `of`, which precedes them.
    """
    pairs = zip(_FRAME_KEYS, parts, strict=False)
    text = "".join(
        f"{key} = {json.dumps(text, ensure_ascii=False)}\n" for key, text in pairs if text.strip()
    )
    return f"{of.rstrip()}\n\n[{_OWN}]\n{text}" if of and text else of or text


def rigged(
    pieces: Iterator[ParsedTable], options: Options, report: ReadReport
) -> Iterator[ParsedTable]:
    """Yield rows of the interface from rows of the rig `options.rig`, named in their source."""
    if not options.rig:
        yield from pieces
        return
    rig = Rig.read(options.rig)
    names = options.columns.displacement
    at_interface = (rig.axes == np.eye(3)).all() and not np.any(
        [rig.load_point, rig.displacement_point]
    )
    if not at_interface and not options.space.is_default:
        report.mistakes.ruin(0, "rig", _ONE_INTERFACE)
        return

    for piece in pieces:
        loads, moved, uncertainty = piece.wrench, piece.displacement, piece.uncertainty
        if not at_interface:
            loads, moved = rig.loads(loads), rig.displacements(moved)
            stated = any(uncertainty.strides)
            uncertainty = rig.uncertainties(uncertainty) if stated else uncertainty

        shift = np.zeros(loads.shape)
        if rig.load_cell == "fixed":
            shift = _shift(loads, moved)
        elif rig.load_cell == "moving" and rig.load_point.any():
            # The point moves with the section: its lever rotates by the measured rotation.
            lever = _swing(np.nan_to_num(moved[:, 3:]), rig.load_point)
            shift[:, 3:] = -np.cross(lever, loads[:, :3])

        good = np.ones(len(piece), dtype=bool)
        for at, name, message in _problems(piece, rig, moved, shift, names):
            good[at] = False
            report.mistakes.add(int(piece.seq[at]), report.labels.get(name, name), message)
        source = np.where(piece.source == "", MEASURED, piece.source)
        columns = {"wrench": loads - shift, "displacement": moved, "uncertainty": uncertainty}
        columns["source"] = np.char.add(source, f"{_MARK}{rig.name}")
        yield ParsedTable(**picked(vars(piece) | columns, good))


def with_known_point(
    pieces: Iterator[ParsedTable], options: Options, report: ReadReport
) -> Iterator[ParsedTable]:
    """Yield the rows of the interface; refuse a file that must state the point of its moments.

    It must if translation x force exceeds 1 % of a moment's range, or changes the answer of a
    component with solves by more than the row's stated uncertainty, in over 10 % of the rows. Rows
    with a source (an export's) or slopes are about the displaced interface point, and so is a
    moment without a column, which no cell has measured.
    """
    load_range, solved = options.load_range, options.solved
    if load_range is None or not load_range.space.is_default or Rig.read(options.rig).load_cell:
        yield from pieces
        return
    size = largest_loads(load_range) / LOAD_LIMIT
    count = np.zeros(len(size) + 1)  # rows beyond each input's limit, and beyond their uncertainty
    rows = 0
    worst_share = 0.0  # the largest shift over the moment's range, dimensionless
    worst_row = 0
    worst_shift = 0.0  # N·m
    for piece in pieces:
        yield piece
        is_checked = np.ones(len(piece), dtype=bool)
        has_column = np.ones(len(size), dtype=bool)
        if not options.rig:
            is_checked = ~(_of_interface(piece) | (piece.source != ""))
            names = {name for _, name, _ in report.columns}
            has_column = np.array([not names or n in names for n in options.columns.wrench])

        shift = np.nan_to_num(_shift(piece.wrench, piece.displacement))[is_checked] * has_column
        share = np.abs(shift) / size
        rows = rows + len(shift)
        count[:-1] += (share > _SMALL_SHIFT).sum(axis=0)
        if solved is not None and any(piece.uncertainty.strides):
            effect = np.abs(shift @ np.transpose(solved))
            count[-1] += (effect > piece.uncertainty[is_checked]).any(axis=1).sum()
        if share.max(initial=0.0) > worst_share:
            at, load = np.unravel_index(share.argmax(), share.shape)
            worst_share = float(share[at, load])
            worst_shift = float(np.abs(shift[at, load]))
            worst_row = int(piece.seq[is_checked][at])

    if (count > _FEW_ROWS * rows).any():
        more = " or the row's stated uncertainty" if count[-1] > _FEW_ROWS * rows else ""
        numbers = {"count": int(count.max()), "rows": rows, "row": worst_row}
        sizes = {"value": worst_shift, "share": 100.0 * worst_share}
        message = _WHICH_POINT.format(more=more, **numbers, **sizes)
        report.mistakes.ruin(0, "load_cell", message)


def _shift(wrench: Array, displacement: Array) -> Array:
    """Return translation x force at each moment, (n, inputs), N·m; NaN where unknown."""
    shift = np.zeros(wrench.shape)
    for first in range(0, displacement.shape[1], PER_INTERFACE):
        force, moved = (values[:, first : first + 3] for values in (wrench, displacement))
        for axis in range(3):
            a, b = (axis + 1) % 3, (axis + 2) % 3
            ahead = np.where(force[:, b] != 0.0, moved[:, a] * force[:, b], 0.0)
            back = np.where(force[:, a] != 0.0, moved[:, b] * force[:, a], 0.0)
            shift[:, first + 3 + axis] = ahead - back
    return shift


def _of_interface(piece: ParsedTable) -> Array:
    """Return which rows, (n,), are solves, have slopes, or were imported with a rig before."""
    known = np.zeros(len(piece), dtype=bool)
    if any(piece.compliance.strides):
        known |= np.isfinite(piece.compliance).any(axis=(1, 2))
    known |= np.isfinite(piece.curvature).any(axis=1)
    known |= (piece.source == FEA) | (piece.fingerprint != "")
    return known | (np.char.find(piece.source, _MARK) >= 0)


def _problems(
    piece: ParsedTable, rig: Rig, moved: Array, shift: Array, names: tuple[str, ...]
) -> Iterator[Problem]:
    """Yield the rows that are the interface's already, and those that cannot be moved to it."""
    missing = np.isnan(piece.displacement)
    is_interface = _of_interface(piece)
    lacks_rotation = np.asarray(missing[:, 3:].any(axis=1) & ~missing[:, :3].all(axis=1))
    lacks_rotation &= rig.displacement_point.any()
    lacks_translation = np.asarray(np.isnan(moved).all(axis=1))
    wrong = is_interface | lacks_rotation | lacks_translation | np.isnan(shift).any(axis=1)
    for at in np.flatnonzero(wrong).tolist():
        if is_interface[at]:
            yield at, "source", _DONE
        elif lacks_rotation[at]:
            yield at, names[3 + int(missing[at, 3:].argmax())], _ROTATIONS_MISSING
        elif lacks_translation[at]:
            yield at, names[int(missing[at].argmax())], _TRANSLATIONS_MISSING
        else:
            first = int(np.isnan(shift[at]).argmax()) // PER_INTERFACE * PER_INTERFACE
            yield at, names[first + int(np.isnan(moved[at, first:]).argmax())], _NO_SHIFT


def _product(values: Array, matrix: Array) -> Array:
    """Return values @ matrix, (n, 6); NaN only where a factor that is not zero meets a NaN."""
    unknown = np.isnan(values)
    product = np.where(unknown, 0.0, values) @ matrix
    product[unknown @ (matrix != 0.0)] = np.nan
    return product


def _swing(rotation: Array, point: Array) -> Array:
    """Return (exp(r) - 1) p, (n, 3), m, of rotation vectors (n, 3), rad, without cancellation."""
    angle = np.linalg.norm(rotation, axis=1, keepdims=True) / np.pi
    first = np.cross(rotation, point)
    return np.sinc(angle) * first + 0.5 * np.sinc(0.5 * angle) ** 2 * np.cross(rotation, first)


def _axes(value: Any) -> Array:
    """Return the rig's axes, (3, 3), of `x=-y,y=x,z=z` or of nine numbers."""
    if isinstance(value, str) and "=" in value:
        parts = [_PART.fullmatch(part) for part in value.lower().split(",")]
        signed = {m[1]: _AXES[m[3]] * (-1.0 if m[2] == "-" else 1.0) for m in parts if m}
        if len(parts) != 3 or len(signed) != 3:
            raise RigError(f"frame: {value[:100]!r} must have a form such as x=-y,y=x,z=z")
        axes = np.stack([signed[axis] for axis in "xyz"])
    else:
        axes = _numbers("frame", value, 9).reshape(3, 3)

    left, _, right = np.linalg.svd(axes)
    nearest = left @ right
    if (skew := np.abs(axes - nearest).max()) > _SKEW:
        raise RigError(
            "frame: the rig's axes must be three perpendicular unit vectors, but a component is "
            f"off by {skew:.2g} (at most {_SKEW:g}); write x=-y,y=x,z=z, or nine numbers: the "
            "rig's x, y and z axes in the interface's frame"
        )
    if (axes == axes.round()).all():
        return axes
    return np.where(np.abs(nearest) < _ROUNDOFF, 0.0, nearest)


def _numbers(name: str, value: Any, count: int) -> Array:
    """Return `count` numbers of the profile's entry `name`, a list or a text; raises RigError."""
    try:
        values = re.split(r"[,;\s]+", value.strip()) if isinstance(value, str) else value
        numbers = np.array(values, dtype=float).ravel()
    except (ValueError, TypeError, OverflowError):
        numbers = np.empty(0)
    example = "0,0,0.05" if count == 3 else "x=-y,y=x,z=z, or the rig's three axes"
    if len(numbers) != count:
        raise RigError(f"{name}: {str(value)[:60]!r} is not {count} numbers; write {example}")
    if not np.isfinite(numbers).all():
        raise RigError(f"{name}: {str(value)[:60]!r} has a number that is not finite; correct it")
    if (np.abs(numbers) > _FARTHEST).any():
        limit = (
            f"{_FARTHEST:g} m; write metres" if count == 3 else f"{_FARTHEST:g}; write {example}"
        )
        raise RigError(f"{name}: {str(value)[:60]!r} has a number beyond {limit}")
    return numbers


def zeroed(
    pieces: Iterator[ParsedTable], options: Options, report: ReadReport
) -> Iterator[ParsedTable]:
    """Yield rows less the mean of the first `options.zero_rows` good ones, which are left out."""
    if not options.zero_rows:
        yield from pieces
        return
    offset = None
    for piece in pieces:
        if offset is None:
            count = options.zero_rows
            if len(piece) <= count:
                message = f"tare={count}, but there are only {len(piece)} good rows; give fewer"
                report.mistakes.ruin(0, "tare", message)
                return
            moved = piece.displacement[:count]
            known = np.isfinite(moved)  # 0 where nothing was measured
            sums = np.where(known, moved, 0.0).sum(axis=0)
            offset = piece.wrench[:count].mean(axis=0), sums / np.maximum(known.sum(axis=0), 1)
            offset[0][len(options.columns.loads) :] = 0.0  # a temperature has its own zero
            report.zeroed = count
            piece = piece.take(np.arange(len(piece)) >= count)
        wrench, displacement = piece.wrench - offset[0], piece.displacement - offset[1]
        yield replace(piece, wrench=wrench, displacement=displacement)
