"""What must hold of the house, and that the tool which looks at it sees."""

from __future__ import annotations

import ast

from tests import house

TEN_LINES = "\n".join(f"    a{number} = b * {number}" for number in range(10))


def source(path: str, text: str) -> house.Source:
    return house.Source(path, text, ast.parse(text))


def test_no_module_imports_another_in_a_circle():
    assert house.circles(house.imports()) == []


def test_no_room_imports_a_room_above_it():
    assert house.upward_imports() == []


def test_the_public_face_promises_what_it_has():
    import wrenchbook

    assert set(dir(wrenchbook)) == set(wrenchbook.__all__)
    assert all(getattr(wrenchbook, name) is not None for name in wrenchbook.__all__)


def test_a_circle_over_three_modules_is_seen_once_and_what_hangs_on_it_is_not():
    imported = {"a": {"b"}, "b": {"c"}, "c": {"a", "d"}, "d": set(), "e": {"a"}}
    assert house.circles(imported) == [["a", "b", "c"]]


def test_the_same_ten_lines_are_seen_whatever_their_layout_and_comments():
    first = source("first.py", f"def one():\n{TEN_LINES}\n")
    spaced = TEN_LINES.replace(" * ", "*").replace("\n", "  # why\n\n")
    second = source("second.py", f"import os\n\n\ndef two():\n{spaced}\n")
    assert house.duplicates([first, second]) == [(("first.py", 2), ("second.py", 5), 10)]
    nine = source("second.py", "\n".join(second.text.splitlines()[:-1]))
    assert house.duplicates([first, nine]) == []


def test_words_and_classes_that_are_to_go_are_counted_by_the_names_that_bind_them():
    among = [
        source("first.py", "class Part: ...\ntold, row = 1, 2\n"),
        source("second.py", "class Part: ...\ndef asked_rows(told): print(held)\n"),
    ]
    assert house.old_words(among) == {"told": 2, "asked": 1}
    assert house.repeated_classes(among) == ["   2 Part"]


def test_the_lines_of_a_room_hold_those_of_its_own_rooms():
    among = [
        source("surrogate/one.py", "a = 1\nb = 2\n"),
        source("surrogate/kriging/two.py", "c = 3\n"),
        source("surrogates/three.py", "d = 4\n"),
        source("service/fmu/four.py", "e = 5\n"),
    ]
    results = house.sizes(among)
    assert list(results) == list(house.COUNTED)
    assert (results["surrogate"], results["service/fmu"]) == ((2, 3), (1, 1))
    assert results["service/client"] == (0, 0)


def test_a_helper_is_counted_if_its_name_stands_once_more_in_its_file():
    text = "def _once(): ...\ndef _twice(): ...\nclass A:\n    def _own(self): ...\n"
    calls = "_once()\n_twice()\n_twice()\nA()._own()\n"
    result = house.helpers_with_one_caller([source("first.py", text + calls)])
    assert result == ["first.py:1 _once", "first.py:4 _own"]


def test_a_forwarder_passes_its_own_parameters_on_and_does_nothing_else():
    text = '''
def forwards(a, b):
    """Do it."""
    return other(a, b=b)
def swaps(a, b):
    return other(b, a)
def none():
    return other()
'''
    assert house.forwarders([source("first.py", text)]) == ["first.py:2 forwards"]


def test_a_form_of_a_row_has_fields_for_wrench_and_displacement():
    text = "class Row:\n    wrench: int\n    displacement: int\nclass Load:\n    wrench: int\n"
    assert house.row_forms([source("first.py", text)]) == ["first.py:1 Row"]


def test_the_tool_counts_numbers_that_decide_and_no_guards_sizes_codes_or_texts():
    text = """
NEAR, MAX_ROWS, WORD, FLAGS = 1e-9, 2_000, "x", (0, 1, 2)
PART: float = 0.5
COVERED, THIN = 0, 1
LARGEST = {1: 0.4, 2: 0.2}
class Settings:
    level: float = 0.95
    chunk: int = 1000
    word: str = "x"
class Other:
    part: float = 0.5
"""
    results = house.decision_thresholds([source("surrogate/a.py", text), source("fea/a.py", text)])
    assert [line.partition(" ")[2] for line in results] == [
        "PART = 0.5",
        "LARGEST = {1: 0.4, 2: 0.2}",
        "level = 0.95",
    ]
