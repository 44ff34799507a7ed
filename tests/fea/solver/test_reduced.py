"""Reduced parts as Nastran, Abaqus and Simscape read them, by small readers of the two formats."""

import numpy as np
import pytest
from scipy.linalg import eigh
from scipy.spatial.transform import Rotation

from tests.fea.solver.test_vibration import bar
from wrenchbook.fea.bundle.read import read_bundle
from wrenchbook.fea.bundle.shipped import SHIPPED
from wrenchbook.fea.check.commands import main
from wrenchbook.fea.export import reduced
from wrenchbook.fea.solve import Solver

FIRST = 101
MATRICES = {"KAAX": "stiffness", "MAAX": "mass", "BAAX": "damping"}


@pytest.fixture(scope="module")
def part():
    return reduced.arrays(bar().craig_bampton(4), 0.02)


def symmetric(entries):
    """The matrix of {((node, freedom), (node, freedom)): value}, rows in the order of nodes."""
    rows = sorted({row for pair in entries for row in pair})
    matrix = np.zeros((len(rows), len(rows)))
    for (row, column), value in entries.items():
        assert (column, row) not in entries or row == column
        i, j = rows.index(row), rows.index(column)
        matrix[i, j] = matrix[j, i] = value
    return matrix


def number(text):
    return float(text.replace("D", "E"))


def nastran(text):
    """Grid points, scalar points and the terms of each DMIG, by fixed columns."""
    points, scalars, terms, name, column = {}, set(), {}, None, None
    lines = iter(line for line in text.splitlines() if not line.startswith("$"))
    for line in lines:
        assert len(line) <= 72
        small = [line[i : i + 8].strip() for i in range(0, 72, 8)]
        wide = [line[i : i + 16].strip() for i in range(8, 72, 16)]
        if small[0] == "GRID*":
            more = next(lines)
            points[int(wide[0])] = [number(wide[2]), number(wide[3]), number(more[8:24])]
        elif small[0] == "SPOINT":
            scalars |= set(range(int(small[1]), int(small[3]) + 1))
        elif small[0] == "DMIG":
            assert small[2:6] == ["0", "6", "2", "0"]
            terms[small[1]] = {}
        elif small[0] == "DMIG*":
            name, column = wide[0], (int(wide[1]), int(wide[2]))
        else:
            assert small[0] == "*"
            terms[name][(int(wide[0]), int(wide[1])), column] = number(wide[2])
    rows = {row for entries in terms.values() for row, _ in entries}
    assert rows == {(n, i) for n in points for i in range(1, 7)} | {(n, 0) for n in scalars}
    return points, scalars, terms


def abaqus(text):
    """The nodes, the terms of each matrix, and the kinds of the assembled ones."""
    nodes, terms, kinds, entries, keyword = {}, {}, {}, {}, ""
    for line in text.upper().splitlines():
        if line.startswith("**"):
            continue
        words = [word.strip() for word in line.split(",")]
        if line.startswith("*"):
            keyword, kinds = words[0], dict(word.split("=") for word in words[1:])
            if keyword == "*MATRIX INPUT":
                assert kinds["TYPE"] == "SYMMETRIC"
                entries = terms[kinds["NAME"]] = {}
        elif keyword == "*NODE":
            nodes[int(words[0])] = [float(word) for word in words[1:]]
        else:
            row, freedom, column, other = map(int, words[:4])
            entries[(row, freedom), (column, other)] = float(words[4])
    return nodes, terms, kinds


def test_the_punch_file_gives_the_matrices_to_nine_digits(part):
    points, scalars, terms = nastran(reduced.nastran(part, FIRST))
    np.testing.assert_allclose(list(points.values()), part["origins"], rtol=1e-9)
    assert (list(points), len(scalars)) == ([FIRST, FIRST + 1], 4)
    for name, key in MATRICES.items():
        np.testing.assert_allclose(symmetric(terms[name]), part[key], rtol=1e-9, atol=0)


def test_a_number_has_the_digits_that_sixteen_characters_hold():
    texts = [reduced._number(value) for value in (1 / 3e-5, -1 / 3e-5, -1 / 3e5, -1e-110 / 3)]
    assert texts == ["3.333333333333D4", "-3.33333333333D4", "-3.3333333333D-6", "-3.33333333D-111"]


def test_the_matrix_file_gives_the_matrices_to_the_last_bit(part):
    nodes, terms, kinds = abaqus(reduced.abaqus(part, FIRST))
    np.testing.assert_array_equal(list(nodes.values())[:2], part["origins"])
    assert kinds == {"STIFFNESS": "STIFFNESS", "MASS": "MASS", "VISCOUS DAMPING": "DAMPING"}
    for key in MATRICES.values():
        read = symmetric(terms[key.upper()])
        np.testing.assert_array_equal(read, part[key])


def test_the_quaternions_give_the_axes_with_w_first(part):
    w, x, y, z = part["quaternions"].T
    turned = Rotation.from_quat(np.stack([x, y, z, w], axis=1)).as_matrix()
    np.testing.assert_allclose(turned, part["rotations"], atol=1e-15)
    assert abs(part["quaternions"][1, 0]) < 0.999


def test_each_elastic_mode_of_the_free_part_has_the_damping_ratio(part):
    squares, motions = eigh(part["stiffness"], part["mass"])
    damping = motions.T @ part["damping"] @ motions
    ratios = np.diag(damping)[6:] / (2 * np.sqrt(squares[6:]))
    np.testing.assert_allclose(ratios, 0.02, rtol=1e-6)


@pytest.mark.parametrize(("ending", "reader"), [("pch", nastran), ("MTX", abaqus)])
def test_the_ending_of_the_file_chooses_the_program(ending, reader, tmp_path):
    file = tmp_path / f"bar.{ending}"
    command = ["condense", str(SHIPPED / "bar"), str(file), "--modes", "2", "--first", "7"]
    assert main(command) == 0
    first, *_ = reader(file.read_text())
    origins = Solver(read_bundle(SHIPPED / "bar")).craig_bampton(2).origins
    np.testing.assert_allclose([first[7], first[8]], origins, rtol=1e-9)
