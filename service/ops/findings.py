"""What a look at a data directory finds."""

from __future__ import annotations

import time
from dataclasses import dataclass
from pathlib import Path
from typing import Literal


@dataclass(frozen=True)
class Finding:
    """One thing found.

    Attributes
    ----------
    kind : str
        ``fault`` needs mending, ``mended`` has been, ``note`` is good to know.
    what : str
    remedy : str
        What to do about it.
    """

    kind: Literal["fault", "mended", "note"]
    what: str
    remedy: str = ""


MEND = "mend it with: wrenchbook doctor --mend"


def move_aside(path: Path, why: str = "damaged") -> Path:
    """Give a file a name that nothing reads, beside where it was: it may be the only copy."""
    stamp = f"{time.strftime('%Y%m%dT%H%M%SZ', time.gmtime())}-{time.time_ns() % 10**6:06d}"
    return path.rename(path.with_name(f"{path.name}.{why}-{stamp}"))
