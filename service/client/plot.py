"""Figures of tables and deformed parts with matplotlib, which the extra ``plot`` brings.

`response` and `coverage` query a `Table` in this process, or with `component` a `Client`. Every
function draws into `axes`, or into a new figure's, and returns them.

Parameters
----------
source : Table or Client
    The table or client that answers; a client needs `component`, and queues nothing.
load, first, second : str
    Loads, of ``fx fy fz mx my mz``.
wrench : array_like, optional
    The other loads, shape (6,), N and N·m; zero if not given.
method : str, optional
    The interpolation method; the table's own if not given.
axes : matplotlib.axes.Axes, optional
    The axes to draw into; a new figure's if not given.

Raises
------
ValueError
    If there is no such load or output, if a client has no `component`, or if the component has
    several interfaces or further inputs.
MissingPackage
    If matplotlib is not installed.
"""

from __future__ import annotations

from types import ModuleType
from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np
from numpy.typing import ArrayLike

from ..contract import COVERAGE, LOADS, OUTPUTS
from ..messages import DeformedShape
from .errors import InvalidArgument, required
from .notebook import DISPLACEMENT_COLUMNS, WRENCH_COLUMNS
from .replies import Displacements
from .table import Table
from .wrenches import Vector, require_one_of, single_wrench

if TYPE_CHECKING:
    from . import Client

Axes: TypeAlias = Any  # an Axes of matplotlib, which need not be installed
COLOURS = ("#4c9f70", "#f0c05a", "#c9594c")  # colours of COVERAGE: green, yellow, red
DRAWN_SIZE = 0.1  # largest drawn displacement over the part's size: visible, and no self-overlap
_OTHER_INPUTS = (
    "{} has several interfaces or further inputs, and plots are of the six loads of one interface; "
    "draw the answers of Client.displacements or Table.batch, whose wrenches have all inputs"
)
BAND_ALPHA = 0.25  # opacity of the error band: the grid and the line show through


def response(
    source: Table | Client,
    load: str,
    output: str,
    *,
    component: str | None = None,
    wrench: ArrayLike | None = None,
    method: str | None = None,
    count: int = 201,
    axes: Axes = None,
) -> Axes:
    """Draw an output and its 95 % error band along one load, from end to end of its range.

    Parameters and errors are those of the module; `output` is one of ``ux uy uz rx ry rz``, and
    `count` is the number of wrenches.

    Returns
    -------
    matplotlib.axes.Axes
        N or N·m over m or rad. Answers that are not covered are dashed.
    """
    along, out = _index("load", load, LOADS), _index("output", output, OUTPUTS)
    low, high = _load_range(source, component)
    loads = np.linspace(low[along], high[along], count)
    answers = _answers(source, component, wrench, method, {along: loads})
    value, error = answers.displacements[:, out], answers.errors[:, out]
    axes = _pyplot().figure().add_subplot() if axes is None else axes
    axes.fill_between(
        loads, value - error, value + error, alpha=BAND_ALPHA, label="95 % error band"
    )
    covered = answers.covered
    if not covered.all():
        axes.plot(loads, value, "C0--", label="not covered")
    if covered.any():
        # No line is drawn to a covered wrench between two others; its marker is.
        shown = np.where(covered, value, np.nan)
        axes.plot(loads, shown, "C0-", marker=".", markersize=4, label="covered")
    axes.set(xlabel=WRENCH_COLUMNS[along], ylabel=DISPLACEMENT_COLUMNS[out])
    axes.set_title(f"{answers.component}, table version {answers.table_version}")
    axes.legend()
    return axes


def coverage(
    source: Table | Client,
    first: str,
    second: str,
    *,
    component: str | None = None,
    wrench: ArrayLike | None = None,
    method: str | None = None,
    count: int = 61,
    axes: Axes = None,
) -> Axes:
    """Draw where in the plane of two loads the table covers the wrench.

    Parameters and errors are those of the module; `first` and `second` are two loads, and
    `count` is the number of wrenches along each.

    Returns
    -------
    matplotlib.axes.Axes
        The plane, N or N·m, in the colours of ``covered``, ``thin`` and ``outside``.
    """
    across, up = _index("first", first, LOADS), _index("second", second, LOADS)
    if across == up:
        raise InvalidArgument(f"coverage needs two different loads, but both are {first!r}")
    low, high = _load_range(source, component)
    x = np.linspace(low[across], high[across], count)
    y = np.linspace(low[up], high[up], count)
    all_x, all_y = (loads.ravel() for loads in np.meshgrid(x, y))
    answers = _answers(source, component, wrench, method, {across: all_x, up: all_y})
    codes = (answers.coverage[:, None] == np.array(COVERAGE)).argmax(axis=1)
    pyplot = _pyplot()
    axes = pyplot.figure().add_subplot() if axes is None else axes
    colours = pyplot.matplotlib.colors.ListedColormap(COLOURS)
    ends = {"vmin": -0.5, "vmax": len(COVERAGE) - 0.5}
    shown = axes.pcolormesh(x, y, codes.reshape(count, count), cmap=colours, **ends)
    bar = axes.figure.colorbar(shown, ax=axes, ticks=range(len(COVERAGE)))
    bar.set_ticklabels([f"{name} {np.mean(codes == k):.0%}" for k, name in enumerate(COVERAGE)])
    axes.set(xlabel=WRENCH_COLUMNS[across], ylabel=WRENCH_COLUMNS[up])
    axes.set_title(f"{answers.component}, table version {answers.table_version}")
    return axes


def deformed(shape: DeformedShape, *, scale: float | None = None, axes: Axes = None) -> Axes:
    """Draw a deformed part, coloured by the length of the displacement.

    Parameters
    ----------
    shape : DeformedShape
        The result of `Client.deformed`.
    scale : float, optional
        Exaggeration of the displacement, dimensionless; by default the largest displacement is
        drawn as a tenth of the part.
    axes : mpl_toolkits.mplot3d.axes3d.Axes3D, optional
        Axes with ``projection="3d"`` to draw into; a new figure's if not given.

    Returns
    -------
    mpl_toolkits.mplot3d.axes3d.Axes3D
        The part, m.

    Raises
    ------
    MissingPackage
        If matplotlib is not installed.
    """
    pyplot = _pyplot()
    length = np.linalg.norm(shape.displacement, axis=1)
    size = np.ptp(shape.vertices, axis=0).max()
    if scale is None:
        scale = float(DRAWN_SIZE * size / length.max()) if length.max() else 1.0
    axes = pyplot.figure().add_subplot(projection="3d") if axes is None else axes
    drawn = axes.plot_trisurf(*shape.deformed(scale).T, triangles=shape.triangles, cmap="viridis")
    drawn.set_array(length[shape.triangles].mean(axis=1))
    drawn.autoscale()
    axes.figure.colorbar(drawn, ax=axes, label="displacement [m]", shrink=0.7, pad=0.18)
    axes.set(xlabel="x [m]", ylabel="y [m]", zlabel="z [m]")
    axes.set_title(f"displacement drawn {scale:.3g} times, {shape.coverage}")
    axes.set_aspect("equal")
    axes.locator_params("z", nbins=1)  # more labels of a flat part overlap
    return axes


def _pyplot() -> ModuleType:
    return required("matplotlib.pyplot", "wrenchbook.plot", "'wrenchbook[plot]'")


def _index(argument: str, name: str, names: tuple[str, ...]) -> int:
    require_one_of(argument, name, names)
    return names.index(name)


def _load_range(source: Table | Client, component: str | None) -> Vector:
    """Return the lowest and the highest loads, shape (2, 6), N and N·m."""
    if isinstance(source, Table):
        if not source.space.is_default:
            raise InvalidArgument(_OTHER_INPUTS.format(source.name))
        return source.arrays()["space/range"]
    if component is None:
        raise InvalidArgument(
            "a client answers for many components; name one, such as component='plate'"
        )
    body = source.component(component)
    if "space" in body:
        raise InvalidArgument(_OTHER_INPUTS.format(component))
    spans = body["range"]
    return np.concatenate([spans["force"], spans["moment"]]).T


def _answers(
    source: Table | Client,
    component: str | None,
    wrench: ArrayLike | None,
    method: str | None,
    loads: dict[int, Vector],
) -> Displacements:
    """Return the answers to a wrench in which some loads, by index, take many values."""
    count = len(next(iter(loads.values())))
    wrenches = np.tile(np.zeros(6) if wrench is None else single_wrench(wrench), (count, 1))
    for load, values in loads.items():
        wrenches[:, load] = values
    if isinstance(source, Table):
        return source.batch(wrenches, method=method)
    return source.displacements(str(component), wrenches, on_thin="estimate", method=method)
