"""The direct solver: nested substructures and dense fronts, against SciPy."""

from dataclasses import replace

import numpy as np
import pytest
import scipy.sparse as sparse
import scipy.sparse.linalg as sparse_linalg
from threadpoolctl import threadpool_info, threadpool_limits

from tests.fea import components
from tests.fea.boxes import box
from tests.fea.components import component
from wrenchbook.fea.failure import SolveFailed
from wrenchbook.fea.linalg.multifrontal import MultifrontalFactor
from wrenchbook.fea.linalg.nested_dissection import unknowns_of
from wrenchbook.fea.mesh.mesh import CellBlock, Mesh
from wrenchbook.fea.solve import Solver
from wrenchbook.fea.spec.material import Material

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
    result = tangent.factor.solve(loads)
    assert not tangent.factor.definite
    roundoff = 1e-13 * np.abs(matrix).max() * np.abs(result).max()
    np.testing.assert_allclose(matrix @ result, loads, atol=roundoff)


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
        return tangent._leaf_matrix(number)

    with threadpool_limits(2, "blas"):
        before = blas_threads()
        MultifrontalFactor(tangent._body.dissection, leaf)
        assert blas_threads() == before
    assert seen
    assert all(threads == [1] * len(threads) for threads in seen)


def blas_threads():
    """Threads of each BLAS that is loaded."""
    return [item["num_threads"] for item in threadpool_info() if item["user_api"] == "blas"]


@pytest.mark.parametrize("thickness", [1.0, 0.1, 0.01])
def test_the_condition_is_estimated_within_a_factor_of_ten(thickness):
    part = component(box("hex20", (4, 2, 2), (1.0, 1.0, thickness)), fixed="x0", section="x1")
    system = Solver(part)._system
    matrix = matrix_of(system.body, system.undeformed.tangent).toarray()
    scale = 1.0 / np.sqrt(np.diagonal(matrix))
    exact = np.linalg.cond(matrix * scale[:, None] * scale, 1)
    assert 0.3 * exact < system.condition < 10 * exact


def test_no_estimate_depends_on_units_or_stiffness():
    conditions = [
        Solver(component(box("hex20", (3, 2, 2), (s, s, s)), young=young))._system.condition
        for s, young in ((1.0, 210e9), (1e-3, 1e6))
    ]
    assert conditions[0] == pytest.approx(conditions[1], rel=1e-6)


def thin(ratio, **options):
    mesh = box("hex20", (10, 10, 2), (1.0, 1.0, 1.0 / ratio))
    options = {"fixed": "x0", "section": "x1", "coupling": "distributed", **options}
    return component(mesh, **options)


def test_a_thin_plate_is_corrected_and_says_so():
    solution = Solver(thin(1000)).solve([0, 0, 1e-6, 0, 0, 0])
    shape, condition = solution.notes
    assert "long and thin" in shape
    assert "scaled condition number is 6e+14" in condition
    assert Solver(thin(10)).solve([0, 0, 1, 0, 0, 0]).notes == ()
    assert Solver(thin(1000, nonlinear=True)).solve([0, 0, 1e-6, 0, 0, 0]).notes == solution.notes


@pytest.mark.parametrize("nonlinear", [False, True])
@pytest.mark.parametrize("coupling", ["rigid", "distributed"])
def test_a_foil_beyond_all_digits_is_ill_conditioned_and_no_mechanism(coupling, nonlinear):
    part = thin(1e5, coupling=coupling, nonlinear=nonlinear)
    with pytest.raises(SolveFailed) as caught:
        Solver(part).solve([0, 0, 1e-9, 0, 0, 0])
    assert caught.value.kind == "ill_conditioned"
    assert "roundoff" in caught.value.message
    assert "slenderness" in caught.value.remedy


@pytest.mark.parametrize("coupling", ["rigid", "distributed"])
@pytest.mark.parametrize("held", ["nothing", "a point", "a line"])
def test_too_few_supports_are_a_mechanism_and_not_ill_conditioned(coupling, held):
    part = component(box("hex20", (2, 2, 3)), coupling=coupling)
    low = part.mesh.points < 1e-9
    nodes = {"nothing": low[:, 0] < 0, "a point": low.all(axis=1), "a line": low[:, 1] & low[:, 2]}
    with pytest.raises(SolveFailed) as caught:
        Solver(replace(part, fixed_nodes=np.flatnonzero(nodes[held]))).solve([1, 1, 1, 1, 1, 1])
    assert caught.value.kind == "mechanism"


def test_the_negative_eigenvalues_of_an_unstable_tangent_are_counted():
    mesh = box("hex20", (5, 4, 6), (1.0, 0.7, 1.3))
    body = body_of(mesh, clamped(mesh))
    squeezed = mesh.points * np.array([0.0, 0.0, -0.4])
    tangent = body.tangent(squeezed)
    expected = int((np.linalg.eigvalsh(matrix_of(body, tangent).toarray()) < 0).sum())
    assert expected > 0
    assert not tangent.factor.definite
    assert tangent.factor.negatives == expected
    assert body.tangent(None).factor.negatives == 0


LENGTH, SIDE = 0.2, 0.01
SOFT, STIFF = 10e9, 200e9


def two_materials(mesh, is_second, first=STIFF, second=SOFT):
    middles = [mesh.points[block.nodes].mean(axis=1) for block in mesh.blocks]
    return replace(
        component(mesh),
        materials=(Material("first", first, 0.0), Material("second", second, 0.0)),
        material_of_cells=tuple(is_second(m).astype(int) for m in middles),
    )


@pytest.mark.parametrize(
    ("kind", "first", "second"),
    [(kind, STIFF, SOFT) for kind in ("hex20", "hex27", "tet10", "wedge15")]
    + [("hex20", *ends) for most in (1e12, 1e18) for ends in ((1e9, most), (most, 1e9))],
)
def test_materials_in_a_row_stretch_and_bend_like_springs_in_series(kind, first, second):
    """Pure tension and, in hex20, pure bending are exact on this mesh, at any contrast."""
    side = 2 * SIDE
    mesh = box(kind, (2, 2, 10), (side, side, LENGTH))
    built = two_materials(mesh, lambda m: m[:, 2] > LENGTH / 2, first, second)
    give = LENGTH / 2 * (1 / first + 1 / second)
    compliance = Solver(built).compliance
    assert compliance[2, 2] == pytest.approx(give / side**2, rel=1e-9)
    if kind == "hex20":
        assert compliance[4, 4] == pytest.approx(give / (side**4 / 12), rel=1e-9)


def test_a_sandwich_bends_about_its_weighted_middle():
    """Layers side by side: EI about the neutral axis, which lies towards the stiff one."""
    mesh = box("hex20", (2, 2, 10), (SIDE, SIDE, LENGTH))
    built = two_materials(mesh, lambda m: m[:, 0] > SIDE / 2)
    half, breadth = SIDE / 2, SIDE
    areas = np.array([STIFF, SOFT]) * half * breadth
    middles = np.array([half / 2, 3 * half / 2])
    neutral = areas @ middles / areas.sum()
    own = np.array([STIFF, SOFT]) * breadth * half**3 / 12
    right = LENGTH / (own.sum() + areas @ (middles - neutral) ** 2)
    assert Solver(built).compliance[4, 4] == pytest.approx(right, rel=1e-3)
