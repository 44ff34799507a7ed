"""The Gaussian process over all rows of a table and the tangents that solved rows bring."""

from .correlation import Hyperparameters
from .equations import TooFewRowsError, TooManyRowsError
from .factor import SingularCovarianceError
from .kriging import Kriging, equation_count, fits_one_factor, too_large_in_words
from .settings import KrigingSettings

__all__ = [
    "Hyperparameters",
    "Kriging",
    "KrigingSettings",
    "SingularCovarianceError",
    "TooFewRowsError",
    "TooManyRowsError",
    "equation_count",
    "fits_one_factor",
    "too_large_in_words",
]
