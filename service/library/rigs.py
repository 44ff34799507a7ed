"""Profiles of test rigs, in the ledger's database; those that come with the program are files."""

from __future__ import annotations

from wrenchbook.service.formats.rig import NAME, named_rig, shipped_rigs
from wrenchbook.service.ledger import Ledger

MAX_RIGS = 1000  # of a server


class UnknownRigError(LookupError):
    """There is no profile of this name; the message lists those there are."""


class TooManyRigsError(RuntimeError):
    """The server has as many profiles as it may have."""


def stored_rigs(ledger: Ledger) -> dict[str, str]:
    """Return the TOML texts of the stored profiles, by name."""
    with ledger.reading() as db:
        return dict(db.execute("SELECT name, profile FROM rigs ORDER BY name").fetchall())


def rig_of(ledger: Ledger, rig: str) -> str:
    """Return the TOML of a stored profile of this name, else of a shipped one; a TOML as it is.

    Raises UnknownRigError if neither has the name.
    """
    if not NAME.fullmatch(rig):
        return rig
    profiles = shipped_rigs() | stored_rigs(ledger)
    if rig not in profiles:
        raise UnknownRigError(
            f"there is no rig {rig!r}; there are {', '.join(sorted(profiles))}. Store it with "
            f"wrenchbook rig add {rig} FILE.toml, or send the profile itself"
        )
    return named_rig(profiles[rig], rig)


def store_rig(ledger: Ledger, name: str, profile: str) -> None:
    """Store a profile, or replace it; TooManyRigsError."""
    with ledger.writing() as db:
        db.execute("INSERT OR REPLACE INTO rigs VALUES (?, ?)", (name, profile))
        if db.execute("SELECT count(*) FROM rigs").fetchone()[0] > MAX_RIGS:
            raise TooManyRigsError(f"a server stores {MAX_RIGS} rigs at most; remove some first")


def remove_rig(ledger: Ledger, name: str) -> None:
    """Remove a stored profile; UnknownRigError."""
    with ledger.writing() as db:
        removed = db.execute("DELETE FROM rigs WHERE name = ?", (name,)).rowcount
    if not removed:
        kind = "comes with the program and stays" if name in shipped_rigs() else "is not stored"
        raise UnknownRigError(f"the rig {name!r} {kind}; stored: {', '.join(stored_rigs(ledger))}")
