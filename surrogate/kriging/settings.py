"""Every constant of the kriging, each with its reason."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class KrigingSettings:
    """The constants of a kriging: what it estimates with, what it keeps, when it goes local.

    Lengths are in half ranges of the loads, variances in those of the outputs' own spread.
    """

    # Rounding of double precision at thousands of equations needs some 1e-12; 1e-10 leaves room and
    # is a deviation of 1e-5 of the spread, below what a surrogate of solves is asked for.
    nugget: float = 1e-10
    # A covariance that is singular even so (rows a hair apart, no slopes) is tried with ten times
    # the nugget, and again, up to a deviation of 1 % of the spread: beyond that it is a mistake.
    nugget_limit: float = 1e-4
    # Rows nearer than this, of the range in each load, are one row: their difference is rounding.
    same: float = 1e-6
    # A load beyond the range by no more than this of it counts as on its end.
    edge: float = 1e-9
    # Fewer rows than this leave nothing to calibrate a bar on once one is left out.
    least_rows: int = 4
    # The mean's coefficients have this variance: so wide that rows decide, but finite, so that
    # a load that no row varies gives a wide bar in place of a singular matrix.
    mean_variance: float = 1e6
    # An output that varies less than this of the largest of its kind (translations, rotations) is
    # a solver's rounding: it is answered, but has no say in the likelihood.
    rounding: float = 1e-9
    # Logarithms of the six inverse squared lengths: lengths of 33 to 0.14 half ranges. Longer is a
    # straight line, shorter than the distance of rows that anyone can pay for.
    theta_bounds: tuple[float, float] = (-7.0, 4.0)
    # Logarithm of the full kernel's weight: none of the response to nearly all of it.
    weight_bounds: tuple[float, float] = (-9.0, 5.0)
    # The two starts: lengths of 1.4 and of 0.7 half ranges, a full kernel of a third of an axis.
    theta_starts: tuple[float, ...] = (-0.7, 0.8)
    weight_start: float = -1.2
    # The likelihood costs the cube of its equations some fifty times over, and is flat: 420
    # equations of six outputs (60 solved rows, or 100 measured ones) settle seven numbers, in half
    # a second; with 210 errors were up to twice as large, measured over made-up responses.
    likelihood_rows: int = 100
    likelihood_equations: int = 420
    # Hyperparameters change little with a row: they are estimated anew when the table has grown
    # by a quarter.
    growth: float = 1.25
    likelihood_steps: int = 60
    # Steps end where the likelihood's relative change is below this: the bars do not see more.
    likelihood_accuracy: float = 1e-6
    # One dense factor up to here: 400 solved rows of seven equations, or 2,500 measured ones, take
    # about a second and 60 MB.
    dense_equations: int = 2800
    # sigma is taken from the nearest rows alone, up to so many rows and equations: 20 solved ones
    # are nearly as sharp as all (correlation 0.93 to 0.998, measured on a plate), and cost a fixed
    # 140 x 140 triangle; 40 measured ones keep the triangles of 2,500 rows within 32 MB.
    deviation_rows: int = 40
    deviation_equations: int = 140
    # Beyond one factor the mean and the process variances come from this many equations, spread
    # widely, and an answer solves for the nearest rows, up to so many rows and equations: 30 solved
    # ones take some 3 ms.
    mean_equations: int = 700
    local_rows: int = 100
    local_equations: int = 210
    # Answers at once, so that their covariances with 400 solved rows stay within 25 MB.
    chunk: int = 1000
    # Decimals of the logarithms that the estimate ends at: a length to 0.05 %, and the same one
    # whatever the units, whose rounding moves it by some 1e-8.
    decimals: int = 3
    # Outputs whose noise over process variance is within this factor share one factorisation.
    like_noise: float = 2.0
    # Left-out rows of a large table: enough for a 95 % quantile an output.
    left_out_rows: int = 400
    # Rows left out for a size of their errors of each output's own; below, one is pooled.
    rows_an_output: int = 20
    # With so many rows of more than one axis bars are calibrated on them alone: what is asked loads
    # all axes too, and rows at the corners of one axis err more (bars up to 16 x their errors).
    full_rows: int = 30
    level: float = 0.95
    # Left-out rows had their say in the hyperparameters, and few of them tell a tail badly: factors
    # widen by this over their number (a sixth at 30 rows). Of 45 tables of 15, 30 and 60 solves of
    # nine made-up responses 87, 80 and 73 % then hold 90 % of fresh errors in every output, and 96,
    # 84 and 87 % with 10; but from 7 on the median bar is over five times the median error
    # (`make bench-calibration`).
    widening: float = 5.0
    # What the sums over the rows lose to rounding, of an output's spread and of the value itself:
    # weights are up to 1e5 times what they sum to.
    bar_floor: float = 1e-11
    # Half width of 95 % over the deviation of a normal distribution.
    half_width: float = 1.96


DEFAULTS = KrigingSettings()
