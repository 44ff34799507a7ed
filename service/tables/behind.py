"""What is said where a table is not there yet as the ledger has it."""

from __future__ import annotations


class TableBehindError(Exception):
    """The table does not hold yet all rows that the ledger has; ask again."""

    @classmethod
    def late(cls, name: str, why: str | None, seconds: float, more: str = "") -> TableBehindError:
        """Say that the newest rows are not in a table after so long, and why if that is known."""
        why = why or f"its newest rows are not in it after {seconds:g} s"
        return cls(
            f"the table of {name!r} is older than the ledger: {why}{more}. Nothing was asked for; "
            "ask again in a while"
        )

    @classmethod
    def unbuilt(cls, name: str, why: str | None) -> TableBehindError:
        """Say that a table that has rows was never built since the start."""
        why = why or "it is being built for the first time since the start"
        return cls(
            f"the table of {name!r} has rows and cannot answer yet: {why}. Nothing was asked "
            "for; ask again in a while"
        )
