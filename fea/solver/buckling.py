"""Linear buckling: at how many times a load the straight part has a second equilibrium.

K x = -f G x with the stiffness K of the undeformed part and its stiffness G under the stresses of
that load, G_ia,kb = delta_ik integral of dN_a . sigma dN_b (Zienkiewicz and Taylor, volume 2,
section 11.6). The largest eigenvalues of K^-1 (-G) are 1/f; the same modes with the opposite sign
are those of the opposite load. They come of a subspace iteration (Bathe 1996, section 11.6), K^-1
by the factor that solves are made with. A rigid link's second-order motion is left out: exact
for an interface point in its section, not for a point on a long lever.
"""

from __future__ import annotations

import numpy as np
from scipy.sparse import csr_array

from wrenchbook.fea.assembly.body import ElasticBody, gather
from wrenchbook.fea.assembly.system import System
from wrenchbook.fea.solver.vibration import Inertia, assemble

# Number of modes of a subspace iteration, of both signs. The two extreme modes converge at the
# ratio of the ninth eigenvalue to theirs.
_MODES = 8
_ITERATIONS = 12  # largest number of iterations: a ratio of 0.5 leaves 2e-4 of the vectors' error
_CONVERGED = 1e-4  # relative change: two digits of a buckling factor are significant
# Part of the largest eigenvalue: motions that depend on the others but for roundoff.
_DEPENDENT = 1e-12
_BUCKLING_SEED = 20170726  # seed of the start vectors: the same bundle gives the same digits


def buckling_factors(system: System, fields: np.ndarray, temperature: float) -> tuple[float, float]:
    """Return the multiples of a load, and of its opposite, at which the part buckles.

    system: the equations, in the interface frame.
    fields: shape (n, 3), m: the small displacements under the load.
    temperature: K from the reference: a part of the load.
    Result: both positive; infinite if no multiple of the load buckles the part.
    """
    matrix = geometric_stiffness(system.body.at(temperature, finite=False), fields)
    if not matrix.count_nonzero():
        return np.inf, np.inf
    stressed = Inertia(system, -matrix, np.zeros((system.coupling.n_freedoms,) * 2))

    modes = min(_MODES, stressed.size)
    motions = np.random.default_rng(_BUCKLING_SEED).standard_normal((modes, stressed.size))
    extremes = np.zeros(2)  # smallest and largest eigenvalue of K^-1 (-G)
    for _ in range(_ITERATIONS):
        loads = np.stack([stressed.times(motion) for motion in motions])
        moved = stressed.solve(loads)
        stiffness = moved @ loads.T
        geometric = moved @ np.stack([stressed.times(motion) for motion in moved]).T
        # The best eigenvalues in the space of these motions, by a basis with x' K x = 1.
        energies, axes = np.linalg.eigh(0.5 * (stiffness + stiffness.T))
        significant = energies > _DEPENDENT * energies.max(initial=0.0)
        basis = axes[:, significant] / np.sqrt(energies[significant])
        values, vectors = np.linalg.eigh(basis.T @ (0.5 * (geometric + geometric.T)) @ basis)
        motions = (basis @ vectors).T @ moved
        before, extremes = extremes, values[[0, -1]]
        if (np.abs(extremes - before) <= _CONVERGED * np.abs(extremes).max()).all():
            break
    return _factor(extremes[1]), _factor(-extremes[0])


def geometric_stiffness(body: ElasticBody, fields: np.ndarray) -> csr_array:
    """Return G for the stresses of a small displacement field (n, 3), m; shape (n, n), N/m."""
    total = csr_array((body.size, body.size))
    for part, nodes in zip(body.parts, body.cells, strict=True):
        stress = part.small_stresses(gather(fields, nodes)[None])[0]
        slopes, weights = part.gradients.slopes, part.gradients.weights
        pulled = (weights[:, :, None, None] * stress) @ slopes
        cells, points, _, count = slopes.shape
        gradients = slopes.reshape(cells, 3 * points, count).swapaxes(1, 2)
        matrices = gradients @ pulled.reshape(cells, 3 * points, count)
        total = total + assemble(nodes, matrices, body.size)
    return total


def _factor(value: float) -> float:
    """Return the buckling factor of an eigenvalue of K^-1 (-G); infinite if it is negative."""
    return 1.0 / float(value) if value > 0 else np.inf
