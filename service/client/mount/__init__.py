"""The mount: a rigid-body simulation that stands on a flexible component.

The MuJoCo mount is in `mujoco_mount`, the only file of the package that needs MuJoCo.
"""

from ..errors import CouplingDiverged, DisplacementUnknown, MountError, MountWarning, SensorError
from .mount import Mount
from .statics import Settled

__all__ = [
    "CouplingDiverged",
    "DisplacementUnknown",
    "Mount",
    "MountError",
    "MountWarning",
    "SensorError",
    "Settled",
]
