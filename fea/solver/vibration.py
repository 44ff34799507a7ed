"""The mass matrix and the first natural frequency of a component, with a mass on its interface."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.sparse import coo_array, csr_array
from scipy.sparse.linalg import ArpackError, LinearOperator, eigsh

from wrenchbook.fea.assembly.linearisation import contract
from wrenchbook.fea.assembly.system import System
from wrenchbook.fea.coupling.coupling import PER_INTERFACE
from wrenchbook.fea.failure import SolveFailed
from wrenchbook.fea.mesh.mapping import jacobians
from wrenchbook.fea.mesh.mesh import Mesh
from wrenchbook.fea.mesh.reference_cell import reference_element
from wrenchbook.fea.tensors import determinant, skew

# Part of the largest moment of inertia: a rod's least moment is 0 but for roundoff.
_MOMENT_ROUNDOFF = 1e-9
# Part of the largest moment of inertia: a plate's largest is the sum of the others, but for the two
# digits to which moments are typed.
_TYPED_DIGITS = 0.01
_SEED = 20170726  # seed of the first mode's start vector: the same bundle gives the same digits


@dataclass(frozen=True, eq=False)
class Riding:
    """The rigid mass that stands on the interface.

    Raises ValueError if a number is not finite, the mass negative, or the inertia not symmetric,
    not positive, or with a moment above the sum of the other two.
    """

    mass: float  # kg, zero or more
    inertia: np.ndarray  # shape (3, 3), kg·m^2: about its centre of mass, in the interface frame
    # Shape (3,), m: its centre of mass from the interface point, in the interface frame
    centre: np.ndarray

    def __post_init__(self) -> None:
        for name in ("mass", "inertia", "centre"):
            values = np.ravel(getattr(self, name)).tolist()
            if not np.isfinite(values).all():
                raise ValueError(f"the {name} must have finite numbers only, not {values}")
        if self.mass < 0:
            raise ValueError(f"the mass must be 0 or more, not {self.mass:g} kg")
        if not np.array_equal(self.inertia, self.inertia.T):
            raise ValueError("the inertia must be symmetric; give its xx, yy, zz, xy, xz, yz")
        moments = np.linalg.eigvalsh(self.inertia)
        if moments[0] < -_MOMENT_ROUNDOFF * max(moments[2], 0.0):
            raise ValueError(
                f"the least principal moment of inertia is {moments[0]:.4g} kg·m^2, but none may "
                "be negative; in --inertia give positive xx,yy,zz and, if there are six, smaller "
                "xy, xz, yz"
            )
        if moments[2] * (1 - _TYPED_DIGITS) > moments[0] + moments[1]:
            low, middle, high = (f"{moment:.4g}" for moment in moments)
            raise ValueError(
                f"the largest principal moment of inertia, {high} kg·m^2, is above the sum of the "
                f"others, {low} and {middle} kg·m^2, which no body has; correct the inertia"
            )

    @classmethod
    def of(
        cls, mass: float = 0.0, inertia: np.ndarray | None = None, centre: np.ndarray | None = None
    ) -> Riding:
        """Return a rigid mass by three moments of inertia or six (xx, yy, zz, xy, xz, yz), kg·m^2.

        Raises ValueError for another number of moments or coordinates, or as the class does.
        """
        moments = np.zeros(3) if inertia is None else np.asarray(inertia, dtype=float)
        position = np.zeros(3) if centre is None else np.asarray(centre, dtype=float)
        if moments.shape not in ((3,), (6,)):
            raise ValueError(
                "the inertia must be xx, yy, zz or xx, yy, zz, xy, xz, yz, in kg·m^2, not "
                f"{moments.size} numbers"
            )
        if position.shape != (3,):
            raise ValueError(
                f"the centre of mass must be 3 numbers x,y,z in m, not {position.size} numbers"
            )
        tensor = np.diag(moments[:3])
        if len(moments) == 6:
            xy, xz, yz = moments[3:]
            tensor = tensor + np.array([[0, xy, xz], [xy, 0, yz], [xz, yz, 0]])
        return cls(float(mass), tensor, position)

    @property
    def matrix(self) -> np.ndarray:
        """The mass matrix about the interface point, shape (6, 6): kg, kg·m and kg·m^2."""
        arm = skew(self.centre)
        matrix = np.zeros((PER_INTERFACE, PER_INTERFACE))
        matrix[:3, :3] = self.mass * np.eye(3)
        matrix[:3, 3:] = -self.mass * arm
        matrix[3:, :3] = self.mass * arm
        matrix[3:, 3:] = self.inertia - self.mass * arm @ arm
        return matrix


@dataclass(frozen=True, eq=False)
class Vibration:
    """The first natural oscillation about the unloaded state."""

    mass: float  # mass of the component itself, kg
    frequency: float  # Hz
    interface: np.ndarray  # shape (6 i,): motion of the i interfaces, m and rad, of length one
    # Shape (6 i, 6 i): the component's mass as the interfaces' motion accelerates it, kg, kg·m and
    # kg·m^2; zero at locked freedoms.
    condensed: np.ndarray


def first_vibration(system: System, mass: csr_array, riding: Riding) -> Vibration:
    """Return the lowest eigenfrequency of K x = omega^2 M x, undamped, small motions.

    By Lanczos' method with K^-1 M (shift-invert at zero, ARPACK), K^-1 by the factorisation of the
    static solves. The frequency is Rayleigh's quotient of the mode, with the strain energy from the
    strains: its error is the square of the mode's.

    system: the equations, in the interface frame.
    mass: shape (n, n), kg, of `consistent_mass`; without entries the component is massless.
    riding: the rigid mass on the interface.

    Raises ValueError if nothing has a mass, everything with a mass is locked, or a mass rides on
    one of several interfaces. Raises SolveFailed of kind ``mechanism`` or ``ill_conditioned`` if
    the equations are singular.
    """
    active, count = system.coupling.active, system.coupling.n_freedoms
    interface_mass = np.zeros((count, count))
    if count == PER_INTERFACE:
        interface_mass[np.ix_(active, active)] = riding.matrix[np.ix_(active, active)]
    elif riding.matrix.any():
        raise ValueError("a mass cannot be put on one of several interfaces; leave the mass out")
    inertia = Inertia(system, mass, interface_mass)
    is_moved = 1.0 - system.body.slips  # nodes that a translation of the part moves
    mass_of_part = float(is_moved @ (mass @ is_moved))
    start = np.random.default_rng(_SEED).standard_normal(inertia.size)
    if mass.nnz and inertia.times(start).any():
        x = lowest_modes(inertia, inertia.solve, start, 1)[1][:, 0]
    else:
        x = _lowest_mode_of_massless(inertia)

    # Rayleigh's quotient, with the strain energy from the strains.
    fields, interface = inertia.fields(x)
    stiffness = system.body.strain_energy_products(fields[:, :, None])[0, 0]
    stiffness += system.coupling.spring_energies(inertia.border(x))[0, 0]
    square = stiffness / float(x @ inertia.times(x))
    frequency = float(np.sqrt(square) / (2 * np.pi))

    without_riding = Inertia(system, mass, np.zeros((count, count)))
    if length := float(np.linalg.norm(interface)):
        largest = interface[np.abs(interface).argmax()]  # made positive: a mode has no sign
        interface = interface / (length * np.sign(largest))
    return Vibration(mass_of_part, frequency, interface, condensed_mass(without_riding))


def lowest_modes(
    inertia: Inertia, inverse: Callable[[np.ndarray], np.ndarray], start: np.ndarray, count: int
) -> tuple[np.ndarray, np.ndarray]:
    """Return squares of frequencies (count,), (rad/s)^2, and modes (size, count), in any order.

    inverse: the inverse of the stiffness, loads (size,) to motions.
    start: shape (size,): a first motion for Lanczos' method.

    Raises SolveFailed of kind ``ill_conditioned`` if Lanczos' method does not converge.
    """
    mass = SymmetricOperator(inertia.size, inertia.times)
    apply = SymmetricOperator(inertia.size, inverse)
    try:
        # In shift-invert mode ARPACK applies only K^-1 and M; the first argument gives the size.
        squares, modes = eigsh(mass, k=count, M=mass, sigma=0.0, which="LM", OPinv=apply, v0=start)
    except ArpackError as error:
        raise SolveFailed(
            "ill_conditioned",
            f"Lanczos' method (ARPACK) does not find the {count} lowest vibration "
            f"mode{'s' * (count > 1)} of {inertia.size} freedoms.",
        ) from error
    return squares, modes


def _lowest_mode_of_massless(inertia: Inertia) -> np.ndarray:
    """Return the mode of a component without mass that carries a mass M, shape (size,).

    With the compliance C = L L^T of the interface, 1 / omega^2 is an eigenvalue of L^T M L.
    """
    carried = inertia.interface_mass[np.ix_(inertia.active, inertia.active)]
    if not carried.diagonal().max(initial=0.0) > 0:
        raise ValueError(
            "nothing that can move has a mass; give materials a density in kg/m^3, or the "
            "interface a mass along a freedom that is not locked"
        )
    moved, compliance = _motions_by_unit_loads(inertia)
    try:
        lower = np.linalg.cholesky(0.5 * (compliance + compliance.T))
    except np.linalg.LinAlgError as error:
        raise SolveFailed(
            "ill_conditioned",
            f"The compliance of the {len(compliance)} free freedoms of the interface is not "
            f"positive definite: its diagonal is {compliance.diagonal()} (m/N, then rad/(N·m)).",
        ) from error
    _, vectors = np.linalg.eigh(lower.T @ carried @ lower)
    return np.linalg.solve(compliance, lower @ vectors[:, -1]) @ moved.T


def condensed_mass(inertia: Inertia) -> np.ndarray:
    """Return the mass condensed to the interfaces' motion, shape (6 i, 6 i), kg to kg·m^2.

    Guyan (1965): the kinetic energy of the motions under static loads at the interfaces.
    """
    active = inertia.active
    count = len(inertia.interface_mass)
    matrix = np.zeros((count, count))
    if not active.size:
        return matrix
    shapes, _ = static_shapes(inertia)
    energies = shapes.T @ np.stack([inertia.times(shape) for shape in shapes.T], axis=1)
    matrix[np.ix_(active, active)] = 0.5 * (energies + energies.T)
    return matrix


def static_shapes(inertia: Inertia) -> tuple[np.ndarray, np.ndarray]:
    """Return the unknowns by unit motions of the k active interface freedoms, shape (size, k).

    The second result is the compliance of these freedoms, shape (k, k), m/N to rad/(N·m).
    """
    moved, compliance = _motions_by_unit_loads(inertia)
    return np.linalg.solve(compliance.T, moved.T).T, 0.5 * (compliance + compliance.T)


def _motions_by_unit_loads(inertia: Inertia) -> tuple[np.ndarray, np.ndarray]:
    """Return the unknowns by unit loads on the active freedoms, (size, k), and their rows of these.

    The rows are the compliance, (k, k), m/N to rad/(N·m), symmetric but for roundoff.
    """
    count = inertia.active.size
    loads = np.eye(count, inertia.size, k=inertia.first)
    moved = inertia.solve(loads).T
    return moved, moved[inertia.first : inertia.first + count]


class Inertia:
    """The mass matrix M over free nodes, active interface freedoms and anchors, and K^-1.

    mass: shape (n, n), kg: of the nodes, the same for the three components.
    interface_mass: shape (6 i, 6 i), kg to kg·m^2: mass that the interfaces carry.
    active: indices of the freedoms that are not locked; they begin at `first` among the `size`
    unknowns.
    """

    def __init__(self, system: System, mass: csr_array, interface_mass: np.ndarray) -> None:
        self._mass = mass
        self.interface_mass = interface_mass
        self._start = system.undeformed
        self.active = system.coupling.active
        self._free = np.flatnonzero(system.body.free)
        self._movable = system.body.movable
        self._n_nodes = system.body.size
        self._n_motions = system.coupling.n_motions
        self._constraint = self._start.border.constraint[:, :, : self._n_motions]
        self._n_multipliers = system.coupling.n_border - self._n_motions
        self.first = 3 * self._free.size
        self.size = self.first + self._n_motions

    def fields(self, x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the motion of all nodes (n, 3), m, and of the interfaces (6 i,), m and rad."""
        border = x[self.first :]
        nodes = self._constraint @ border
        moved = np.zeros_like(nodes)
        moved[self._free] = x[: self.first].reshape(-1, 3)
        nodes += self._movable.released(moved)
        interface = np.zeros(len(self.interface_mass))
        interface[self.active] = border[: self.active.size]
        return nodes, interface

    def border(self, x: np.ndarray) -> np.ndarray:
        """Return the motion of the whole border, shape (border, 1), with zero multipliers."""
        return np.append(x[self.first :], np.zeros(self._n_multipliers))[:, None]

    def times(self, x: np.ndarray) -> np.ndarray:
        """Return M x, shape (size,): kg times the units of `x`."""
        nodes, interface = self.fields(np.asarray(x).reshape(-1))
        forces = np.asarray(self._mass @ nodes)
        border = contract(self._constraint, forces[:, :, None])[:, 0]
        border[: self.active.size] += (self.interface_mass @ interface)[self.active]
        return np.concatenate([self._movable.released(forces)[self._free].ravel(), border])

    def solve(self, loads: np.ndarray) -> np.ndarray:
        """Return K^-1 times loads, shape (size,) or (k, size): N and N·m to m and rad."""
        columns = np.asarray(loads).reshape(-1, self.size).T
        nodal = np.zeros((self._n_nodes, 3, columns.shape[1]))
        nodal[self._free] = columns[: self.first].reshape(-1, 3, columns.shape[1])
        border = np.pad(columns[self.first :], ((0, self._n_multipliers), (0, 0)))
        nodes, moved = self._start.solve(nodal, border)
        inner = nodes[self._free].reshape(self.first, -1)
        return np.concatenate([inner, moved[: self._n_motions]]).T.reshape(np.shape(loads))


class SymmetricOperator(LinearOperator):
    """A symmetric linear map as the operator that SciPy's `eigsh` takes."""

    def __init__(self, size: int, apply: Callable[[np.ndarray], np.ndarray]) -> None:
        super().__init__(np.dtype(float), (size, size))
        self._apply = apply

    def _matvec(self, x: np.ndarray) -> np.ndarray:
        return self._apply(x)


def consistent_mass(mesh: Mesh, density: Sequence[np.ndarray]) -> csr_array:
    """Integrate density N_a N_b over all cells.

    It is the same for the three components of a displacement.

    mesh: the cells, in any frame.
    density: for each block of the mesh, shape (cells,), kg/m^3.
    Returns csr_array: shape (n, n), kg; the sum of its entries is the total mass.
    """
    count = len(mesh.points)
    total = csr_array((count, count))
    for block, densities in zip(mesh.blocks, density, strict=True):
        element = reference_element(block.kind, "mass")
        volumes = determinant(jacobians(mesh.points[block.nodes], element.slopes))
        weights = volumes * element.weights * densities[:, None]
        products = element.values[:, :, None] * element.values[:, None, :]
        of_cells = weights @ products.reshape(len(products), -1)
        total = total + assemble(block.nodes, of_cells, count)
    if mesh.dependents is not None:
        of_free = mesh.dependents.map
        total = of_free.T @ total @ of_free
    return csr_array(total)


def assemble(nodes: np.ndarray, matrices: np.ndarray, size: int) -> csr_array:
    """Return the sum of the matrices of cells, shape (size, size), in their unit.

    nodes: shape (cells, s). matrices: shape (cells, s, s), or any other with its entries.
    """
    count = nodes.shape[1]
    indices = np.repeat(nodes, count, axis=1).ravel(), np.tile(nodes, (1, count)).ravel()
    return csr_array(coo_array((matrices.ravel(), indices), shape=(size, size)))
