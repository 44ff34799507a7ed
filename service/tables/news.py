"""From what the ledger says happened to rows to the rows of a table."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from service.ledger import LedgerRow, News
from service.library.component import Component
from surrogate.table.rows import Rows


def with_news(component: Component, rows: Rows, news: News) -> Rows:
    """Return a component's rows after the news of them."""
    kept = rows.take(~np.isin(rows.seq, list(news.gone))) if news.gone else rows
    return kept + _usable(component, news.rows)


def _usable(component: Component, rows: Iterable[LedgerRow]) -> Rows:
    """Keep rows of this setup and measured ones; FEA rows of another setup are never mixed in."""
    return Rows.from_records(
        [
            {
                "seq": row.seq,
                "wrench": row.wrench,
                "displacement": row.displacement,
                "compliance": row.compliance,
                "uncertainty": row.uncertainty,
                "source": row.source,
                "fingerprint": row.fingerprint,
            }
            for row in rows
            if row.fingerprint in ("", component.fingerprint)
        ]
    )
