"""The wrench contract: the conventions of every wrench and displacement in a request or reply."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Final, Literal

from wrenchbook.surrogate import answer
from wrenchbook.surrogate.table import space

COVERAGE: Final = answer.NAMES
LOADS, LOAD_UNITS = space.LOADS, space.LOAD_UNITS
OUTPUTS, OUTPUT_UNITS = space.OUTPUTS, space.OUTPUT_UNITS

Coverage = Literal["covered", "thin", "outside"]
OnThin = Literal["queue", "wait", "estimate", "reject"]
ImportFormat = Literal["csv", "xlsx", "parquet", "hdf5", "json", "mat", "lvm", "tdms", "xls"]
ExportFormat = Literal["csv", "xlsx", "parquet", "hdf5", "json", "packed", "bushing"]

QUERY_WAIT_S: Final = 30.0  # s that a query waits for its solve without `wait_s`
# Numbers of jobs, rows and imports are below it: SQLite's integers have 64 bits with a sign.
NUMBER_LIMIT: Final = 2**63
MAX_BATCH: Final = 1_000_000  # wrenches of a batch: 48 MB as float64
MAX_BLOCK: Final = 10_000  # wrenches of a block: the most that a recording keeps

MOMENT_POINT: Final = "the interface point where it is now"

CONTRACT: Final[dict[str, str]] = {
    "units": "SI: N, N·m, m, rad",
    "wrench": (
        "force then moment, acting ON the deformable component at the interface reference point "
        "where it is now (it moves with the section), in axes fixed to the undeformed interface "
        "frame"
    ),
    "displacement": (
        "translation then rotation of the same point, in the same axes; the rotation is a "
        "rotation vector r, applied as R0 · exp(r)"
    ),
    "moment": (
        f"about {MOMENT_POINT}; spatial: in the fixed axes, it does not follow the section as it "
        "turns"
    ),
    "sign": "a hanging weight in a z-up frame gives a negative fz",
    "rotation_limit": "20 degrees; rows beyond it are refused",
}


def by_part(values: Sequence[float | None], interfaces: Sequence[str] = ()) -> dict[str, Any]:
    """Return six numbers an interface as ``translation`` and ``rotation``, m and rad.

    With names of interfaces the result has an entry for each name.
    """
    if interfaces:
        return {name: by_part(values[6 * k : 6 * k + 6]) for k, name in enumerate(interfaces)}
    return {"translation": values[:3], "rotation": values[3:]}


CONTRACT_TEXT: Final = " ".join(f"{word}: {meaning}." for word, meaning in CONTRACT.items())
CONTRACT_MARKDOWN: Final = "\n\n".join(
    f"**{word}**: {meaning}." for word, meaning in CONTRACT.items()
)


def counted(count: int, noun: str) -> str:
    """Return a count and its noun, singular or plural: ``1 row``, ``2 rows``."""
    plural = f"{noun}es" if noun.endswith(("s", "h")) else f"{noun}s"
    return f"{count} {noun if count == 1 else plural}"
