"""The entry point of fea: `solve` once, or a `Solver` for many wrenches of a component."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import replace
from functools import cached_property
from pathlib import Path

import numpy as np
from scipy.sparse import csr_array

from wrenchbook.fea.assembly.body import ElasticBody
from wrenchbook.fea.assembly.linearisation import Balance, Linearisation
from wrenchbook.fea.assembly.system import ROUNDOFF, System
from wrenchbook.fea.component import ComponentModel, build
from wrenchbook.fea.coupling import CoupledState
from wrenchbook.fea.coupling.coupling import each_interface, from_origin
from wrenchbook.fea.deck.solving import solve_deck
from wrenchbook.fea.element.pressure_projection import pressure_notes
from wrenchbook.fea.equations import material_of_parts, system_of
from wrenchbook.fea.export.failure_record import write_failure
from wrenchbook.fea.failure import SolveFailed
from wrenchbook.fea.inspection import coincidence_warnings, warnings_of
from wrenchbook.fea.mesh.bodies import bodies_of, coincident_nodes
from wrenchbook.fea.recovery.fields import SolveFields, fields_of
from wrenchbook.fea.recovery.stress import most_used, small_stress, stress_of, yielding
from wrenchbook.fea.solution import Iteration, Loads, Progress, Solution, checked_wrench
from wrenchbook.fea.solver.buckling import buckling_factors
from wrenchbook.fea.solver.linear import LinearResponse, linear_response
from wrenchbook.fea.solver.load_steps import LoadPath, equilibrium_at, equilibrium_under_weight
from wrenchbook.fea.solver.newton import Equilibrium
from wrenchbook.fea.solver.reduction import CraigBampton, craig_bampton
from wrenchbook.fea.solver.third_derivatives import (
    MAX_CURVATURE_INPUTS,
    packed,
    second_derivatives_at_rest,
    third_derivatives,
)
from wrenchbook.fea.solver.vibration import Riding, Vibration, consistent_mass, first_vibration
from wrenchbook.fea.spec.schema import FREEDOMS, Bundle

__all__ = ["MAX_DEGREES", "Solver", "solve"]

_MAX_ROUNDOFF_ERROR = 1e-6  # relative error of a solve without refinement; a larger one is a note

MAX_DEGREES = 20.0
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
        A bundle, the component built from it, or a solver of either.
    wrench
        As of `Solver.solve`.
    progress
        Called with the fraction done and a message.
    folder
        Folder that keeps an outside solver's files, and the files of a failed solve
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
            write_failure(folder, failure, component)
        raise
    if on_fields is not None:
        on_fields(solver.fields(solution))
    return solution


class Solver:
    """A component prepared once and solved for any number of wrenches.

    bundle: a bundle, or the component built from it.

    Raises BundleError if the bundle cannot be built, and SolveFailed of kind ``inverted_elements``
    or ``locking_material`` if its cells cannot be used.
    """

    def __init__(self, bundle: Bundle | ComponentModel) -> None:
        self.component = bundle if isinstance(bundle, ComponentModel) else build(bundle)
        self._system = system_of(self.component)

    def inputs(self, wrench: Loads) -> np.ndarray:
        """Return the inputs of `solve` as a new array, shape (k,).

        Raises ValueError as `solve` does.
        """
        names = tuple(interface.name for interface in self.component.interfaces)
        return checked_wrench(wrench, names, [scalar.name for scalar in self.component.further])

    @property
    def unknowns(self) -> int:
        """Degrees of freedom solved for."""
        return self._system.unknowns

    @property
    def body(self) -> ElasticBody:
        """The cells and their materials, in the first interface's frame."""
        return self._system.body

    @property
    def volumes(self) -> list[tuple[np.ndarray, np.ndarray]]:
        """For each block of cells their materials' indices and volumes, (cells,) each, m^3."""
        volumes = [part.gradients.weights.sum(axis=1) for part in self.body.parts]
        return list(zip(material_of_parts(self.component), volumes, strict=True))

    @cached_property
    def linear(self) -> LinearResponse:
        """The response to small loads, from one factorisation.

        Raises SolveFailed of kind ``mechanism`` or ``ill_conditioned`` if the equations are
        singular.
        """
        try:
            return linear_response(self._system)
        except SolveFailed as failure:
            raise self._of_bodies(failure) from None

    def _of_bodies(self, failure: SolveFailed) -> SolveFailed:
        """Return a mechanism of bodies that only touch with that cause, other failures as given."""
        mesh = self.component.uncut_mesh
        bodies = bodies_of(mesh)
        if failure.kind != "mechanism" or bodies.count == 1:
            return failure
        joints = self.component.bundle.joints
        touching = [*coincidence_warnings(mesh, bodies, coincident_nodes(mesh), joints)]
        if not touching:
            return failure
        remedy = (
            f"The mesh has {bodies.count} parts that share no face: {touching[0].message}, or join "
            "their faces by [[tie]]."
        )
        return SolveFailed(failure.kind, failure.message, remedy)

    @cached_property
    def second_derivatives(self) -> np.ndarray | None:
        """The second derivatives of nonlinear displacements at no load, shape (6 i, k, k), SI.

        None if there are more inputs than `MAX_CURVATURE_INPUTS`, or if weight or bolts move the
        part at no load.

        Raises SolveFailed as `linear` does.
        """
        if self.component.is_preloaded or self._system.n_inputs > MAX_CURVATURE_INPUTS:
            return None
        return second_derivatives_at_rest(self._system)

    @property
    def _tightening(self) -> System:
        """The equations while bolts are tightened: the preload is the weight, slips are free."""
        system, points = self._system, self.component.mesh.points
        return System(system.body.with_slips(), system.coupling, points, system.preload)

    @cached_property
    def tightened(self) -> LinearResponse | None:
        """The linear response while bolts are tightened, its `sag` by the preload; None without."""
        if self._system.preload is None:
            return None
        try:
            return linear_response(self._tightening)
        except SolveFailed as failure:
            message = f"While bolts are tightened: {failure.message}"
            raise SolveFailed(failure.kind, message, failure.remedy) from None

    @cached_property
    def unloaded_displacements(self) -> tuple[np.ndarray, np.ndarray]:
        """Linear displacements at no load, of interfaces (6 i,), m and rad, and nodes (n, 3), m.

        Those of nodes are from the mesh, before bolts are tightened.
        """
        linear, tight = self.linear, self.tightened
        if tight is None:
            return linear.sag_displacement, linear.sag
        counts = self.component.analysis.zero == "untightened"
        moved = linear.sag_displacement + counts * tight.sag_displacement
        return moved, linear.sag + tight.sag

    @cached_property
    def _tight(self) -> CoupledState | None:
        """The nonlinear state after bolts are tightened; None without bolts."""
        if self._system.preload is None:
            return None
        try:
            tight = equilibrium_under_weight(
                self._tightening,
                _check_rotation,
                cause="the preload of bolts",
                load="the preload",
                remedy="Reduce force under [[bolt]], or stiffen what the bolt clamps and its "
                "bearing surface.",
            )
        except SolveFailed as failure:
            if failure.last is None or failure.kind in ("mechanism", "ill_conditioned"):
                raise
            cuts = self.component.bolts
            part = failure.last[0]
            bolts = " and ".join(f"{cut.key}, {cut.bolt.force:.4g} N," for cut in cuts)
            reached = " and ".join(f"{part * cut.bolt.force:.3g} N" for cut in cuts)
            raise SolveFailed(
                failure.kind,
                f"The preload of {bolts} exceeds what the part can carry; the solve reached "
                f"{reached}. {failure.message}",
                failure.remedy,
            ) from None
        return tight.balance.state

    @cached_property
    def unloaded(self) -> Equilibrium:
        """The nonlinear equilibrium under self-weight and bolts.

        Raises SolveFailed as `solve` does.
        """
        self._system.undeformed.release()  # for `notes`, while no other factor is in memory
        if self._system.weight is None and self._tight is not None:
            return equilibrium_at(self._system, self._tight)
        return equilibrium_under_weight(self._system, _check_rotation, start=self._tight)

    @property
    def compliance(self) -> np.ndarray:
        """The compliance at no load, shape (6 i, 6 i), m/N, rad/N and so on; symmetric."""
        return self.linear.compliance[:, : self._system.coupling.n_freedoms]

    @cached_property
    def notes(self) -> tuple[str, ...]:
        """Notes for an engineer: the warnings of `fea.check`, and remarks on the method."""
        notes = tuple(
            f"{warning.where}: {warning.message}" for warning in warnings_of(self.component)
        )
        notes += pressure_notes(self.body.parts)
        lost = self._system.condition * ROUNDOFF
        if lost > _MAX_ROUNDOFF_ERROR:
            notes += (
                f"The scaled condition number is {self._system.condition:.0e}, so rounding would "
                f"leave a relative error of {lost:.0e}. The answer is corrected for that; nothing "
                "is to be done.",
            )
        return notes

    def vibration(self, riding: Riding) -> Vibration:
        """Return the first natural frequency with a rigid mass on the interface, unloaded.

        Materials without a density weigh nothing.

        Raises the errors of `first_vibration`.
        """
        return first_vibration(self._system, self._mass, riding)

    def craig_bampton(self, modes: int) -> CraigBampton:
        """Return the part's stiffness and mass for its frames and some modes, unloaded.

        The first frame is the held interface's, or else that of the supports, with the mesh's axes.

        Raises the errors of `fea.solver.reduction.craig_bampton`.
        """
        held = [("base", np.zeros(3), np.eye(3))]
        frames = []
        for interface in self.component.interfaces:
            frame = interface.name or "interface", interface.point, interface.axes
            if interface.locked == FREEDOMS:
                held = [frame]
            else:
                frames.append(frame)
        where = self.component.mesh.points, self.component.axes
        return craig_bampton(self._system, self._mass, *where, [*held, *frames], modes)

    @property
    def _mass(self) -> csr_array:
        densities = np.array([material.density or 0.0 for material in self.component.materials])
        density = [densities[numbers] for numbers in self.component.material_of_cells]
        mass = consistent_mass(self.component.mesh, density)
        mass.eliminate_zeros()
        return mass

    def unit_stresses(self) -> np.ndarray:
        """Return the small-strain stresses of unit inputs, shape (p, 6, k), Pa per unit.

        Raises SolveFailed as `linear` does.
        """
        return small_stress(self.body, self.linear.fields, self._system.coupling.n_freedoms)

    def stresses(self, solution: Solution) -> np.ndarray:
        """Return a solution's stresses at the integration points, shape (p, 6), Pa."""
        return stress_of(self.component, self.body, solution)

    def buckling(self, wrench: Loads) -> tuple[float, float]:
        """Return the multiples of a wrench, and of its opposite, at which the part buckles.

        The method is linear buckling (`fea.solver.buckling`). A factor is infinite if no multiple
        buckles the part. The wrench is as of `solve`.

        Raises ValueError and SolveFailed as `solve` and `linear` do.
        """
        acting = self.inputs(wrench) - self.component.reference_inputs
        fields = self.linear.fields @ acting
        return buckling_factors(self._system, fields, self._system.temperature(acting))

    def fields(self, solution: Solution) -> SolveFields:
        """Return the surface and the stresses of a solution of this component."""
        return fields_of(self.component, self.body, solution)

    def solve(
        self, wrench: Loads, progress: Progress | None = None, start: CoupledState | None = None
    ) -> Solution:
        """Solve for one wrench.

        Parameters
        ----------
        wrench
            Force and moment on the component at each interface's point, in its undeformed frame,
            shape (6 i,) for i interfaces, or six numbers by name, N and N·m. Loads on locked
            freedoms, and so on a held interface, have no effect. Further inputs of the component
            follow, or are given by their names: "temperature", then "ax", "ay" and "az".
        progress
            Called with the fraction done and a message.
        start
            `Solution.state` of a nearby wrench of the same component. It makes a nonlinear solve
            faster and changes nothing else: its result must pass the tests of a solve from no load,
            or else the solve starts again from no load.

        Raises
        ------
        ValueError
            If the wrench is not six finite numbers an interface, names an unknown interface, or
            lacks a further input.
        SolveFailed
            If there is no reliable answer; `kind` is the cause, `remedy` the change to make.
        """
        started = time.perf_counter()
        inputs = self.inputs(wrench)
        # Loads on locked freedoms have no effect; further inputs act relative to their references.
        acting = inputs - self.component.reference_inputs
        loads = np.arange(self._system.coupling.n_freedoms)
        acting[np.setdiff1d(loads, self.component.active)] = 0.0
        analysis = self.component.analysis
        if not analysis.nonlinear or not (acting.any() or self.component.is_preloaded):
            solution = self._solve_linear(inputs, acting)
        else:
            try:
                solution = self._solve_nonlinear(inputs, acting, progress, start)
            except SolveFailed as failure:
                raise self._of_bodies(failure) from None
        # If the loads alone exclude yielding, the answer's stresses are not needed.
        others = analysis.nonlinear or self.component.is_preloaded or self.body.expands
        if others or not np.abs(acting) @ self._most_used <= 1.0:
            exceeded = yielding(self.component, self.body, solution)
            if exceeded and analysis.on_yield == "fail":
                raise SolveFailed("yields", exceeded)
            if exceeded:
                solution = replace(solution, notes=(*solution.notes, exceeded))
        if progress is not None:
            progress(1.0, "done")
        return replace(solution, seconds=time.perf_counter() - started)

    @cached_property
    def _most_used(self) -> np.ndarray:
        return most_used(self.component, self.body, self.linear.fields)

    def _solve_linear(self, wrench: np.ndarray, acting: np.ndarray) -> Solution:
        """Return the linear answer of all inputs, (k,); `acting` are those with an effect."""
        linear, tight = self.linear, self.tightened
        displacement, nodes = linear.compliance @ acting, linear.fields @ acting
        after = nodes + linear.sag  # the state after bolts are tightened, with the self-weight
        inputs = acting if self._system.weight is None else np.append(acting, 1.0)
        energy = 0.5 * inputs @ linear.energies @ inputs
        work = acting[: len(displacement)] @ (displacement + linear.sag_displacement)
        work += np.vdot(self._system.dead_forces(acting), after)

        if tight is not None:
            # The mutual energy with the tightened state is the work of the preload on later
            # displacements.
            assert self._system.preload is not None
            mutual = np.vdot(self._system.preload, after)
            energy += 0.5 * tight.energies[-1, -1] + mutual
            work += tight.energies[-1, -1] + mutual
        if warming := self._system.temperature(acting):
            # It works on the change of the strain energy per kelvin; bolts are tight before it.
            rates, square = self._system.thermal_at_rest
            work += warming * np.vdot(rates, after) + 2 * warming**2 * square
            if tight is not None:
                mutual = warming * np.vdot(rates, tight.sag)
                energy += mutual
                work += 2 * mutual

        unloaded, unloaded_nodes = self.unloaded_displacements
        displacement, nodes = displacement + unloaded, nodes + unloaded_nodes
        _require_small_rotation(displacement)
        return Solution(
            wrench=wrench,
            displacement=displacement,
            compliance=linear.compliance,
            strain_energy=float(energy),
            work=0.5 * float(work),  # every load grows from zero to its full size
            unknowns=self.unknowns,
            seconds=0.0,
            history=(),
            nodes=nodes @ self.component.axes,
            notes=self.notes,
            tangents=self._linear_tangents,
            curvature=self._curvature(self._system.balance_at_rest, self._system.undeformed),
        )

    def _solve_nonlinear(
        self,
        wrench: np.ndarray,
        acting: np.ndarray,
        progress: Progress | None,
        start: CoupledState | None,
    ) -> Solution:
        """Return the nonlinear answer of all inputs, (k,); `acting` are those with an effect."""
        unloaded = self.unloaded if self.component.is_preloaded else None
        tight = self._tight
        if start is not None and tight is not None:
            # Bolts keep the length of this solver's state; another solver's differs by roundoff.
            nodes = start.nodes.copy()
            held = self.body.slips & ~self.body.free
            nodes[held] = tight.nodes[held]
            start = replace(start, nodes=nodes)
        if unloaded is not None and not acting.any():
            return self._solution(wrench, unloaded, unloaded.balance.energy, ())
        path = LoadPath(self._system, acting, progress, unloaded)
        largest = np.abs(acting).argmax()

        def check(balance: Balance) -> None:
            load_factor = float(balance.wrench[largest] / acting[largest])
            _require_small_rotation(balance.state.interface, load_factor)

        try:
            equilibrium = path.follow(check, start)
        except SolveFailed as failure:
            failure.history = tuple(path.history)
            factor, nodes = path.last_state()
            failure.last = factor, self.body.expanded(nodes) @ self.component.axes
            raise
        work = path.work
        if unloaded is not None:  # the start of the path: with the work of constant loads
            sunk = equilibrium.balance.state.nodes - unloaded.balance.state.nodes
            constant = self._system.dead_forces(np.zeros_like(acting))
            work += unloaded.balance.energy + float(np.vdot(constant, sunk))
        return self._solution(wrench, equilibrium, work, tuple(path.history))

    def _solution(
        self,
        wrench: np.ndarray,
        equilibrium: Equilibrium,
        work: float,
        history: tuple[Iteration, ...],
    ) -> Solution:
        """Return the answer from an equilibrium and the work of all loads on the path to it."""
        balance = equilibrium.balance
        displacement, compliance = balance.state.interface, equilibrium.tangent.compliance
        if self._origin is not None:
            displacement, rates = from_origin(displacement, self._origin)
            compliance = rates @ compliance
        return Solution(
            wrench=wrench,
            displacement=displacement,
            compliance=compliance,
            strain_energy=balance.energy,
            work=work + self._system.thermal_energy(balance),
            unknowns=self.unknowns,
            seconds=0.0,
            history=history,
            nodes=self.body.expanded(balance.state.nodes) @ self.component.axes,
            notes=self.notes,
            tangents=np.einsum(
                "ji,njk->nik",
                self.component.axes,
                self.body.expanded(equilibrium.tangent.nodal_response),
            ),
            curvature=self._curvature(balance, equilibrium.tangent),
            state=balance.state,
        )

    def _curvature(self, balance: Balance, tangent: Linearisation) -> np.ndarray | None:
        """Return the packed third derivatives at a state; None if linear, or of too many inputs."""
        if not self.component.analysis.nonlinear or self._system.n_inputs > MAX_CURVATURE_INPUTS:
            return None
        return packed(third_derivatives(self._system, balance, tangent, self._origin))

    @property
    def _origin(self) -> np.ndarray | None:
        """The interfaces' nonlinear displacement (6 i,), m and rad, that is the zero of answers."""
        preloaded = self.component.analysis.zero == "preloaded"
        return self._tight.interface if preloaded and self._tight is not None else None

    @cached_property
    def _linear_tangents(self) -> np.ndarray:
        return np.einsum("ji,njk->nik", self.component.axes, self.linear.fields)


def _check_rotation(balance: Balance) -> None:
    _require_small_rotation(balance.state.interface)


def _require_small_rotation(displacement: np.ndarray, load_factor: float = 1.0) -> None:
    """Raise SolveFailed if an interface turns by more than `MAX_DEGREES`.

    displacement: displacements of all interfaces, shape (6 i,), m and rad, under this part of the
    load.
    """
    degrees = np.degrees(np.linalg.norm(each_interface(displacement)[:, 3:], axis=1))
    largest = float(degrees.max())
    if not largest > MAX_DEGREES:
        return
    which = (
        f"Interface {degrees.argmax() + 1} of component.toml" if len(degrees) > 1 else "Interface"
    )
    under = f" under {load_factor:.3g} of this wrench already" if load_factor < 1.0 else ""
    raise SolveFailed(
        "rotation_too_large",
        f"{which} turns by {largest:.1f} degrees{under}; a table holds at most "
        f"{MAX_DEGREES:.0f} degrees.",
        "Lower the load range, or stiffen the part; wrenchbook is for small deformations only.",
    )
