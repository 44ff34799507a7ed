"""What the solver of each set-up may be wrong by, in a folder: ``<component>/<fingerprint>.json``.

It is estimated with the first solve of a set-up, by the solver's process, and belongs to all rows
of it. Without a readable file error bars lack the discretisation error, replies name that, and the
next solve estimates it again.
"""

from __future__ import annotations

import json
import logging
import threading
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from wrenchbook.service.files.durable import write_whole_bytes
from wrenchbook.surrogate.solver_error import SolverError

_log = logging.getLogger(__name__)


class SolverErrors:
    """The estimates of a data directory; several processes may use it.

    Parameters
    ----------
    folder : path
        Made when the first estimate is kept.
    """

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._claimed: set[tuple[str, str]] = set()
        self._lock = threading.Lock()

    def claim(self, component: str, fingerprint: str) -> bool:
        """Return whether a solve that starts now shall estimate; one at a time in this process.

        So it shall where an older version's estimate lacks the growth of the error with the load.
        """
        key = component, fingerprint
        with self._lock:
            if key in self._claimed:
                return False
            known = self.read(*key)
            if known is not None and known.can_grow:
                return False
            self._claimed.add(key)
            return True

    def settle(self, component: str, fingerprint: str, estimate: Mapping[str, Any] | None) -> None:
        """Keep the estimate of an ended solve, or let the next one estimate; never raises."""
        try:
            if estimate is not None:
                SolverError(estimate)
                self._write(component, fingerprint, estimate)
        except (OSError, ValueError, TypeError) as error:
            _log.warning("%s: the solver's error was not kept: %s", component, error)
        finally:
            with self._lock:
                self._claimed.discard((component, fingerprint))

    def release(self, component: str, fingerprint: str) -> None:
        """Let the next solve estimate: the one that was to has ended without."""
        self.settle(component, fingerprint, None)

    def copy(self, component: str, fingerprint: str, other: str) -> None:
        """Give a component's copy, which has the same set-up, the same estimate.

        Raises
        ------
        OSError
            If it cannot be written.
        """
        known = self.read(component, fingerprint)
        if known is not None:
            self._write(other, fingerprint, known.values)

    def read(self, component: str, fingerprint: str) -> SolverError | None:
        """Return what is known of a set-up; None of one that was never estimated."""
        try:
            return SolverError(json.loads(self._path(component, fingerprint).read_bytes()))
        except FileNotFoundError:
            return None
        except (OSError, ValueError, TypeError, AttributeError) as error:
            _log.warning("%s: the solver's error cannot be read: %s", component, error)
            return None

    def _write(self, component: str, fingerprint: str, estimate: Mapping[str, Any]) -> None:
        path = self._path(component, fingerprint)
        path.parent.mkdir(parents=True, exist_ok=True)
        write_whole_bytes(path, json.dumps(dict(estimate), allow_nan=False).encode())

    def _path(self, component: str, fingerprint: str) -> Path:
        return self._folder / component / f"{fingerprint}.json"
