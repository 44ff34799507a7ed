"""The stability table: extreme parts and loads, each answered right or refused by name.

Each case gives rows; `python -m tests.fea.stability` prints them. An error is relative to a closed
form or, where it says so, to a finer mesh.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from scipy.optimize import brentq

from tests.fea.boxes import box
from tests.fea.components import component
from tests.fea.test_failures import arch
from tests.validation.clamped import attached
from tests.validation.spring import Rod
from wrenchbook.fea.bundle.read import read_bundle
from wrenchbook.fea.component import build
from wrenchbook.fea.failure import SolveFailed
from wrenchbook.fea.solve import Solver
from wrenchbook.fea.spec.material import Material

YOUNG = 210e9
RUBBER = 3e6


@dataclass(frozen=True)
class Row:
    """What came of one part and load: "right" with its error, or the kind of a failure."""

    case: str
    setting: str
    against: str
    outcome: str
    error: float = np.nan
    told: str = ""


def answer(case, setting, against, found, expected):
    """Weigh an answer; `found` solves and returns what `expected` should equal."""
    try:
        error = np.abs(np.asarray(found()) / np.asarray(expected) - 1).max()
    except SolveFailed as failure:
        return Row(case, setting, against, failure.kind, told=failure.message)
    return Row(case, setting, against, "right", float(error))


def incompressible():
    """Bond a rubber block of 4x4x2 cells at both ends; its reference has eight times the cells."""
    rows = []
    for kind, lengths in (
        ("hex27", (0.1, 0.1, 0.05)),
        ("hex27", (0.1, 0.1, 0.01)),
        ("hex20", None),
    ):
        for poisson in (0.3, 0.49, 0.4999):
            size = lengths or (0.1, 0.1, 0.05)

            def stiffness(kind, cells, size=size, poisson=poisson):
                part = component(box(kind, cells, size), young=RUBBER, poisson=poisson)
                return np.diag(Solver(part).compliance)

            rows.append(
                answer(
                    "rubber block" if lengths else "rubber block, hex20",
                    f"{kind} nu {poisson:g}" + (f", 1:{0.1 / size[2]:.0f}" if lengths else ""),
                    "8x8x4 hex27",
                    lambda stiffness=stiffness, kind=kind: stiffness(kind, (4, 4, 2)),
                    stiffness("hex27", (8, 8, 4)),
                )
            )
    return rows


def contrast():
    """Join two materials end to end: the stiff one at the support, and at the interface."""
    rows = []
    for ratio in (1.0, 1e3, 1e6, 1e9):
        for first, second, where in ((ratio, 1.0, "inner"), (1.0, ratio, "outer")):
            part = component(box("hex20", (2, 2, 10), (0.1, 0.1, 1.0)), coupling="rigid")
            heights = part.mesh.points[part.mesh.blocks[0].nodes][:, :, 2].mean(axis=1)
            materials = [Material("all", 1e9 * times, 0.0) for times in (first, second)]
            part = replace(
                part,
                materials=tuple(materials),
                material_of_cells=((heights > 0.5).astype(int),),
            )
            give = 0.5 * (1 / first + 1 / second) / 1e9
            # Pure bending, as pure tension: exact on this mesh.
            expected = np.array([give / 0.01, give * 12 / 0.1**4])

            def found(part=part):
                return np.diag(Solver(part).compliance)[[2, 4]]

            setting = f"ratio {ratio:g}, stiff {where} half"
            rows.append(answer("two-material bar", setting, "closed form", found, expected))
    return rows


def strip(thickness, cells, **options):
    """A cantilever along z, 0.1 m wide, without Poisson's effect."""
    mesh = box("hex20", cells, (thickness, 0.1, 1.0))
    return component(mesh, young=YOUNG, poisson=0.0, **options)


def thinness():
    """Bend a cantilever by its end, by a force and (far) by a moment."""
    rows = []
    for thickness in (0.1, 0.01, 0.001):
        bending = YOUNG * 0.1 * thickness**3 / 12
        shear = 5 / 6 * YOUNG / 2 * 0.1 * thickness
        expected = np.array([1 / (3 * bending) + 1 / shear, 1 / (2 * bending), 1 / bending])

        def linear(thickness=thickness):
            compliance = Solver(strip(thickness, (2, 2, 16))).compliance
            return compliance[[0, 0, 4], [0, 4, 4]]

        setting = f"1:{1 / thickness:.0f}"
        rows.append(answer("thin cantilever, linear", setting, "beam theory", linear, expected))
        angle = np.radians(15)

        def turned(thickness=thickness, moment=bending * angle):
            part = strip(thickness, (2, 2, 16), nonlinear=True)
            return Solver(part).solve([0, 0, 0, 0, moment, 0]).displacement[[0, 4]]

        circle = [(1 - np.cos(angle)) / angle, angle]
        rows.append(answer("thin cantilever, 15 degrees", setting, "circle", turned, circle))
    return rows


def magnitudes():
    """Pull and push a guided bar: F = E A l (l^2 - 1)/2 has a minimum at l = 1/sqrt(3)."""
    mesh = box("hex20", (2, 2, 4), (0.1, 0.1, 0.4))
    guide = ("ux", "uy", "rx", "ry", "rz")
    bar = Solver(component(mesh, young=YOUNG, poisson=0.0, nonlinear=True, locked=guide))
    rows = []
    for force in (*(10.0**n for n in range(-9, 10)), -1.0, -1e3, -1e6, -1e8, -1e9):

        def found(force=force):
            return bar.solve([0, 0, force, 0, 0, 0]).displacement[2]

        expected = 0.4 * extension(force / (YOUNG * 0.01))
        rows.append(answer("guided bar", f"{force:g} N", "closed form", found, expected))
    return rows


def extension(strain):
    """Solve (1 + e) (2 e + e^2)/2 = strain for e: the least in size, NaN if there is none."""
    if strain < -1 / np.sqrt(27):
        return np.nan
    if abs(strain) < 1e-6:
        return strain - 1.5 * strain**2
    return brentq(lambda e: (1 + e) * (e + e * e / 2) - strain, 1 / np.sqrt(3) - 1, 5, xtol=1e-15)


def pure_moment():
    """Bend a bar into a circle by a moment alone, within the limit of tables and beyond."""
    rows = []
    bending = YOUNG * 0.1 * 0.01**3 / 12
    for coupling in ("rigid", "distributed"):
        part = attached(strip(0.01, (2, 2, 16), nonlinear=True), coupling=coupling)
        for degrees in (1e-6, 1.0, 19.0, 25.0, 1000.0):
            angle = np.radians(degrees)

            def found(part=part, angle=angle):
                return Solver(part).solve([0, 0, 0, 0, bending * angle, 0]).displacement[[0, 4]]

            sideways = 2 * np.sin(angle / 2) ** 2 / angle
            setting = f"{degrees:g} degrees, {coupling}"
            rows.append(answer("pure moment", setting, "circle", found, [sideways, angle]))
    return rows


def one_element():
    """Bend bars of one cell across the thickness, and across both sides."""
    rows = []
    for kind, integration, cells in (
        ("hex20", "reduced", (1, 2, 16)),
        ("hex20", "reduced", (1, 1, 16)),
        ("hex20", "full", (1, 1, 16)),
        ("hex27", "full", (1, 1, 16)),
        ("tet10", "full", (1, 1, 64)),
    ):
        mesh = box(kind, cells, (0.02, 0.02, 1.0))
        part = component(
            mesh, young=YOUNG, poisson=0.3, coupling="distributed", integration=integration
        )
        bending = YOUNG * 0.02**4 / 12
        expected = [1 / (3 * bending), 1 / bending]

        def found(part=part):
            return np.diag(Solver(part).compliance)[[0, 4]]

        setting = f"{kind} {integration}, {cells[0]} x {cells[1]} across"
        rows.append(answer("one element thick", setting, "beam theory", found, expected))
    return rows


def snap_through():
    """Load a shallow arch at its crown to below and above its limit load, guided and not."""
    rows = []
    for guide, forces in ((("ry",), (4000.0, 5000.0)), ((), (2000.0, 4000.0))):
        built = Solver(arch(locked=guide))
        below = Solver(arch(divisions=(40, 2, 2), locked=guide))
        expected = below.solve([0, 0, -forces[0], 0, 0, 0]).displacement[2]
        for force in forces:

            def sunk(built=built, force=force):
                return built.solve([0, 0, -force, 0, 0, 0]).displacement[2]

            setting = f"{force:g} N, {'guided' if guide else 'free to tip'}"
            rows.append(answer("shallow arch", setting, "twice the cells", sunk, expected))
    return rows


def spring():
    """Press the spring of the paper with 10 N, without its guide and with it."""
    part = build(read_bundle(Path(__file__).parents[2] / "data/components/spring"))
    rod = Rod(1.4e-3, 22.6e-3, 5.5, 88e-3, 200e9, 0.28)
    built = {"guided": Solver(part), "unguided": Solver(attached(part, locked=()))}
    rows = []
    for force, guide in ((-1.0, "guided"), (-10.0, "guided"), (-10.0, "unguided")):

        def sunk(built=built[guide], force=force):
            return built.solve([0, 0, force, 0, 0, 0]).displacement[2]

        short = brentq(lambda s, force=force: rod.pressed(s)[0] + force, 1e-6, 0.03)
        rows.append(answer("spring", f"{-force:g} N, {guide}", "rod theory", sunk, -short))
    return rows


CASES = {
    "incompressible": incompressible,
    "contrast": contrast,
    "thinness": thinness,
    "magnitudes": magnitudes,
    "pure_moment": pure_moment,
    "one_element": one_element,
    "snap_through": snap_through,
    "spring": spring,
}


def table():
    """Return all rows as lines of text."""
    for rows in CASES.values():
        for row in rows():
            worth = f"{row.error:.1e}" if row.outcome == "right" else row.told
            yield f"{row.case:32} {row.setting:34} {row.outcome:18} {row.against:14} {worth}"


if __name__ == "__main__":
    for line in table():
        print(line)
