"""The caller of a request or a command: the actor that its writes name, and its limits."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from fnmatch import fnmatchcase
from typing import Final, NamedTuple

ANY: Final = ("*",)  # patterns that all components match
# Names of keys have no parentheses, names of users begin with `USER`: no caller has one of these.
LOCAL: Final = "(local)"  # a command on the machine, in the data directory
ANONYMOUS: Final = "(anonymous)"  # a request to a server without keys
SERVER: Final = "(server)"  # what a server does by itself
USER: Final = "user:"  # before the name that a trusted proxy sends


class NotPermittedError(Exception):
    """The caller may not touch this component or job; nothing was changed."""


class Caller(NamedTuple):
    """An actor, the patterns of the components that it may touch, and its scope of others' jobs."""

    actor: str
    components: tuple[str, ...] = ANY
    admin: bool = True  # may cancel jobs of others

    def touches(self, component: str) -> bool:
        """Return whether a component matches one of the patterns."""
        patterns = self.components
        return patterns == ANY or any(fnmatchcase(component, pattern) for pattern in patterns)

    def visible(self, component: str | None) -> str | None:
        """Return a component's name; None if the caller may not touch it."""
        return component if component and self.touches(component) else None


CALLER: ContextVar[Caller] = ContextVar("caller", default=Caller(LOCAL))  # noqa: B039 (a tuple)
"""The caller that this context works for; threads of a server have the default, without limits."""


@contextmanager
def acting_as(actor: str) -> Iterator[None]:
    """Let writes name another actor, which has no limits."""
    token = CALLER.set(Caller(actor))
    try:
        yield
    finally:
        CALLER.reset(token)
