"""From rows to what answers, and its first answer."""

from __future__ import annotations

from service.contract import CONTRACT
from service.library.component import Component
from service.tables.solver_errors import SolverErrors
from surrogate.build import AnyTable, build
from surrogate.kernel.binding import PackedTable
from surrogate.packed.writer import pack
from surrogate.table.rows import Rows


def make(
    component: Component,
    rows: Rows,
    version: int,
    before: AnyTable | None = None,
    errors: SolverErrors | None = None,
) -> AnyTable:
    """Build the surrogate; its version is the number of the ledger's newest change in it.

    It is the same function of the rows alone, whatever was before: whoever has the same rows, a
    simulator that has downloaded them or this server after a restart, has the same digits. What
    has not changed since the version before is not made again. What `errors` knows of the solver
    stands beside it.
    """
    own = errors if component.has_fea else None
    table = build(
        rows,
        component.load_range,
        tolerance=component.tolerance,
        linear=component.linear,
        version=version,
        before=before,
        solver_error=own and own.read(component.name, component.fingerprint),
        locked=component.idle,
    )
    put_packed(table, component.name, component.fingerprint)
    return table


def put_packed(table: AnyTable, name: str, fingerprint: str) -> None:
    """Pack a component's table: the kernel answers from that."""
    content = pack(table, component=name, fingerprint=fingerprint, contract=CONTRACT)
    table.packed = PackedTable.from_bytes(b"".join(content))


def ask_once(surrogate: AnyTable) -> None:
    """Ask for one answer, so that what is made at the first one is made here, by no request."""
    surrogate.packed.answer((0.01 * surrogate.load_range.scale).tolist())
