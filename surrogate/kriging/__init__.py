"""The Gaussian process over all rows of a table and the tangents that solved rows bring."""

from surrogate.kriging.correlation import Hyperparameters
from surrogate.kriging.equations import TooFewRowsError
from surrogate.kriging.factor import SingularCovarianceError
from surrogate.kriging.kriging import Kriging
from surrogate.kriging.settings import KrigingSettings

__all__ = [
    "Hyperparameters",
    "Kriging",
    "KrigingSettings",
    "SingularCovarianceError",
    "TooFewRowsError",
]
