"""The error bars of a linear analysis beside nonlinear solves: `make bench NAME=linearity`.

Two shipped components, ten kinds of parts, two STEP parts, two cantilevers of an interface each and
guided parts that stiffen, all as linear components, at each of their loads alone, at corners of the
load range, and at wrenches of all loads by chance (the variable SEED draws others). Each range is
scaled so that its worst corner turns an interface by `LARGEST_TURN`, but of guided parts, which do
not turn. Beside them is the law without second derivatives, whose error grows with the square of
the largest load.
"""

import os
from copy import copy
from dataclasses import replace

import numpy as np
import pytest

from tests.benchmarks.kinds_of_parts import kinds
from tests.benchmarks.test_mesh_error import bundle_of
from tests.fea.supports import TABLE
from tests.fea.two_interfaces import two_cantilevers
from wrenchbook.fea.accuracy.convergence import coarser
from wrenchbook.fea.accuracy.estimate import linearity_of
from wrenchbook.fea.bundle.read import bundle_of as bundle_of_table
from wrenchbook.fea.bundle.read import read_bundle
from wrenchbook.fea.failure import SolveFailed
from wrenchbook.fea.solve import Solver
from wrenchbook.fea.spec.schema import DeclaredRange
from wrenchbook.surrogate.solver_error import SolverError

LARGEST_TURN = 0.1
"""rad, by the linear answer: beyond six degrees a part is no linear one for anybody."""


def shipped_or_drawn(name, folder):
    return bundle_of(name, folder)


def kind_of(make):
    return lambda name, folder: make(name, folder)[0]


BEAM = {"generator": "bar", "length": 0.5, "width": 0.02, "height": 0.01, "cells_along": 12}
SQUARE = {"generator": "plate", "length": 0.4, "width": 0.4, "patch": 0.1, "cells": 6}
GUIDED = {  # mesh, support, section, and the load along the only free direction, N
    "guided beam, 11 N": (BEAM, "start", "end", 11.0),
    "guided beam, 80 N": (BEAM, "start", "end", 80.0),
    "guided beam, 500 N": (BEAM, "start", "end", 500.0),
    "guided plate, 600 N": (SQUARE | {"thickness": 0.002}, "rim", "patch", 600.0),
    "guided plate, 2000 N": (SQUARE | {"thickness": 0.002}, "rim", "patch", 2000.0),
}


def guided(name, folder):
    mesh, support, section, force = GUIDED[name]
    table = TABLE | {"mesh": mesh, "supports": {"fixed": [support]}}
    table["material"] = [{"region": "all", "youngs_modulus": 70e9, "poisson_ratio": 0.3}]
    locked = ["ux", "uy", "rx", "ry", "rz"]
    table["interface"] = {"section": section, "coupling": "rigid", "locked": locked}
    table["range"] = {"force": [1.0, 1.0, force], "moment": [1.0, 1.0, 1.0]}
    return bundle_of_table(table, folder)


PARTS = [(name, shipped_or_drawn) for name in ("bar", "plate", "bracket", "arm")]
PARTS += [(name, kind_of(make)) for name, make in kinds()]
PARTS += [("two cantilevers", lambda _, folder: read_bundle(two_cantilevers(folder)))]
PARTS += [(name, guided) for name in GUIDED]


def linear_and_nonlinear(bundle):
    """Return solvers of a part with a linear and with a nonlinear analysis."""
    solver = Solver(bundle)
    analyses = (
        replace(solver.component.analysis, nonlinear=nonlinear, on_yield="warn")
        for nonlinear in (False, True)
    )
    pair = []
    for analysis in analyses:
        other = copy(solver)
        other.component = replace(solver.component, analysis=analysis)
        pair.append(other)
    return pair


def wrenches_within(low, high):
    chance = np.random.default_rng(int(os.environ.get("SEED", "1")))
    largest = np.maximum(-low, high)
    single = np.vstack([scale * np.diag(largest) for scale in (0.3, 1.0)])
    corners = np.where(chance.choice([False, True], (6, len(low))), low, high)
    return {
        "single loads": single,
        "all loads": np.vstack([chance.uniform(low, high, (12, len(low))), corners]),
    }


def errors_at(linear, nonlinear, wrenches):
    """Return the wrenches that have a nonlinear answer, and its change of the linear one's."""
    answered, errors = [], []
    for wrench in wrenches:
        try:
            moved = nonlinear.solve(wrench).displacement
        except SolveFailed:
            continue
        answered.append(wrench)
        errors.append(np.abs(moved - linear.linear.compliance @ wrench))
    return np.array(answered), np.array(errors)


def ratios(told, wrenches, errors, smallest):
    """Return bar over error of the outputs whose error is not roundoff."""
    error = SolverError(told)
    bars = np.array([error.parts(wrench)["linearity"] for wrench in wrenches])
    return (bars / np.maximum(errors, 1e-300))[errors > smallest]


LAWS = {"with second derivatives": True, "with the square alone": False}


@pytest.mark.parametrize(("name", "make"), PARTS, ids=[name for name, _ in PARTS])
def test_it_holds_nine_of_ten_errors_of_each_part(name, make, tmp_path):
    bundle = make(name, tmp_path)
    linear, nonlinear = linear_and_nonlinear(bundle)
    corners = bundle.acting.corners()
    moved = (corners @ linear.compliance.T).reshape(-1, 2, 3)
    turned = np.linalg.norm(moved[:, 1], axis=1).max()
    scale = LARGEST_TURN / turned if turned > 0 else 1.0
    loads = DeclaredRange(scale * bundle.acting.low, scale * bundle.acting.high)
    largest = np.maximum(-loads.low, loads.high) * linear.compliance.any(axis=0)
    coarse = coarser(linear) or linear
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(Solver, "second_derivatives", None)
        told = {"with the square alone": linearity_of(linear, coarse, loads)}
    told["with second derivatives"] = linearity_of(linear, coarse, loads)
    smallest = 1e-6 * np.repeat(
        np.abs(corners @ linear.compliance.T * scale).max(axis=0).reshape(-1, 3).max(axis=1), 3
    )
    inside = {}
    for sort, wrenches in wrenches_within(loads.low, loads.high).items():
        answered, errors = errors_at(linear, nonlinear, wrenches)
        for law in LAWS:
            shape = {"mesh": None, "loads": largest.tolist(), **told[law]}
            ratio = ratios(shape, answered, errors, smallest)
            inside[law, sort] = np.mean(ratio >= 1)
            print(
                f"| {name} | {sort} | {law} | {ratio.size} | {100 * inside[law, sort]:.0f} % | "
                f"{np.median(ratio):.1f} |"
            )
    assert min(share for (law, _), share in inside.items() if LAWS[law]) >= 0.9
