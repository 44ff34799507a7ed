"""The component that a solver keeps from one attempt to the next."""

import hashlib
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from wrenchbook.fea.bundle.read import FILE_NAME, read_bundle
from wrenchbook.fea.check.cost import estimate
from wrenchbook.fea.component import build
from wrenchbook.fea.export.failure_record import keep
from wrenchbook.fea.failure import SolveFailed
from wrenchbook.fea.solve import Solver
from wrenchbook.fea.spec.schema import Bundle
from wrenchbook.service.files.program import MARGIN_VARIABLE, limit_memory
from wrenchbook.service.jobs.attempt import Spec
from wrenchbook.service.jobs.solve_attempt import (
    Report,
    SolveRefusedError,
    require_same,
    solve_ready,
)


class KeptComponent:
    """A component with its mesh, order of elimination, first factor and linear response.

    What is kept is used for exactly the bundle it was made from: every attempt reads the bundle
    again, hashes its files, and compares. After an attempt that failed it is built again, so that
    nothing a broken-off solve has touched is used again.

    Attributes
    ----------
    estimated : int
        Bytes a solve of it takes by the check's estimate; 0 without a component.
    ready : Solver or None
        What is kept.
    spoiled : bool
        Whether memory ran out: its state is then undefined.
    """

    def __init__(self) -> None:
        self.spoiled = False
        self._key: tuple[str, str, bytes] | None = None
        self.ready: Solver | None = None
        self.estimated = 0
        self._limited: tuple[int | None, int | None] = None, None

    def solve(
        self, spec: Spec, report: Report, folder: Path, memory: int | None = None
    ) -> Mapping[str, Any]:
        """Solve an attempt as `service.jobs.solve_attempt.solve_embedded` does, to the last bit.

        Parameters
        ----------
        folder : path
            Where the files of an outside solver and of a failed solve stay.
        memory : int, optional
            Estimated bytes of a solve, for as long as the component is not built.

        Raises
        ------
        SolveRefusedError
            ``component_changed``, or ``out_of_memory`` with the limit that was hit.
        """
        bundle = read_bundle(Path(spec.bundle))
        require_same(spec, bundle.fingerprint)
        if bundle.deck is not None:
            limit_memory(None)  # the outside solver would inherit it, and its needs are unknown
            return solve_ready(bundle, spec, report, folder)
        try:
            self._limit(self.estimated or memory)
            ready = self._made_ready(bundle, spec, folder)
            self._limit(self.estimated)
            return solve_ready(ready, spec, report, folder)
        except MemoryError as error:
            self.spoiled = True
            raise _out_of_memory(*self._limited) from error
        except BaseException:
            self._drop()
            raise

    def _made_ready(self, bundle: Bundle, spec: Spec, folder: Path) -> Solver:
        key = _key_of(bundle)
        if self.ready is not None and key == self._key:
            return self.ready
        self._drop()
        component = build(bundle)
        # What was hashed has been read once more since: an edit in between would stay here for all
        # attempts to come.
        require_same(spec, read_bundle(bundle.folder).fingerprint)
        self.estimated = estimate(component)["memory_bytes"]
        self._limit(self.estimated)
        try:
            self.ready, self._key = Solver(component), key
        except SolveFailed as failure:
            keep(folder, failure, component)
            raise
        return self.ready

    def _limit(self, estimated: int | None) -> None:
        self._limited = estimated, limit_memory(estimated)

    def _drop(self) -> None:
        self._key, self.ready, self.estimated = None, None, 0


def _key_of(bundle: Bundle) -> tuple[str, str, bytes]:
    # The fingerprint leaves out what changes no answer but may change a note (the load range).
    text = (bundle.folder / FILE_NAME).read_bytes()
    return str(bundle.folder), bundle.fingerprint, hashlib.sha256(text).digest()


def _out_of_memory(estimated: int | None, limit: int | None) -> SolveRefusedError:
    if not estimated or not limit:
        return SolveRefusedError(
            "out_of_memory",
            "the machine has no memory left for this solve",
            "use fewer solvers at a time or a coarser mesh",
        )
    return SolveRefusedError(
        "out_of_memory",
        f"the solve needs more than the {limit / 1e9:.2g} GB it may take, "
        f"{limit / estimated:.2g} times its estimate of {estimated / 1e9:.2g} GB",
        "use a coarser mesh; or, if the machine has the memory, serve with a larger "
        f"{MARGIN_VARIABLE} (now {limit / estimated:.2g})",
    )
