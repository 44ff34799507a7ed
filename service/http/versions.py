"""The version of a table as HTTP names it: entity tags (RFC 9110, section 8.8.3)."""

from __future__ import annotations


def naming(tag: str) -> dict[str, str]:
    """Return the headers that name a table's version; no cache may serve it unasked."""
    return {"ETag": tag, "Cache-Control": "no-cache"}


def holds(if_none_match: str | None, tag: str) -> bool:
    """Tell whether the sender has this version (RFC 9110, section 13.1.2)."""
    tags = [tag.strip().removeprefix("W/") for tag in (if_none_match or "").split(",")]
    return tag in tags or "*" in tags
