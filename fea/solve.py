"""Solve a component for wrenches: the front of this room."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import replace
from functools import cached_property
from pathlib import Path

import numpy as np
from scipy.sparse import csr_array

from wrenchbook.fea.assembly.body import ElasticBody
from wrenchbook.fea.assembly.condition import ROUNDOFF
from wrenchbook.fea.assembly.linearisation import Balance, Linearisation
from wrenchbook.fea.component import ComponentModel, build
from wrenchbook.fea.coupling import CoupledState
from wrenchbook.fea.coupling.coupling import largest_rotation
from wrenchbook.fea.deck.solving import solve_deck
from wrenchbook.fea.element.pressure_projection import pressure_notes
from wrenchbook.fea.equations import system_of
from wrenchbook.fea.export.failure_record import keep
from wrenchbook.fea.failure import SolveFailed, rotation_too_large, yields
from wrenchbook.fea.inspection.warnings import warnings_of
from wrenchbook.fea.recovery.fields import SolveFields, fields_of
from wrenchbook.fea.recovery.stress import small_stress, stress_of
from wrenchbook.fea.recovery.weight import material_of_parts
from wrenchbook.fea.recovery.yielding import most_used, yielding
from wrenchbook.fea.solution import Iteration, Loads, Progress, Solution, checked_wrench
from wrenchbook.fea.solver.buckling import buckling_factors
from wrenchbook.fea.solver.craig_bampton import CraigBampton, craig_bampton
from wrenchbook.fea.solver.linear import LinearResponse, linear_response
from wrenchbook.fea.solver.load_steps import LoadPath, hang
from wrenchbook.fea.solver.newton import Equilibrium
from wrenchbook.fea.solver.third_derivatives import MOST_INPUTS, packed, third_derivatives
from wrenchbook.fea.solver.vibration import Riding, Vibration, consistent_mass, first_vibration
from wrenchbook.fea.spec.schema import FREEDOMS, Bundle

__all__ = ["MOST_DEGREES", "Solver", "solve"]

Array = np.ndarray

_ROUNDOFF_WORTH_TELLING = 1e-6

MOST_DEGREES = 20.0
"""Rotation of the interface, degrees, beyond which an answer is refused."""


def solve(
    bundle: Bundle | ComponentModel | Solver,
    wrench: Loads,
    progress: Progress | None = None,
    folder: Path | None = None,
    on_fields: Callable[[SolveFields], None] | None = None,
) -> Solution:
    """Build a component's solver and solve once; see `Solver`, or `solve_deck` if it has a deck.

    Parameters
    ----------
    bundle
        A bundle, the component built from it, or the solver made ready for that.
    wrench
        As of `Solver.solve`.
    progress
        Called with the fraction done and a message.
    folder
        Where an outside solver's files stay, and what a failed solve leaves
        (`fea.export.failure_record`); None keeps nothing.
    on_fields
        Called with the solve's surface and stresses; a deck has none.

    Raises
    ------
    BundleError, SolveFailed
        As `Solver` does.
    """
    if isinstance(bundle, Bundle) and bundle.deck is not None:
        return solve_deck(bundle, checked_wrench(wrench), progress, folder, _require_small_rotation)
    ready = build(bundle) if isinstance(bundle, Bundle) else bundle
    component = ready.component if isinstance(ready, Solver) else ready
    try:
        solver = ready if isinstance(ready, Solver) else Solver(component)
        solution = solver.solve(solver.inputs(wrench), progress)
    except SolveFailed as failure:
        if folder is not None:
            keep(folder, failure, component)
        raise
    if on_fields is not None:
        on_fields(solver.fields(solution))
    return solution


class Solver:
    """A component made ready once, to be solved for any number of wrenches.

    Parameters
    ----------
    bundle
        A bundle, or the component built from it.

    Raises
    ------
    BundleError
        If the bundle cannot be built.
    SolveFailed
        ``inverted_elements`` or ``locking_material``.
    """

    def __init__(self, bundle: Bundle | ComponentModel) -> None:
        self.component = bundle if isinstance(bundle, ComponentModel) else build(bundle)
        self._active = self.component.active
        self._system = system_of(self.component, self._active)

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the interfaces; an empty one where there is one."""
        return tuple(one.name for one in self.component.interfaces)

    def inputs(self, wrench: Loads) -> Array:
        """Return the inputs of `solve` as an array of its own, shape (k,).

        Raises
        ------
        ValueError
            As `solve` does.
        """
        further = [one.name for one in self.component.further]
        return checked_wrench(wrench, self.names, further)

    @property
    def unknowns(self) -> int:
        """Degrees of freedom solved for."""
        return self._system.unknowns

    @property
    def body(self) -> ElasticBody:
        """The cells and their materials, in the first interface's frame."""
        return self._system.body

    @property
    def volumes(self) -> list[tuple[Array, Array]]:
        """For each sort of cells their materials' numbers and volumes, (cells,) each, m^3."""
        volumes = [part.gradients.weights.sum(axis=1) for part in self.body.parts]
        return list(zip(material_of_parts(self.component, self.body), volumes, strict=True))

    @cached_property
    def linear(self) -> LinearResponse:
        """The response to small loads, from one factorisation.

        Raises
        ------
        SolveFailed
            ``mechanism`` or ``ill_conditioned``.
        """
        return linear_response(self._system)

    @cached_property
    def rest(self) -> Equilibrium:
        """The nonlinear equilibrium under own weight alone; raises SolveFailed as `solve` does."""
        self._system.undeformed.release()  # for `notes`, while no other factor is in memory
        return hang(self._system, lambda balance: _require_small_rotation(balance.state.interface))

    @property
    def compliance(self) -> Array:
        """The compliance at no load, shape (6 i, 6 i), m/N, rad/N and so on; symmetric."""
        return self.linear.compliance[:, : self._system.coupling.freedoms]

    @cached_property
    def notes(self) -> tuple[str, ...]:
        """What an engineer should know: the warnings of `fea.check`, and how it is solved."""
        notes = tuple(f"{one.where}: {one.message}" for one in warnings_of(self.component))
        notes += pressure_notes(self._system.body.parts)
        lost = self._system.condition * ROUNDOFF
        if lost > _ROUNDOFF_WORTH_TELLING:
            notes += (
                f"Scaled condition about {self._system.condition:.0e}: a single solution of the "
                f"equations would be right to {lost:.0e}; it was corrected from its stresses.",
            )
        return notes

    def vibration(self, riding: Riding) -> Vibration:
        """Return the first natural frequency with a rigid mass on the interface, unloaded.

        Materials without a density weigh nothing.

        Raises
        ------
        ValueError, SolveFailed
            As `fea.solver.vibration.first_vibration` does.
        """
        return first_vibration(self._system, self._mass, riding)

    def craig_bampton(self, modes: int) -> CraigBampton:
        """Return the part's stiffness and mass, of its frames and some modes, unloaded.

        The first frame is the held interface's, or else the mesh's own, for the supports.

        Raises
        ------
        ValueError, SolveFailed
            As `fea.solver.craig_bampton.craig_bampton` does.
        """
        held, frames = [("base", np.zeros(3), np.eye(3))], []
        for one in self.component.interfaces:
            frame = one.name or "interface", one.point, one.axes
            if one.locked == FREEDOMS:
                held = [frame]
            else:
                frames.append(frame)
        where = self.component.mesh.points, self.component.axes
        return craig_bampton(self._system, self._mass, *where, [*held, *frames], modes)

    @property
    def _mass(self) -> csr_array:
        densities = np.array([one.density or 0.0 for one in self.component.materials])
        density = [densities[numbers] for numbers in self.component.material_of_cells]
        mass = consistent_mass(self.component.mesh, density)
        mass.eliminate_zeros()
        return mass

    def unit_stresses(self) -> Array:
        """Return the small-strain stresses of unit inputs, shape (p, 6, k), Pa per unit.

        Raises
        ------
        SolveFailed
            As `linear` does.
        """
        return small_stress(self.body, self.linear.fields, self._system.coupling.freedoms)

    def stresses(self, solution: Solution) -> Array:
        """Return a solution's stresses at the integration points, shape (p, 6), Pa."""
        return stress_of(self.component, self._system.body, solution)

    def buckling(self, wrench: Loads) -> tuple[float, float]:
        """Return how many times a wrench, and its opposite, the part carries before it buckles.

        The wrench is as of `solve`. As linear buckling has it (`fea.solver.buckling`);
        infinite where it does not.

        Raises
        ------
        ValueError, SolveFailed
            As `solve` and `linear` do.
        """
        acting = self.inputs(wrench) - self.component.at_rest
        fields = self.linear.fields @ acting
        return buckling_factors(self._system, fields, self._system.temperature(acting))

    def fields(self, solution: Solution) -> SolveFields:
        """Return the surface and the stresses of a solution of this component."""
        return fields_of(self.component, self._system.body, solution)

    def solve(
        self,
        wrench: Loads,
        progress: Progress | None = None,
        start: CoupledState | None = None,
    ) -> Solution:
        """Solve for one wrench.

        Parameters
        ----------
        wrench
            Force and moment on the component at each interface's point, in its undeformed frame,
            shape (6 i,) for i interfaces, or six numbers by name, N and N·m. What acts on locked
            freedoms, and so on an interface that is held, does nothing. Further inputs of the
            component follow, or come by their names: "temperature", then "ax", "ay" and "az".
        progress
            Called with the fraction done and a message.
        start
            `Solution.state` of a nearby wrench of the same component. It makes a nonlinear solve
            faster and changes nothing else: what it leads to must pass the tests of a solve from
            no load, and if it does not the solve starts from there.

        Raises
        ------
        ValueError
            If the wrench is not six finite numbers an interface, names an unknown one, or lacks
            a further input.
        SolveFailed
            If there is no answer that can be trusted; its `kind` says why, its `remedy` what to do.
        """
        started = time.perf_counter()
        whole = self.inputs(wrench)
        above, further = whole - self.component.at_rest, self._system.coupling.freedoms
        acting = np.zeros_like(whole)
        acting[self._active], acting[further:] = whole[self._active], above[further:]
        analysis = self.component.analysis
        if not analysis.nonlinear or not (acting.any() or analysis.gravity):
            found = self._solve_linear(whole, acting)
        else:
            found = self._solve_nonlinear(whole, acting, progress, start)
        if not self._stays_elastic(acting):
            words = yielding(self.component, self._system.body, found)
            if words and self.component.analysis.on_yield == "fail":
                raise yields(words)
            found = replace(found, notes=(*found.notes, words)) if words else found
        if progress is not None:
            progress(1.0, "done")
        return replace(found, seconds=time.perf_counter() - started)

    def _stays_elastic(self, acting: Array) -> bool:
        """Tell by the loads alone whether nothing yields, without the stresses of an answer."""
        if (
            self.component.analysis.nonlinear
            or self._system.weight is not None
            or self.body.expands
        ):
            return False
        return bool(np.abs(acting) @ self._most_used <= 1.0)

    @cached_property
    def _most_used(self) -> Array:
        return most_used(self.component, self.body, self.linear.fields)

    def _solve_linear(self, wrench: Array, acting: Array) -> Solution:
        linear = self.linear
        displacement, nodes = linear.compliance @ acting, linear.fields @ acting
        whole = acting
        if self._system.weight is not None:
            displacement, nodes = displacement + linear.sag_displacement, nodes + linear.sag
            whole = np.append(acting, 1.0)
        energy = 0.5 * whole @ linear.energies @ whole
        work = acting[: len(displacement)] @ displacement
        work += np.vdot(self._system.dead_forces(acting), nodes)
        _require_small_rotation(displacement)
        return Solution(
            wrench=wrench,
            displacement=displacement,
            compliance=linear.compliance,
            strain_energy=float(energy),
            work=float(work),
            unknowns=self.unknowns,
            seconds=0.0,
            history=(),
            nodes=nodes @ self.component.axes,
            notes=self.notes,
            tangents=self._linear_tangents,
            curvature=self._curvature(self._system.balance_at_rest, self._system.undeformed),
        )

    def _solve_nonlinear(
        self, wrench: Array, acting: Array, progress: Progress | None, start: CoupledState | None
    ) -> Solution:
        weight = self._system.weight
        rest = None if weight is None else self.rest
        if rest is not None and not acting.any():
            return self._solution(wrench, rest, rest.balance.energy, ())
        path = LoadPath(self._system, acting, progress, rest)
        try:
            found = path.follow(lambda balance: _require_small_state(balance, acting), start)
        except SolveFailed as failure:
            failure.history = tuple(path.history)
            factor, nodes = path.last_state()
            failure.last = factor, nodes @ self.component.axes
            raise
        work = path.work
        if weight is not None and rest is not None:
            sunk = found.balance.state.nodes - rest.balance.state.nodes
            work += rest.balance.energy + float(np.vdot(weight, sunk))
        return self._solution(wrench, found, work, tuple(path.history))

    def _solution(
        self, wrench: Array, found: Equilibrium, work: float, history: tuple[Iteration, ...]
    ) -> Solution:
        balance = found.balance
        return Solution(
            wrench=wrench,
            displacement=balance.state.interface,
            compliance=found.tangent.compliance,
            strain_energy=balance.energy,
            work=work + self._system.heat_energy(balance),
            unknowns=self.unknowns,
            seconds=0.0,
            history=history,
            nodes=balance.state.nodes @ self.component.axes,
            notes=self.notes,
            tangents=self._in_mesh_axes(found.tangent.nodal_response),
            curvature=self._curvature(balance, found.tangent),
            state=balance.state,
        )

    def _curvature(self, balance: Balance, tangent: Linearisation) -> Array | None:
        if not self.component.analysis.nonlinear or self._system.inputs > MOST_INPUTS:
            return None
        return packed(third_derivatives(self._system, balance, tangent))

    @cached_property
    def _linear_tangents(self) -> Array:
        return self._in_mesh_axes(self.linear.fields)

    def _in_mesh_axes(self, fields: Array) -> Array:
        return np.einsum("ji,njk->nik", self.component.axes, fields)


def _require_small_rotation(displacement: Array, load_factor: float = 1.0) -> None:
    degrees = float(np.degrees(largest_rotation(displacement)))
    if degrees > MOST_DEGREES:
        raise rotation_too_large(degrees, MOST_DEGREES, load_factor)


def _require_small_state(balance: Balance, wrench: Array) -> None:
    largest = np.abs(wrench).argmax()
    _require_small_rotation(
        balance.state.interface, float(balance.wrench[largest] / wrench[largest])
    )
