"""Rows of another setup of a component: what they are, and how to solve their wrenches again.

A component whose files change has another fingerprint. Its earlier solves stay in the ledger and
are in no table until the files are as they were; nothing else tells that they are there.
"""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from wrenchbook.service.ledger import Ledger, packed, unpacked
from wrenchbook.service.library.component import Component
from wrenchbook.service.tables.served import ServedTable
from wrenchbook.surrogate.table.rows import Floats


def count_others(ledger: Ledger, component: Component, table: ServedTable) -> None:
    """Note at a table how many rows of other setups the ledger has.

    Raises
    ------
    LedgerUnavailableError
        If the ledger cannot be asked.
    """
    found = ledger.of_other_setups(component.name, component.fingerprint)
    table.other_rows = sum(found.values())
    settled = not component.has_fea or (table.linear and not table.needs_compliance)
    if found and not settled:
        table.other_wrenches = len(unsolved(component, found, table.rows.wrench))


def unsolved(component: Component, others: Iterable[bytes], known: Floats) -> Floats:
    """Return the distinct wrenches of rows of other setups that no row of the table has.

    Parameters
    ----------
    others : iterable of bytes
        Packed wrenches of the rows of other setups.
    known : ndarray, shape (n, 6), N and N·m
        The wrenches of the table's rows.

    Returns
    -------
    ndarray, shape (k, 6), N and N·m
        In their order, loads on locked freedoms zero.
    """
    wanted = dict.fromkeys(packed(component.acting(unpacked(others))))
    if not wanted:
        return np.empty((0, 6))
    has = set(packed(component.acting(known)))
    return unpacked(wrench for wrench in wanted if wrench not in has)


def others_in_words(name: str, table: ServedTable) -> str:
    """Return how many rows belong to another setup and what to do; empty if nothing is to do."""
    if not table.other_wrenches:
        return ""
    return (
        f"{table.other_rows} rows belong to another setup of {name!r} and are not in its table: "
        f"POST /v1/components/{name}/table/resolve, or wrenchbook resolve {name}, solves their "
        f"{table.other_wrenches} wrenches again"
    )


def warning_of(component: Component, table: ServedTable) -> str:
    """Return `others_in_words`; also of a component that nothing can be solved for."""
    if component.has_fea or not table.other_rows:
        return others_in_words(component.name, table)
    return (
        f"{table.other_rows} rows belong to another setup of {component.name!r} and are not in its "
        "table: it has no finite-element setup now. Put its files back, or export the rows and "
        "load them as measured ones, without a fingerprint"
    )
