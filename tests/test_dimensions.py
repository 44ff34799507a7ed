"""The numbers of inputs and outputs come from a table's space, not from a literal six."""

from __future__ import annotations

import ast
from fnmatch import fnmatch
from pathlib import Path

ROOT = Path(__file__).parents[1]
SPACE_OF_ONE = "for one wrench at one interface alone"
OF_ONE_INTERFACE = "force and moment, translation and rotation of one interface"
NO_DIMENSION = "no number of inputs or outputs"
ALLOWED = {
    "surrogate/composition/*": SPACE_OF_ONE,
    "surrogate/findings/*": SPACE_OF_ONE,
    "surrogate/methods.py": SPACE_OF_ONE,
    "surrogate/table/axes.py": SPACE_OF_ONE,
    "surrogate/packed/axes_arrays.py": SPACE_OF_ONE,
    "surrogate/design.py": SPACE_OF_ONE,
    "surrogate/error_law.py": "the default of outputs",
    "surrogate/kriging/calibration.py": "the default of outputs",
    "surrogate/packed/numbering.py": NO_DIMENSION,
    "surrogate/packed/reasons.py": NO_DIMENSION,
    "surrogate/kernel/library.py": NO_DIMENSION,
    "surrogate/kernel/replies.py": NO_DIMENSION,
    "service/answering/drawn.py": SPACE_OF_ONE,
    "service/http/routes/drawing.py": SPACE_OF_ONE,
    "service/fields/*": SPACE_OF_ONE,
    "service/client/mount/*": SPACE_OF_ONE,
    "service/client/joint/*": OF_ONE_INTERFACE,
    "service/client/batched/*": SPACE_OF_ONE,
    "service/client/plot.py": SPACE_OF_ONE,
    "service/paper/*": SPACE_OF_ONE,
    "service/cli/demo.py": SPACE_OF_ONE,
    "service/formats/rig.py": SPACE_OF_ONE,
    "service/contract.py": OF_ONE_INTERFACE,
    "service/client/wrenches.py": OF_ONE_INTERFACE,
    "service/client/replies.py": OF_ONE_INTERFACE,
    "service/cli/main.py": OF_ONE_INTERFACE,
    "service/http/bodies.py": OF_ONE_INTERFACE,
    "service/http/schemas.py": OF_ONE_INTERFACE,
    "service/http/table_schemas.py": OF_ONE_INTERFACE,
    "service/http/routes/components.py": OF_ONE_INTERFACE,
    "service/jobs/solve_attempt.py": "at least one interface",
    "service/http/routes/recording.py": NO_DIMENSION,
    "service/http/routes/page.py": NO_DIMENSION,
    "service/ledger/*": NO_DIMENSION,
    "service/library/bundles.py": NO_DIMENSION,
    "service/formats/units.py": NO_DIMENSION,
    "service/ops/checks.py": NO_DIMENSION,
    "service/sandbox/child.py": NO_DIMENSION,
    "service/workspace.py": NO_DIMENSION,
}


def files_with_a_six() -> set[str]:
    """Return the files of surrogate/ and service/ with the number 6, relative to the root."""
    found = set()
    for path in [*ROOT.glob("surrogate/**/*.py"), *ROOT.glob("service/**/*.py")]:
        numbers = [one for one in ast.walk(ast.parse(path.read_text())) if _is_six(one)]
        if numbers:
            found.add(path.relative_to(ROOT).as_posix())
    return found


def _is_six(node: ast.AST) -> bool:
    return isinstance(node, ast.Constant) and type(node.value) is int and node.value == 6


def test_a_literal_six_stands_only_where_it_has_a_reason():
    unknown = [
        name for name in files_with_a_six() if not any(fnmatch(name, own) for own in ALLOWED)
    ]
    assert sorted(unknown) == []


def test_each_reason_for_a_six_is_still_needed():
    found = files_with_a_six()
    assert [own for own in ALLOWED if not any(fnmatch(name, own) for name in found)] == []
