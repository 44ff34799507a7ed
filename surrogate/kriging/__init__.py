"""The Gaussian process over all rows of a table and the tangents that solved rows bring."""

from .correlation import Hyperparameters
from .equations import TooFewRowsError
from .factor import SingularCovarianceError
from .kriging import Kriging
from .settings import KrigingSettings

__all__ = [
    "Hyperparameters",
    "Kriging",
    "KrigingSettings",
    "SingularCovarianceError",
    "TooFewRowsError",
]
