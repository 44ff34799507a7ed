"""SQL that looks for damaged rows and mends them from another copy."""

import time
from collections.abc import Sequence

from wrenchbook.service.ledger import rows
from wrenchbook.service.ledger.jobs import MOST_VALUES
from wrenchbook.service.ledger.records import LedgerRow, NewRow
from wrenchbook.service.ledger.schema import Connection


def attempts(db: Connection, job_ids: list[int]) -> dict[int, tuple[str, int, float | None]]:
    """Return of each of these jobs that there is: status, newest attempt, when it ended."""
    found = {}
    for start in range(0, len(job_ids), MOST_VALUES):
        part = job_ids[start : start + MOST_VALUES]
        marks = ", ".join("?" * len(part))
        select = f"SELECT id, status, attempt, finished FROM jobs WHERE id IN ({marks})"
        found |= {job: (status, n, ended) for job, status, n, ended in db.execute(select, part)}
    return found


def sound_rows(db: Connection, seqs: Sequence[int]) -> dict[int, LedgerRow]:
    """Return those of these rows that are there and as they were written, by number."""
    found = {}
    for start in range(0, len(seqs), MOST_VALUES):
        part = rows.numbered(db, seqs[start : start + MOST_VALUES])
        found |= {row.seq: row for row in part}
    return found


def unsound(db: Connection) -> dict[int, str]:
    """Return the rows that are not as they were written, with the component they name."""
    named = dict(db.execute("SELECT seq, component FROM rows ORDER BY seq").fetchall())
    sound = sound_rows(db, list(named))
    return {seq: str(component) for seq, component in named.items() if seq not in sound}


def heal(db: Connection, component: str, seq: int, row: NewRow) -> bool:
    """Write a damaged row anew under its own number; False if it is sound or cannot be."""
    if rows.is_sound(db, seq):
        return False
    now = time.time()
    job, created, origin = db.execute(
        "SELECT job, created, origin FROM rows WHERE seq = ?", (seq,)
    ).fetchone() or (None, now, row.origin)
    created = created if isinstance(created, float) else now
    known = db.execute("SELECT id FROM jobs WHERE id = ?", (job,)).fetchone()
    job = known[0] if known else None
    if not rows.rewrite(db, component, seq, row, job, created, origin):
        return False
    # Followers have read past this number; a withdrawal and its undoing are told to them anew.
    withdrawn = rows.is_withdrawn(db, seq)
    rows.edit(db, component, seq, withdrawn=not withdrawn, now=now)
    rows.edit(db, component, seq, withdrawn=withdrawn, now=now)
    return True
