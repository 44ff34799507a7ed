"""The mount: a rigid-body simulation that stands on a flexible component.

The MuJoCo mount is in `mujoco_mount`, the only file of the package that imports mujoco.
"""

from ..errors import CouplingDiverged, DisplacementUnknown, MountError, MountWarning, SensorError
from .coupling import spectral_radius, stable_factor
from .mount import Coverage, Mount, require_weight
from .statics import Settled

__all__ = [
    "CouplingDiverged",
    "Coverage",
    "DisplacementUnknown",
    "Mount",
    "MountError",
    "MountWarning",
    "SensorError",
    "Settled",
    "require_weight",
    "spectral_radius",
    "stable_factor",
]
