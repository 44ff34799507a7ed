"""Where a rigid-body simulation stands on a component that bends.

The MuJoCo mount is in `mujoco_mount`, which alone imports mujoco.
"""

from ..errors import CouplingDiverged, DisplacementUnknown, MountError, MountWarning, SensorError
from .coupling import Settled, spectral_radius, stable_factor
from .mount import Coverage, Mount, require_weight

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
