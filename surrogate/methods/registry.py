"""The methods of one table, each made when it is first asked for."""

from __future__ import annotations

import threading
from collections.abc import Callable

from ..answer import METHODS, UnknownMethodError
from .method import Method


class Registry:
    """Methods by name.

    Parameters
    ----------
    makers : dict of str to callable
        How to make each of `METHODS`.
    made : dict of str to Method, optional
        Those that are made already.
    """

    def __init__(
        self, makers: dict[str, Callable[[], Method]], made: dict[str, Method] | None = None
    ) -> None:
        self._makers = makers
        self._made = dict(made or {})
        self._lock = threading.Lock()

    def get(self, name: str) -> Method:
        """Return a method; threads that ask at once get the same one.

        Raises
        ------
        UnknownMethodError
            If it is none of `METHODS`.
        """
        found = self._made.get(name)
        if found is not None:
            return found
        self.check(name)
        with self._lock:
            if name not in self._made:
                self._made[name] = self._makers[name]()
            return self._made[name]

    def check(self, name: str) -> None:
        """Raise `UnknownMethodError` if a method is none of `METHODS`."""
        if name not in METHODS:
            raise UnknownMethodError(name)

    @property
    def made(self) -> dict[str, Method]:
        """The methods that answer at once."""
        return self._made.copy()
