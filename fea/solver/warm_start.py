"""States of solved wrenches on disk, to start nearby solves from.

One file a solve, its name the component's fingerprint and a digest of the wrench. A start changes
no answer (`fea.solver.load_steps`), so a file that cannot be read, or is of another mesh, is
passed over.
"""

from __future__ import annotations

import contextlib
import hashlib
import os
import zipfile
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from wrenchbook.fea.coupling.coupling import PER_INTERFACE, CoupledState
from wrenchbook.fea.solution import Solution

Array = np.ndarray

MOST_FILES = 32
_NEAR = 0.5  # of the wrench's own size: beyond that no load at all is as good a start
_UNREADABLE = (OSError, ValueError, KeyError, EOFError, zipfile.BadZipFile)


class WarmFolder:
    """The states kept for one component.

    Parameters
    ----------
    folder
        Made when the first state is kept. Several processes may share it.
    fingerprint
        The component's; files of other fingerprints are not looked at.
    scale
        Shape (k,), N and N·m of the loads, K of a temperature: inputs are near or far in units of
        it.
    """

    def __init__(self, folder: Path, fingerprint: str, scale: Array) -> None:
        self._folder = folder
        self._fingerprint = fingerprint
        self._scale = np.where(np.asarray(scale) > 0, scale, 1.0)

    def nearest(self, wrench: Array, points: int) -> CoupledState | None:
        """Return the state of the nearest wrench kept, if one is near.

        Parameters
        ----------
        wrench
            Shape (k,): all inputs.
        points
            Number of points of the mesh.
        """
        wrench = np.asarray(wrench, dtype=float) / self._scale
        limit = _NEAR * float(np.linalg.norm(wrench))
        kept = [(float(np.linalg.norm(w / self._scale - wrench)), p) for p, w in self._wrenches()]
        for distance, path in sorted(kept, key=lambda pair: pair[0]):
            if distance > limit:
                return None
            state = _read_state(path, points, self._scale.size)
            if state is not None:
                return state
        return None

    def keep(self, solution: Solution) -> None:
        """Keep the state of a solution, and only the newest few in all; never raises."""
        if solution.state is None:
            return
        wrench = np.asarray(solution.wrench, dtype=float)
        digest = hashlib.sha256(wrench.tobytes()).hexdigest()[:16]
        path = self._folder / f"{self._fingerprint}-{digest}.npz"
        part = path.with_suffix(f".{os.getpid()}.part")
        with contextlib.suppress(OSError):
            self._folder.mkdir(parents=True, exist_ok=True)
            with part.open("wb") as file:
                np.savez(file, wrench=wrench, **vars(solution.state))
            part.replace(path)
            for old in self._files()[MOST_FILES:]:
                old.unlink(missing_ok=True)

    def _files(self) -> list[Path]:
        """Return the component's files, the newest first."""
        dated = []
        for path in self._folder.glob(f"{self._fingerprint}-*.npz"):
            with contextlib.suppress(OSError):
                dated.append((path.stat().st_mtime_ns, path))
        return [path for _, path in sorted(dated, reverse=True)]

    def _wrenches(self) -> Iterator[tuple[Path, Array]]:
        for path in self._files():
            with (
                contextlib.suppress(*_UNREADABLE),
                path.open("rb") as raw,
                np.load(raw, allow_pickle=False) as file,
            ):
                wrench = file["wrench"]
                if wrench.shape == self._scale.shape and np.isfinite(wrench).all():
                    yield path, wrench


def _read_state(path: Path, points: int, inputs: int) -> CoupledState | None:
    try:
        with path.open("rb") as raw, np.load(raw, allow_pickle=False) as file:
            state = CoupledState(file["nodes"], file["interface"], file["multipliers"])
    except _UNREADABLE:
        return None
    arrays = tuple(vars(state).values())
    loads = inputs - inputs % PER_INTERFACE
    if [a.shape for a in arrays[:2]] != [(points, 3), (loads,)] or state.multipliers.ndim != 1:
        return None
    sound = all(a.dtype == float and np.isfinite(a).all() for a in arrays)
    return state if sound else None
