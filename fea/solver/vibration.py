"""Eigenproblems of a component: first frequency, reduction to frames and modes, and buckling.

A rigid mass may ride on the interface. The frames of the reduced part (Craig and Bampton 1968) are
the base, which the supports or the held interface stand on, and the other interfaces; each has six
freedoms, a translation and a rotation vector in the mesh's axes. Unit motions of a frame while the
others stand still are the static shapes; to them come the lowest modes of the part with all frames
held, of unit mass each. The base's shapes are rigid motions of the part less what these move
of the interfaces, so that rigid motions cost no energy.

Linear buckling asks at how many times a load the straight part has a second equilibrium:
K x = -f G x with the stiffness K of the undeformed part and its stiffness G under the stresses of
that load, G_ia,kb = delta_ik integral of dN_a . sigma dN_b (Zienkiewicz and Taylor, volume 2,
section 11.6). The largest eigenvalues of K^-1 (-G) are 1/f; the same modes with the opposite sign
are those of the opposite load. They come of a subspace iteration (Bathe 1996, section 11.6), K^-1
by the factor that solves are made with. A rigid link's second-order motion is left out: exact
for an interface point in its section, not for a point on a long lever.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.linalg import block_diag, eigh
from scipy.sparse import coo_array, csr_array
from scipy.sparse.linalg import ArpackError, LinearOperator, eigsh

from wrenchbook.fea.assembly.body import ElasticBody, gather
from wrenchbook.fea.assembly.linearisation import contract
from wrenchbook.fea.assembly.system import System
from wrenchbook.fea.coupling.coupling import PER_INTERFACE
from wrenchbook.fea.failure import SolveFailed
from wrenchbook.fea.mesh.mesh import Mesh
from wrenchbook.fea.mesh.reference_cell import reference_element
from wrenchbook.fea.tensors import skew

Array = np.ndarray

# Part of the largest moment of inertia: a rod's least is 0 but for roundoff.
_MOMENT_ROUNDOFF = 1e-9
# Part of the largest moment of inertia: a plate's is the sum of the others but for typed digits.
_TYPED_DIGITS = 0.01
_SEED = 20170726  # seed of the first mode's start vector: the same bundle gives the same digits


@dataclass(frozen=True, eq=False)
class Riding:
    """The rigid mass that stands on the interface.

    Raises ValueError if a number is not finite, the mass negative, or the inertia not symmetric,
    not positive, or with a moment above the sum of the other two.
    """

    mass: float  # kg, zero or more
    inertia: Array  # shape (3, 3), kg·m^2: about its centre of mass, in the interface frame
    # Shape (3,), m: its centre of mass from the interface point, in the interface frame
    centre: Array

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
            least = f"the least principal moment of inertia is {moments[0]:.4g} kg·m^2"
            remedy = "give positive xx,yy,zz and, if there are six, smaller xy, xz, yz"
            raise ValueError(f"{least}, but none may be negative; in --inertia {remedy}")
        if moments[2] * (1 - _TYPED_DIGITS) > moments[0] + moments[1]:
            low, middle, high = (f"{moment:.4g}" for moment in moments)
            raise ValueError(
                f"the largest principal moment of inertia, {high} kg·m^2, is above the sum of the "
                f"others, {low} and {middle} kg·m^2, which no body has; correct the inertia"
            )

    @classmethod
    def of(
        cls, mass: float = 0.0, inertia: Array | None = None, centre: Array | None = None
    ) -> Riding:
        """Return a rigid mass with three principal moments or six (xx, yy, zz, xy, xz, yz), kg·m^2.

        Raises ValueError if the inertia has other than none, three or six moments, or as the class
        does.
        """
        moments = np.zeros(3) if inertia is None else np.asarray(inertia, dtype=float)
        position = np.zeros(3) if centre is None else np.asarray(centre, dtype=float)
        if moments.shape not in ((3,), (6,)):
            wanted = "xx, yy, zz or xx, yy, zz, xy, xz, yz, in kg·m^2"
            raise ValueError(f"the inertia must be {wanted}, not {moments.size} numbers")
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
    def matrix(self) -> Array:
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
    interface: Array  # shape (6 i,): motion of the i interfaces, m and rad, of length one
    # Shape (6 i, 6 i): the component's mass as the interfaces' motion accelerates it, kg, kg·m and
    # kg·m^2; zero at locked freedoms.
    condensed: Array


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
    active, count = system.coupling.active, system.coupling.freedoms
    interface_mass = np.zeros((count, count))
    if count == PER_INTERFACE:
        interface_mass[np.ix_(active, active)] = riding.matrix[np.ix_(active, active)]
    elif riding.matrix.any():
        raise ValueError("a mass cannot be put on one of several interfaces; leave the mass out")
    inertia = Inertia(system, mass, interface_mass)
    cells = 1.0 - system.body.slips
    mass_of_part = float(cells @ (mass @ cells))
    if mass.nnz:
        start = np.random.default_rng(_SEED).standard_normal(inertia.size)
        x = _lowest_modes(inertia, inertia.solved, start, 1)[1][:, 0]
    else:
        x = _lowest_mode_of_massless(inertia)

    # Rayleigh's quotient, with the strain energy from the strains.
    fields, interface = inertia.fields(x)
    stiffness = system.body.strain_energy_products(fields[:, :, None])[0, 0]
    stiffness += system.coupling.spring_energies(inertia.border(x))[0, 0]
    square = stiffness / float(x @ inertia.times(x))
    frequency = float(np.sqrt(square) / (2 * np.pi))

    without_riding = Inertia(system, mass, np.zeros((count, count)))
    if length := float(np.linalg.norm(interface)):  # length 1, its largest component positive
        interface = interface / (length * np.sign(interface[np.abs(interface).argmax()]))
    return Vibration(mass_of_part, frequency, interface, condensed_mass(without_riding))


def _lowest_modes(
    inertia: Inertia, inverse: Callable[[Array], Array], start: Array, count: int
) -> tuple[Array, Array]:
    """Return squares of frequencies (count,), (rad/s)^2, and modes (size, count), in any order.

    inverse: the inverse of the stiffness, loads (size,) to motions.
    start: shape (size,): a first motion for Lanczos' method.

    Raises SolveFailed of kind ``ill_conditioned`` if Lanczos' method does not converge.
    """
    mass = Applied(inertia.size, inertia.times)
    apply = Applied(inertia.size, inverse)
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


def _lowest_mode_of_massless(inertia: Inertia) -> Array:
    """Return the mode of a component without mass that carries a mass M, shape (size,).

    With the compliance C = L L^T of the interface, 1 / omega^2 is an eigenvalue of L^T M L.
    """
    active = inertia.active.size
    rows = slice(inertia.first, inertia.first + active)
    units = np.zeros((active, inertia.size))
    units[:, rows] = np.eye(active)
    moved = inertia.solved(units).T
    compliance = moved[rows]
    lower = np.linalg.cholesky(0.5 * (compliance + compliance.T))
    carried = inertia.interface_mass[np.ix_(inertia.active, inertia.active)]
    values, vectors = np.linalg.eigh(lower.T @ carried @ lower)
    if not values[-1] > 0:
        raise ValueError(
            "nothing that can move has a mass; give materials a density in kg/m^3, or the "
            "interface a mass along a freedom that is not locked"
        )
    return np.linalg.solve(compliance, lower @ vectors[:, -1]) @ moved.T


def condensed_mass(inertia: Inertia) -> Array:
    """Return the mass condensed to the interfaces' motion, shape (6 i, 6 i), kg to kg·m^2.

    Guyan (1965): the kinetic energy of the motions under static loads at the interfaces.
    """
    active = inertia.active
    count = len(inertia.interface_mass)
    shapes, _ = static_shapes(inertia)
    energies = shapes.T @ np.stack([inertia.times(shape) for shape in shapes.T], axis=1)
    matrix = np.zeros((count, count))
    matrix[np.ix_(active, active)] = 0.5 * (energies + energies.T)
    return matrix


def static_shapes(inertia: Inertia) -> tuple[Array, Array]:
    """Return the unknowns by unit motions of each active interface freedom, shape (size, k).

    The second result is the compliance of these freedoms, shape (k, k), m/N and so on.
    """
    rows = inertia.first + np.arange(inertia.active.size)
    units = np.zeros((rows.size, inertia.size))
    units[np.arange(rows.size), rows] = 1.0
    moved = inertia.solved(units).T
    compliance = 0.5 * (moved[rows] + moved[rows].T)
    return np.linalg.solve(moved[rows].T, moved.T).T, compliance


class Inertia:
    """The mass matrix M over free nodes, active interface freedoms and anchors, and K^-1.

    mass: shape (n, n), kg: of the nodes, the same for the three components.
    interface_mass: shape (6 i, 6 i), kg to kg·m^2: mass that the interfaces carry.
    active: indices of the freedoms that are not locked; they begin at `first` among the `size`
    unknowns.
    """

    def __init__(self, system: System, mass: csr_array, interface_mass: Array) -> None:
        self._mass = mass
        self.interface_mass = interface_mass
        self._start = system.undeformed
        self.active = system.coupling.active
        self._free = np.flatnonzero(system.body.free)
        self._movable = system.body.movable
        self._nodes = system.body.size
        self._motions = system.coupling.motions
        self._constraint = self._start.border.constraint[:, :, : self._motions]
        self._multipliers = system.coupling.border - self._motions
        self.first = 3 * self._free.size
        self.size = self.first + self._motions

    def fields(self, x: Array) -> tuple[Array, Array]:
        """Return all nodes' motion (n, 3), m, and the interfaces' (6 i,), m and rad."""
        border = x[self.first :]
        nodes = self._constraint @ border
        moved = np.zeros_like(nodes)
        moved[self._free] = x[: self.first].reshape(-1, 3)
        nodes += self._movable.released(moved)
        interface = np.zeros(len(self.interface_mass))
        interface[self.active] = border[: self.active.size]
        return nodes, interface

    def border(self, x: Array) -> Array:
        """Return the motion of the whole border, shape (border, 1); its multipliers are zero."""
        return np.append(x[self.first :], np.zeros(self._multipliers))[:, None]

    def times(self, x: Array) -> Array:
        """Multiply by the mass matrix: shape (size,) to (size,), kg times the unit given."""
        nodes, interface = self.fields(np.asarray(x).reshape(-1))
        forces = np.asarray(self._mass @ nodes)
        border = contract(self._constraint, forces[:, :, None])[:, 0]
        border[: self.active.size] += (self.interface_mass @ interface)[self.active]
        return np.concatenate([self._movable.released(forces)[self._free].ravel(), border])

    def solved(self, loads: Array) -> Array:
        """Return K^-1 times loads, shape (size,) or (k, size): N and N·m to m and rad."""
        columns = np.asarray(loads).reshape(-1, self.size).T
        nodal = np.zeros((self._nodes, 3, columns.shape[1]))
        nodal[self._free] = columns[: self.first].reshape(-1, 3, columns.shape[1])
        border = np.pad(columns[self.first :], ((0, self._multipliers), (0, 0)))
        nodes, moved = self._start.solve(nodal, border)
        inner = nodes[self._free].reshape(self.first, -1)
        return np.concatenate([inner, moved[: self._motions]]).T.reshape(np.shape(loads))


class Applied(LinearOperator):
    """A linear map in SciPy's form."""

    def __init__(self, size: int, apply: Callable[[Array], Array]) -> None:
        super().__init__(np.dtype(float), (size, size))
        self._apply = apply

    def _matvec(self, x: Array) -> Array:
        return self._apply(x)


def consistent_mass(mesh: Mesh, density: Sequence[Array]) -> csr_array:
    """Integrate density N_a N_b over all cells.

    It is the same for each of the three components of a displacement, so it stands once.

    mesh: the cells, in any frame.
    density: for each block of the mesh, shape (cells,), kg/m^3.
    Returns csr_array: shape (n, n), kg; the sum of its entries is the total mass.
    """
    count = len(mesh.points)
    total = csr_array((count, count))
    for block, densities in zip(mesh.blocks, density, strict=True):
        # The mass matrix of each cell, shape (cells, nodes, nodes), kg.
        element = reference_element(block.kind, "mass")
        jacobian = mesh.points[block.nodes].transpose(0, 2, 1)[:, None] @ element.slopes
        weights = np.linalg.det(jacobian) * element.weights * densities[:, None]
        products = element.values[:, :, None] * element.values[:, None, :]
        size = block.nodes.shape[1]
        entries = (weights @ products.reshape(len(products), -1)).reshape(len(block), size, size)
        rows = np.repeat(block.nodes, block.nodes.shape[1], axis=1)
        columns = np.tile(block.nodes, (1, block.nodes.shape[1]))
        indices = rows.ravel(), columns.ravel()
        total = total + coo_array((entries.ravel(), indices), shape=(count, count)).tocsr()
    if mesh.dependents is not None:
        follow = mesh.dependents.map
        total = follow.T @ total @ follow
    return csr_array(total)


_HELD_SEED = 19680701  # seed of the held modes' start vector: the same bundle gives the same digits


@dataclass(frozen=True, eq=False)
class CraigBampton:
    """Stiffness and mass of f frames and n modes."""

    names: tuple[str, ...]  # names of the frames; that of supports is "base"
    origins: Array  # shape (f, 3), m: origins of the undeformed frames, in the mesh's axes
    rotations: Array  # shape (f, 3, 3): the columns are a frame's axes in the mesh's
    # stiffness, mass: shape (6 f + n, 6 f + n): of six freedoms a frame along the mesh's axes, then
    # the modes; N/m, N, N·m and kg, kg·m, kg·m^2 for frames, (rad/s)^2 and 1 for modes, kg^0.5 and
    # kg^0.5·m between both.
    stiffness: Array
    mass: Array
    # held, free: Natural frequencies, Hz, ascending: with all frames held, shape (n,); and with
    # only the base held, by these matrices, shape (6 f - 6 + n,).
    held: Array
    free: Array


def craig_bampton(
    system: System,
    mass: csr_array,
    points: Array,
    body: Array,
    frames: Sequence[tuple[str, Array, Array]],
    modes: int,
) -> CraigBampton:
    """Return the part's matrices with a number of modes of the part with all frames held.

    mass: shape (n, n), kg: `consistent_mass`.
    points, body: shape (n, 3), m: the nodes in the mesh's axes; and (3, 3): the axes of the
    equations' fields in the mesh's, in rows.
    frames: name, point (3,), m, and axes of the base, and then of each interface that moves.

    Raises ValueError if freedoms are locked, nothing has a mass, or the part has fewer modes.
    Raises SolveFailed of kind ``mechanism`` or ``ill_conditioned`` if the equations are singular.
    """
    count = system.coupling.freedoms
    inertia = Inertia(system, mass, np.zeros((count, count)))
    (_, origin, _), *moving = frames
    freedoms = inertia.active.size
    if freedoms != PER_INTERFACE * len(moving):
        locked = f"{PER_INTERFACE * len(moving) - freedoms} freedoms are locked"
        raise ValueError(f"{locked}, but a condensed mass needs all six; leave locked out")
    if not mass.nnz:
        raise ValueError("no material has a density; write density, in kg/m^3, in [[material]]")
    if not 0 < modes < inertia.size - freedoms:
        raise ValueError(f"the modes must be 1 to {inertia.size - freedoms - 1}, not {modes}")
    shapes, compliance = static_shapes(inertia)
    squares, motions = _held_modes(inertia, shapes, modes)
    # Rigid motions of the interfaces by unit motions of the base, (6 i, 6), and the rotation from
    # the mesh's axes to those of the interfaces, (6 i, 6 i).
    rigid = np.concatenate(
        [np.vstack([_rigid((point - origin)[None])[0], np.eye(6)[3:]]) for _, point, _ in moving]
    )
    turn = np.asarray(block_diag(*(axes for _, _, axes in moving for _ in range(2))))

    # Fields of the base, the interfaces and the modes, each (n, 3, k).
    static = _nodal(inertia, shapes) @ turn
    rigid_fields = _rigid(points - origin) * ~system.body.slips[:, None, None]
    base = np.einsum("ij,njk->nik", body, rigid_fields) - static @ rigid
    fields = np.concatenate([base, static, _nodal(inertia, motions)], axis=2)
    products = sum(fields[:, axis].T @ (mass @ fields[:, axis]) for axis in range(3))
    reduced_mass = 0.5 * np.asarray(products + np.transpose(products))

    elastic = turn @ np.hstack([-rigid, np.eye(len(compliance))])  # relative to the base
    stiffness = _reduced_stiffness(compliance, elastic, squares)
    eigenvalues = eigh(stiffness[6:, 6:], reduced_mass[6:, 6:], eigvals_only=True)
    held, free = (np.sqrt(squared) / (2 * np.pi) for squared in (squares, eigenvalues))
    names, origins, axes = zip(*frames, strict=True)
    rotations = np.array(axes).swapaxes(1, 2)
    return CraigBampton(names, np.array(origins), rotations, stiffness, reduced_mass, held, free)


def _reduced_stiffness(compliance: Array, elastic: Array, squares: Array) -> Array:
    """Return the stiffness of f frames and n modes, shape (6 f + n, 6 f + n).

    compliance, elastic: of the interfaces, in their axes: shape (6 i, 6 i), and their motions
    relative to the base by unit motions of the frames, shape (6 i, 6 f).
    squares: shape (n,), (rad/s)^2: squares of the modes' frequencies.
    """
    frames = elastic.shape[1]
    stiffness = np.zeros((frames + len(squares),) * 2)
    stiffness[:frames, :frames] = elastic.T @ np.linalg.inv(compliance) @ elastic
    stiffness[frames:, frames:] = np.diag(squares)
    return 0.5 * (stiffness + stiffness.T)


def _held_modes(inertia: Inertia, shapes: Array, count: int) -> tuple[Array, Array]:
    """Return squares of frequencies (count,), (rad/s)^2, and motions of unit mass, (size, count).

    By Lanczos' method with the inverse of the stiffness while the interfaces are held: a solve,
    less the static shapes times the motions of the interfaces in it.
    """
    interface_rows = slice(inertia.first, inertia.first + inertia.active.size)

    def held(loads: Array) -> Array:
        moved = inertia.solved(loads)
        return moved - shapes @ moved[interface_rows]

    start = held(np.random.default_rng(_HELD_SEED).standard_normal(inertia.size))
    squares, motions = _lowest_modes(inertia, held, start, count)
    order = np.argsort(squares)
    return squares[order], motions[:, order]


def _nodal(inertia: Inertia, motions: Array) -> Array:
    """Return all nodes' motions, shape (n, 3, k), of unknowns (size, k)."""
    return np.stack([inertia.fields(motion)[0] for motion in motions.T], axis=2)


def _rigid(arms: Array) -> Array:
    """Return the motion of points at arms (n, 3), m, by a frame's unit motions: shape (n, 3, 6)."""
    translations = np.broadcast_to(np.eye(3), (len(arms), 3, 3))
    return np.concatenate([translations, -skew(arms)], axis=2)


# Number of modes of a subspace iteration, of both signs. The two extreme ones converge at the ratio
# of the ninth eigenvalue to theirs.
_MODES = 8
_ITERATIONS = 12  # largest number of iterations: a ratio of 0.5 leaves 2e-4 of the vectors' error
_CONVERGED = 1e-4  # relative change: two digits of a buckling factor are significant
# Part of the largest eigenvalue: motions that depend on the others but for roundoff.
_DEPENDENT = 1e-12
_BUCKLING_SEED = 20170726  # seed of the start vectors: the same bundle gives the same digits


def buckling_factors(
    system: System, fields: Array, temperature: float = 0.0
) -> tuple[float, float]:
    """Return the multiples of a load, and of its opposite, at which the part buckles.

    system: the equations, in the interface frame.
    fields: shape (n, 3), m: the small displacements under the load.
    temperature: K from the reference: a part of the load.
    Result: both positive; infinite if no multiple of the load buckles the part.
    """
    matrix = geometric_stiffness(system.body.at(temperature, finite=False), fields)
    if not matrix.count_nonzero():
        return np.inf, np.inf
    stressed = Inertia(system, -matrix, np.zeros((system.coupling.freedoms,) * 2))

    # Eigenvalues of K^-1 (-G), those of largest size among them.
    modes = min(_MODES, stressed.size)
    motions = np.random.default_rng(_BUCKLING_SEED).standard_normal((modes, stressed.size))
    before = np.zeros(2)
    values = np.zeros(modes)
    for _ in range(_ITERATIONS):
        loads = np.stack([stressed.times(motion) for motion in motions])
        moved = stressed.solved(loads)
        stiffness = moved @ loads.T
        geometric = moved @ np.stack([stressed.times(motion) for motion in moved]).T
        # The best eigenvalues in a space of motions, and those of K-length one.
        size, vectors_of = np.linalg.eigh(0.5 * (stiffness + stiffness.T))
        significant = size > _DEPENDENT * size.max(initial=0.0)
        basis = vectors_of[:, significant] / np.sqrt(size[significant])
        values, vectors = np.linalg.eigh(basis.T @ (0.5 * (geometric + geometric.T)) @ basis)
        motions = (basis @ vectors).T @ moved
        ends = np.array([values.min(), values.max()])
        if (np.abs(ends - before) <= _CONVERGED * np.abs(ends).max()).all():
            break
        before = ends
    return _factor(values.max()), _factor(-values.min())


def geometric_stiffness(body: ElasticBody, fields: Array) -> csr_array:
    """Return G for the stresses of a small displacement field (n, 3), m; shape (n, n), N/m."""
    rows, columns, entries = [], [], []
    for part, nodes in zip(body.parts, body.cells, strict=True):
        stress = part.small_stresses(gather(fields, nodes)[None])[0]
        slopes, weights = part.gradients.slopes, part.gradients.weights
        pulled = (weights[:, :, None, None] * stress) @ slopes
        cells, points, _, count = slopes.shape
        gradients = slopes.reshape(cells, 3 * points, count).swapaxes(1, 2)
        entries.append((gradients @ pulled.reshape(cells, 3 * points, count)).ravel())
        rows.append(np.repeat(nodes, count, axis=1).ravel())
        columns.append(np.tile(nodes, (1, count)).ravel())
    indices = np.concatenate(rows), np.concatenate(columns)
    return csr_array(coo_array((np.concatenate(entries), indices), (body.size, body.size)))


def _factor(value: float) -> float:
    """Return the buckling factor of an eigenvalue of K^-1 (-G); infinite if it is negative."""
    return 1.0 / float(value) if value > 0 else np.inf
