"""Profiles of test rigs, in the ledger's database; those of the program are files."""

from __future__ import annotations

from pathlib import Path

from wrenchbook.service.formats.rig import NAME, Rig, RigError
from wrenchbook.service.ledger import Ledger
from wrenchbook.service.ledger.audit import note
from wrenchbook.service.ledger.connection import Connection

MAX_RIGS = 1000  # stored profiles: 8 MB; a laboratory has dozens
MAX_NAMED = 20  # profiles in a message: more would hide its remedy
SHIPPED = Path(__file__).parents[1] / "formats" / "rigs"


class UnknownRigError(LookupError):
    """There is no profile of this name; the message lists the existing ones."""


class ShippedRigError(ValueError):
    """The profile is part of the program and cannot be removed."""


def profiles(ledger: Ledger) -> dict[str, tuple[str, str]]:
    """Return the TOML text of each profile and whether it is stored or shipped, by name."""
    shipped = {file.stem: (file.read_text("utf-8"), "shipped") for file in SHIPPED.glob("*.toml")}
    with ledger.reading() as db:
        stored = db.execute("SELECT name, profile FROM rigs").fetchall()
    return dict(sorted((shipped | {name: (text, "stored") for name, text in stored}).items()))


def rig_of(ledger: Ledger, rig: str) -> str:
    """Return the TOML of a profile, with its name, by this name; a TOML is returned unchanged.

    A stored profile replaces a shipped one of the same name.

    Raises UnknownRigError if there is no such profile.
    """
    if not NAME.fullmatch(rig):
        return rig
    known = profiles(ledger)
    if rig not in known:
        names = ", ".join([*known][:MAX_NAMED]) + (", ..." if len(known) > MAX_NAMED else "")
        message = f"there is no rig {rig!r}; name one of {names}. Store it with "
        raise UnknownRigError(f"{message}wrenchbook rig add {rig} FILE.toml, or send its TOML")
    text = known[rig][0]
    return f'name = "{rig}"\n{text}' if Rig.read(text).name == Rig.digest(text) else text


def store_rig(ledger: Ledger, name: str, profile: str) -> None:
    """Store a profile, or replace it; raises RigError if there are MAX_RIGS already."""
    with ledger.writing() as db:
        others = db.execute("SELECT count(*) FROM rigs WHERE name != ?", (name,)).fetchone()[0]
        if others >= MAX_RIGS:
            raise RigError(
                f"{others} rigs are stored, the limit; remove one with: wrenchbook rig remove NAME"
            )
        note(db, "rig.store", name, before=_stored(db, name), after=profile)
        db.execute("INSERT OR REPLACE INTO rigs VALUES (?, ?)", (name, profile))


def remove_rig(ledger: Ledger, name: str) -> None:
    """Remove a stored profile; raises UnknownRigError, or ShippedRigError for a shipped one."""
    with ledger.writing() as db:
        before = _stored(db, name)
        if before is None:
            if (SHIPPED / f"{name}.toml").is_file():
                why = f"the rig {name!r} is part of the program, so it stays; wrenchbook rig list "
                raise ShippedRigError(f"{why}shows the rigs that can be removed")
            raise UnknownRigError(f"there is no rig {name!r}; list them with: wrenchbook rig list")
        db.execute("DELETE FROM rigs WHERE name = ?", (name,))
        note(db, "rig.remove", name, before=before)


def _stored(db: Connection, name: str) -> str | None:
    row = db.execute("SELECT profile FROM rigs WHERE name = ?", (name,)).fetchone()
    return row[0] if row else None
