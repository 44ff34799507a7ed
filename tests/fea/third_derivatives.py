"""Third derivatives of the complementary energy against differences of tangents, for tests."""

from __future__ import annotations

from itertools import combinations_with_replacement, pairwise, permutations

import numpy as np

from wrenchbook.fea.element.cell_state import CellState
from wrenchbook.fea.solver.third_derivatives import load_rates, third_derivatives


def state_of(solver, inputs, start=None):
    """Return the state under inputs, shape (k,): a `Balance`, and the tangent proper there."""
    result = solver.solve(inputs, start=start)
    above = inputs - solver.component.reference_inputs
    balance = solver._system.balance(result.state, _acting(solver, above))
    return balance, solver._system.linearise(balance)


def _acting(solver, inputs):
    """Return inputs, or changes of them, without the loads of locked freedoms."""
    first = solver._system.coupling.n_freedoms
    locked = np.setdiff1d(np.arange(first), solver.component.active)
    acting = inputs.copy()
    acting[locked] = 0.0
    return acting


def per_load(solver, balance, tangent):
    """Return d(u, r)/d(F, mu), further inputs behind them, shape (6 i, k); zero where locked."""
    return tangent.compliance @ np.linalg.inv(rates_of(solver, balance, tangent))


def rates_of(solver, balance, tangent):
    """Return `load_rates` at a state, shape (k, k)."""
    return load_rates(solver._system.coupling, balance, tangent.compliance)


def strain_part(solver, balance, tangent):
    """Return the part of the tensor that strains make, (a, a, a), and the a active inputs."""
    coupling, inputs = solver._system.coupling, balance.wrench
    active = np.append(coupling.active, np.arange(coupling.n_freedoms, len(inputs)))
    rates = rates_of(solver, balance, tangent)[np.ix_(active, active)]
    fields = tangent.nodal_response[:, :, active] @ np.linalg.inv(rates)
    body = solver._system.body.at(solver._system.temperature(inputs))
    return body.derivatives(CellState.third, balance.state.nodes, fields), active


def asymmetry(solver, inputs):
    """Return how far d(u, r)/d(F, mu) is from symmetric, relative to sqrt(C_ii C_jj)."""
    active = solver.component.active
    own = per_load(solver, *state_of(solver, inputs))[np.ix_(active, active)]
    size = np.sqrt(np.diagonal(own))
    return np.abs((own - own.T) / np.outer(size, size)).max()


def error(solver, inputs, direction, scale, step, doublings=2, repeats=1):
    """Return the tensor's largest error along a direction, relative to its largest entry.

    Reference: central differences of tangents, each in its own (F, mu), from steps of 1, 2, 4 and
    so on times `step` times the direction, three in a row extrapolated twice (Romberg); of several
    threes the one that the last extrapolation changes least. Entries are scaled by the load range,
    `scale`, and by the largest translation or rotation that an input at full range makes.
    """
    balance, tangent = state_of(solver, inputs)
    own = per_load(solver, balance, tangent)
    rate = rates_of(solver, balance, tangent) @ _acting(solver, direction)

    def mean(inputs):
        near = inputs + 1e-7 * scale * np.arange(repeats)[:, None]
        return np.mean(
            [per_load(solver, *state_of(solver, item, balance.state)) for item in near], axis=0
        )

    def difference(h):
        return (mean(inputs + h * direction) - mean(inputs - h * direction)) / (2 * h)

    raw = [difference(2**times * step) for times in range(doublings + 1)]
    once = [fine + (fine - coarse) / 3 for fine, coarse in pairwise(raw)]
    twice = [(fine - coarse) / 15 for fine, coarse in pairwise(once)]
    sizes = np.abs(own * scale).max(axis=1).reshape(-1, 3).max(axis=1)
    sizes = np.repeat(np.where(sizes > 0, sizes, 1.0), 3)[:, None]
    best = np.argmin([np.abs(change * scale / sizes).max() for change in twice])
    truth = once[best] + twice[best]
    tensor = third_derivatives(solver._system, balance, tangent)[: len(own)]
    largest = np.abs(tensor * scale[:, None] * scale / sizes[:, :, None]).max()
    missed = np.abs(tensor @ rate - truth) * scale / sizes
    return missed.max() / largest


def unpacked(row):
    """Return the symmetric tensor (k, k, k) of a row of its entries a <= b <= c."""
    count = next(k for k in range(99) if k * (k + 1) * (k + 2) // 6 == len(row))
    tensor = np.empty((count,) * 3)
    for number, places in zip(row, combinations_with_replacement(range(count), 3), strict=True):
        for permutation in permutations(places):
            tensor[permutation] = number
    return tensor


def range_of(solver):
    """Return the half widths of the declared ranges, shape (k,); 1 for an input without one."""
    loads = solver.component.bundle.acting
    half = 0.5 * (loads.high - loads.low)
    return np.where(half > 0, half, 1.0)
