"""What crosses between a dispatcher's machine and a worker's: plain words, numbers and bytes.

Both sides import this; nothing here needs Dask.
"""

import json
from dataclasses import asdict, dataclass
from importlib.metadata import PackageNotFoundError, version
from typing import Any, Literal, TypedDict

from service.jobs.attempt import Spec

TOPIC = "wrenchbook-progress"
"""The scheduler's topic under which workers tell how far their solvers are."""

WORKER_MODULE = "service.jobs.engines.on_worker"


How = Literal["ended", "died", "wants", "unfit"]


class Reply(TypedDict):
    """What comes back of an order.

    ``how`` is ``ended`` (``files`` hold result.json and the log), ``died`` (the solver left no
    result.json; the log's last line is the cause), ``wants`` (the bundle is not on that worker) or
    ``unfit`` (the worker cannot work, ``why``).
    """

    how: How
    worker: str
    files: dict[str, bytes]
    why: str


def reply(how: How, worker: str, files: dict[str, bytes] | None = None, why: str = "") -> Reply:
    """Return what a worker answers an order."""
    return {"how": how, "worker": worker, "files": files or {}, "why": why}


@dataclass(frozen=True)
class Order:
    """One attempt as a worker is asked for it.

    Attributes
    ----------
    task : str
        The attempt's task key.
    spec : Spec
        What it solves; where its bundle is is the worker's affair.
    bundle : str
        The digest of the component's files.
    deadline : float or None
        Seconds from the solver's first instruction.
    memory : int or None
        Bytes a solve takes.
    cores : int
        Cores a solver uses.
    """

    task: str
    spec: Spec
    bundle: str
    deadline: float | None
    memory: int | None
    cores: int

    def to_bytes(self) -> bytes:
        """Return it as it is sent."""
        return json.dumps(asdict(self)).encode()

    @classmethod
    def from_bytes(cls, sent: bytes) -> "Order":
        """Return what was sent."""
        fields: dict[str, Any] = json.loads(sent)
        spec = fields.pop("spec")
        spec["wrench"] = tuple(spec["wrench"])
        return cls(spec=Spec(**spec), **fields)


def program_version() -> str:
    """Return the version of this program; workers of another one are given nothing to do."""
    try:
        return version("wrenchbook")
    except PackageNotFoundError:
        return "unknown"
