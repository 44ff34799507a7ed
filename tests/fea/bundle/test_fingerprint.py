"""The fingerprint changes with what can change an answer, and with nothing else."""

import copy
import json

import pytest

from wrenchbook.fea.bundle import fingerprint as module
from wrenchbook.fea.bundle.read import bundle_of, read_bundle
from wrenchbook.fea.bundle.shipped import SHIPPED

BAR = {
    "name": "b",
    "title": "B",
    "mesh": {"generator": "bar", "length": 1.0, "width": 0.02, "height": 0.02},
    "material": [
        {"region": "all", "youngs_modulus": 210e9, "poisson_ratio": 0.3},
        {"region": "tip", "youngs_modulus": 70e9, "poisson_ratio": 0.3},
    ],
    "supports": {"fixed": ["start", "side"]},
    "interface": {"section": "end", "coupling": "rigid", "locked": ["ux", "uy"]},
    "analysis": {"nonlinear": False},
    "range": {"force": [1, 1, 1], "moment": [1, 1, 1]},
}


def print_of(table, folder="."):
    return bundle_of(table, folder).fingerprint


def altered(path, value):
    table = copy.deepcopy(BAR)
    at = table
    for key in path[:-1]:
        at = at[key]
    at[path[-1]] = value
    return table


@pytest.mark.parametrize(
    ("path", "value"),
    [
        (("name",), "c"),
        (("title",), "C"),
        (("range", "force"), [2, 2, [-1, 2]]),
        (("tolerance",), {"translation": 1e-5, "rotation": 1e-4}),
        (("mesh", "length"), 1),
        (("mesh", "cells_across"), 2),
        (("material", 0, "youngs_modulus"), 210_000_000_000),
        (("material",), BAR["material"][::-1]),
        (("supports", "fixed"), ["side", "start"]),
        (("interface", "locked"), ["uy", "ux"]),
        (("interface", "axes"), [[1, 0, 0], [0, 1, 0], [0, 0, 1]]),
        (("analysis", "integration"), "reduced"),
    ],
)
def test_the_fingerprint_stays_when_no_answer_can_change(path, value):
    assert print_of(altered(path, value)) == print_of(BAR)


SPRING = {"group": "side", "coupling": "rigid", "stiffness": [1.0] * 6}
CHANGES = [
    (("mesh", "length"), 1.0000000000000002),
    (("mesh", "cells_along"), 41),
    (("mesh", "generator"), "plate"),
    (("material", 0, "youngs_modulus"), 211e9),
    (("material", 0, "poisson_ratio"), 0.31),
    (("material", 1, "region"), "root"),
    (("supports", "fixed"), ["start"]),
    (("supports", "sliding"), [{"group": "side", "directions": ["x"]}]),
    (("supports", "sliding"), [{"group": "side", "directions": ["y"]}]),
    (("supports", "bushing"), [SPRING]),
    (("supports", "bushing"), [SPRING | {"stiffness": [2.0] * 6}]),
    (("supports", "bushing"), [SPRING | {"point": [0, 0, 0]}]),
    (("supports", "bushing"), [SPRING | {"coupling": "distributed"}]),
    (("interface", "section"), "side"),
    (("interface", "point"), [1, 0, 0]),
    (("interface", "axes"), [[0, 1, 0], [0, 0, 1], [1, 0, 0]]),
    (("interface", "coupling"), "distributed"),
    (("interface", "weights"), "equal"),
    (("interface", "locked"), ["ux"]),
    (("analysis", "nonlinear"), True),
    (("analysis", "integration"), "full"),
]


def test_each_thing_that_can_change_an_answer_changes_the_fingerprint():
    prints = [print_of(BAR)]
    for path, value in CHANGES:
        table = altered(path, value)
        if value == "plate":
            table["mesh"] = {"generator": "plate", "length": 1.0, "width": 1.0}
            table["mesh"] |= {"thickness": 0.02, "patch": 0.1}
        prints.append(print_of(table))
    assert len(set(prints)) == len(prints)


def test_a_spring_is_the_same_by_six_numbers_and_by_its_matrix_in_any_order():
    other = SPRING | {"group": "end"}
    matrix = SPRING | {"stiffness": [[float(i == j) for j in range(6)] for i in range(6)]}
    prints = [altered(("supports", "bushing"), ones) for ones in ([SPRING, other], [other, matrix])]
    assert print_of(prints[0]) == print_of(prints[1])


def test_the_fingerprint_covers_the_bytes_of_the_mesh_file_and_not_its_name(tmp_path):
    def with_file(name, content, unit="mm"):
        (tmp_path / name).write_bytes(content)
        return print_of(altered(("mesh",), {"file": name, "unit": unit}), tmp_path)

    assert with_file("a.msh", b"1") == with_file("b.msh", b"1")
    prints = [with_file("a.msh", b"1"), with_file("a.msh", b"2"), with_file("a.msh", b"1", "m")]
    prints.append(with_file("a.vtu", b"1"))
    assert len(set(prints)) == 4


def test_the_fingerprint_is_16_hexadecimal_digits_and_the_same_in_every_run():
    assert print_of(json.loads(json.dumps(BAR))) == "4b5a158f755517b4"


def test_rows_with_the_old_tangents_of_nonlinear_solves_are_not_taken_for_new_ones():
    nonlinear = altered(("analysis", "nonlinear"), True)
    assert print_of(nonlinear) != "10db04f855149a7b"


def test_measured_tables_and_decks_keep_their_fingerprints_when_the_solver_changes():
    measured = {key: BAR[key] for key in ("name", "title", "range")}
    assert print_of(measured) == "767d9effa79f57b5"
    deck = read_bundle(SHIPPED / "plate_ccx")
    assert deck.fingerprint == "a2013183cd681d25"


BOTH = "*STEP\n*BOUNDARY\n1, 1, 3\n*END STEP\n*STEP\n*BOUNDARY{}\n2, 1, 3\n*END STEP\n"
DECKS = {
    "one step": ("*BOUNDARY\n1, 1, 3\n*STEP\n*CLOAD\n2, 1, 5.\n*END STEP\n", False),
    "one step that begins anew": ("*STEP\n*BOUNDARY, OP=NEW\n1, 1, 3\n*END STEP\n", False),
    "a perturbation alone": ("*BOUNDARY\n1, 1, 3\n*STEP, PERTURBATION\n*END STEP\n", False),
    "a step that adds": (BOTH.format(""), False),
    "a step without loads of the body": (
        f"{BOTH.format('')}*STEP\n*DLOAD, OP=NEW\n*END STEP\n",
        False,
    ),
    "a step that releases": (BOTH.format(", op = new"), True),
    "a step that releases what holds before": (
        "*BOUNDARY\n1, 1, 3\n*STEP\n*BOUNDARY,\nOP=NEW\n2, 1, 3\n*END STEP\n",
        True,
    ),
    "a step after a perturbation": (BOTH.replace("*STEP", "*Step, Perturbation", 1), True),
    "load cases": ("*STEP\n*LOAD CASE, NAME=A\n*LOAD CASE, NAME=B\n*END STEP\n", True),
}


@pytest.mark.parametrize("name", DECKS)
@pytest.mark.parametrize("encoding", ["utf-8", "utf-16"])
def test_rows_of_the_nodes_of_all_steps_are_not_taken_for_those_of_the_last(
    tmp_path, monkeypatch, name, encoding
):
    deck, differs = DECKS[name]
    (tmp_path / "deck.inp").write_text(deck, encoding=encoding)
    table = altered(("mesh",), {"file": "deck.inp", "unit": "mm"})
    prints = []
    for group in ("ROOT", "nodes_held_in_xyz"):
        table["supports"] = {"fixed": [group]}
        prints.append({print_of(table, tmp_path)})
        with monkeypatch.context() as before:
            before.setattr(module, "CASE", "nodes of all cases")
            prints[-1].add(print_of(table, tmp_path))
    assert [len(own) for own in prints] == [1, 1 + differs]


SELECTORS = {
    "a": {"faces": [3, 1], "near": [0.1, 0.2, 0.3]},
    "b": {"plane": "y", "at": 0.5, "box": [[0, 0, 0], [1, 1, 1]], "inside": "a"},
    "c": {"radius": 0.01, "cylinder": {"point": [0, 0, 0], "axis": [0, 0, 2]}},
    "d": {"normal": [0, 0, 1], "angle": 20, "plane": [0, 1, 0], "at": [0, 0.5, 0]},
}
END = {"section": "end", "coupling": "distributed", "point": [1, 0, 0]}
LOADS = {"range": BAR["range"]}
HEATED = [material | {"thermal_expansion": 1e-5} for material in BAR["material"]]
ALL_PARTS = {key: value for key, value in BAR.items() if key != "range"} | {
    "material": HEATED,
    "interface": [
        {"name": "tip"} | END | LOADS,
        {"name": "side", "section": "side", "coupling": "rigid"} | LOADS,
    ],
    "tie": [{"secondary": "b", "main": "a"}, {"secondary": "d", "main": "c"}],
    "bolt": [
        {"region": "shank", "axis": [0, 0, 1], "force": 5.0},
        {"group": "c", "axis": [1, 0, 0], "force": 1.0},
    ],
    "inputs": {"temperature": {"range": [0, 100], "reference": 20}},
}
PINNED = {
    "bar": "a030a8884fc25d39",
    "hot_bracket": "ae9f76850835008a",
    "link": "6efa439a543f61f9",
    "plate": "f69b2402276ac8c6",
    "plate_ccx": "a2013183cd681d25",
    "plate_thin": "51a040f499d1fa26",
    "spring": "5376e95f02a558c8",
    "changes": "45e9a1a2f0b5e95a6444",
    "geometry": "163483ec345c50d8",
    "deck": "b01f23f5c71e134d",
    "all parts": "66c5fb9a9cc4c146",
}


def test_no_change_of_the_program_changes_the_fingerprint_of_an_existing_component(tmp_path):
    (tmp_path / "part.step").write_text("ISO-10303-21;")
    (tmp_path / "deck.inp").write_text(DECKS["a step that releases"][0] + "*EQUATION\n")
    sources = {
        "geometry": {"file": "part.step", "size": 0.01, "regions": {"r": {"bodies": [1]}}},
        "deck": {"file": "deck.inp", "unit": "mm", "order": 2},
    }
    prints = {path.name: read_bundle(path).fingerprint for path in SHIPPED.iterdir()}
    prints["changes"] = "".join(
        print_of(altered(*change))[0] for change in CHANGES if change[1] != "plate"
    )
    for name, source in sources.items():
        table = BAR | {"mesh": source | {"groups": SELECTORS}}
        table["supports"] = {"fixed": ["nodes_held_in_xyz"]}
        prints[name] = print_of(table, tmp_path)
    prints["all parts"] = print_of(ALL_PARTS)
    assert prints == PINNED
