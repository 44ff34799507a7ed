"""The caller of a request or a command: the actor of its writes, and its limits."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from fnmatch import fnmatchcase
from typing import Final, NamedTuple, Self

ANY: Final = ("*",)  # patterns that match all components
# Names of keys have no parentheses, and names of users begin with `USER`, so that no caller can
# have one of these names.
LOCAL: Final = "(local)"  # a command on the machine, on the data directory
ANONYMOUS: Final = "(anonymous)"  # a request to a server without keys
SERVER: Final = "(server)"  # actions of the server itself
USER: Final = "user:"  # prefix of names that a trusted proxy sends


class NotPermittedError(Exception):
    """The caller may not use this component or job; nothing was changed."""


class Caller(NamedTuple):
    """An actor, the patterns of its permitted components, and its rights on others' jobs."""

    actor: str
    components: tuple[str, ...]
    admin: bool  # may cancel jobs of others

    @classmethod
    def unlimited(cls, actor: str) -> Self:
        """Return an actor that may use all components and jobs."""
        return cls(actor, ANY, admin=True)

    def may_use(self, component: str) -> bool:
        """Return whether a component matches one of the patterns."""
        patterns = self.components
        return patterns == ANY or any(fnmatchcase(component, pattern) for pattern in patterns)

    def visible(self, component: str | None) -> str | None:
        """Return a component's name to show; None if there is none, or it may not be used."""
        return component if component and self.may_use(component) else None


_LOCAL_CALLER: Final = Caller.unlimited(LOCAL)
CALLER: ContextVar[Caller] = ContextVar("caller", default=_LOCAL_CALLER)
"""The caller of this context; threads of a server have the default, without limits."""


@contextmanager
def acting_as(actor: str) -> Iterator[None]:
    """Set another actor for writes, without limits, within a `with`."""
    token = CALLER.set(Caller.unlimited(actor))
    try:
        yield
    finally:
        CALLER.reset(token)
