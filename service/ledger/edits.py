"""SQL of withdrawals as a whole: how all of a component's rows stand, and repeating that."""

from collections.abc import Iterable

from wrenchbook.service.ledger.records import RowEdit
from wrenchbook.service.ledger.rows import edit, is_withdrawn
from wrenchbook.service.ledger.schema import Connection


def newest_edits(db: Connection, component: str, until: int) -> list[RowEdit]:
    """Return the newest edit, up to a seq, of each of a component's rows that had one."""
    # Beside max(), SQLite gives that record's columns.
    found = db.execute(
        "SELECT rows.key, withdrawn, edits.created, max(edits.seq) FROM edits"
        " JOIN rows ON rows.seq = row WHERE edits.component = ? AND edits.seq <= ?"
        " GROUP BY row ORDER BY row",
        (component, until),
    )
    return [RowEdit(key, bool(withdrawn), created) for key, withdrawn, created, _ in found]


def replay(db: Connection, component: str, edits: Iterable[RowEdit]) -> int:
    """Repeat edits that are newer than what a row has had; return how many changed a row.

    Those of rows that are not there change nothing.
    """
    newest = "SELECT created FROM edits WHERE row = ? ORDER BY seq DESC LIMIT 1"
    same = "SELECT seq FROM rows WHERE key = ? AND component = ?"
    changed = 0
    for key, withdrawn, created in edits:
        found = db.execute(same, (key, component)).fetchone()
        if found is None or is_withdrawn(db, found[0]) == withdrawn:
            continue
        last = db.execute(newest, found).fetchone()
        if last is None or last[0] < created:
            edit(db, component, found[0], withdrawn=withdrawn, now=created)
            changed += 1
    return changed
