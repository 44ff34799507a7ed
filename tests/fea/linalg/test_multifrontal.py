"""The direct solver: nested substructures and dense fronts, against SciPy."""

import numpy as np
import pytest
import scipy.sparse as sparse
import scipy.sparse.linalg as sparse_linalg
from threadpoolctl import threadpool_info, threadpool_limits

from tests.fea import components
from tests.fea.boxes import box
from wrenchbook.fea.linalg.multifrontal import MultifrontalFactor
from wrenchbook.fea.linalg.nested_dissection import unknowns_of
from wrenchbook.fea.mesh.mesh import CellBlock, Mesh

RNG = np.random.default_rng(11)


def body_of(mesh, free, integration="reduced"):
    young = [np.linspace(1e9, 3e9, len(block)) for block in mesh.blocks]
    return components.body_of(mesh, free, young, integration=integration)


def matrix_of(body, tangent):
    """Assemble the usual sparse matrix of the free unknowns, in the order of elimination."""
    size = 3 * body.size
    total = sparse.csc_matrix((size, size))
    for nodes, matrices in zip(body.cells, tangent.matrices, strict=True):
        rows = np.moveaxis(unknowns_of(nodes), 2, 1).reshape(len(nodes), -1)
        width = rows.shape[1]
        entries = (np.repeat(rows, width, axis=1).ravel(), np.tile(rows, (1, width)).ravel())
        total += sparse.csc_matrix((matrices.ravel(), entries), shape=(size, size))
    order = unknowns_of(body.dissection.nodes).ravel()
    return total[order][:, order].tocsc()


def clamped(mesh):
    return mesh.points[:, 2] > 1e-9


@pytest.mark.parametrize("kind", ["hex20", "tet10", "hex8"])
def test_solutions_are_scipys(kind):
    mesh = box(kind, (5, 4, 6), (1.0, 0.7, 1.3))
    body = body_of(mesh, clamped(mesh))
    tangent = body.tangent(None)
    matrix = matrix_of(body, tangent)
    loads = RNG.standard_normal((matrix.shape[0], 3))
    expected = sparse_linalg.spsolve(matrix, loads)
    np.testing.assert_allclose(
        tangent.factor.solve(loads), expected, atol=1e-10 * np.abs(expected).max()
    )
    assert tangent.factor.definite
    assert tangent.factor.pivot_ratio > 1e-4


def test_every_free_node_is_eliminated_once():
    mesh = box("hex20", (7, 3, 2))
    free = clamped(mesh)
    tree = body_of(mesh, free).dissection
    np.testing.assert_array_equal(np.sort(tree.nodes), np.flatnonzero(free))
    assert sum(part.eliminated for part in tree.substructures) == tree.unknowns
    assert tree.substructures[-1].boundary.size == 0


def test_blocks_of_different_kinds_share_a_leaf():
    low, high = box("hex20", (2, 2, 2)), box("tet10", (2, 2, 2))
    points = np.concatenate([low.points, high.points + np.array([0, 0, 1])])
    unique, renumber = np.unique(np.round(points, 9), axis=0, return_inverse=True)
    blocks = (
        CellBlock("hex20", renumber[low.blocks[0].nodes]),
        CellBlock("tet10", renumber[high.blocks[0].nodes + len(low.points)]),
    )
    body = body_of(Mesh(unique, blocks), unique[:, 2] > 1e-9)
    tangent = body.tangent(None)
    matrix = matrix_of(body, tangent)
    loads = RNG.standard_normal((matrix.shape[0], 1))
    residual = matrix @ tangent.factor.solve(loads) - loads
    assert np.abs(residual).max() < 1e-10


def test_an_indefinite_tangent_is_still_solved_and_said_to_be_so():
    mesh = box("hex20", (3, 3, 4))
    body = body_of(mesh, clamped(mesh))
    squeezed = mesh.points * [0.0, 0.0, -0.4]
    tangent = body.tangent(squeezed)
    matrix = matrix_of(body, tangent)
    assert sparse_linalg.eigsh(matrix, k=1, which="SA", return_eigenvectors=False)[0] < 0
    loads = RNG.standard_normal((matrix.shape[0], 2))
    found = tangent.factor.solve(loads)
    assert not tangent.factor.definite
    roundoff = 1e-13 * np.abs(matrix).max() * np.abs(found).max()
    np.testing.assert_allclose(matrix @ found, loads, atol=roundoff)


def test_a_body_that_nothing_holds_leaves_no_pivot():
    mesh = box("hex20", (2, 2, 2))
    body = body_of(mesh, np.ones(len(mesh.points), dtype=bool))
    assert body.tangent(None).factor.pivot_ratio < 1e-13


def test_a_body_without_free_nodes_has_nothing_to_solve():
    mesh = box("hex8", (1, 1, 1))
    body = body_of(mesh, np.zeros(8, dtype=bool))
    assert body.dissection.unknowns == 0
    assert body.tangent(None).solve(np.ones((8, 3, 2))).max() == 0.0


def test_a_factorisation_runs_on_one_thread_and_leaves_the_callers_as_they_were():
    mesh = box("hex8", (2, 2, 2), (1.0, 1.0, 1.0))
    tangent = body_of(mesh, np.ones(len(mesh.points), dtype=bool)).tangent(None)
    seen = []

    def leaf(number):
        seen.append(blas_threads())
        return tangent._leaf(number)

    with threadpool_limits(2, "blas"):
        before = blas_threads()
        MultifrontalFactor(tangent._body.dissection, leaf)
        assert blas_threads() == before
    assert seen
    assert all(threads == [1] * len(threads) for threads in seen)


def blas_threads():
    """Threads of each BLAS that is loaded."""
    return [one["num_threads"] for one in threadpool_info() if one["user_api"] == "blas"]
