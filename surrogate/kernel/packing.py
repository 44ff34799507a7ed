"""The packed form of a table that was built in this process."""

from __future__ import annotations

from ..build import Table
from ..packed.writer import pack
from .binding import PackedTable


def packed_of(table: Table) -> PackedTable:
    """Return the packed form of a built table, which is made at the first call and kept."""
    if table.packed is None:
        table.packed = PackedTable.from_bytes(b"".join(pack(table)))
    return table.packed
