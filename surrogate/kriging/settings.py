"""The constants of a kriging and of the calibration of its error bars, each with its reason."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class KrigingSettings:
    """The constants of a kriging: of its estimates, its sizes, its calibration.

    Lengths are in half ranges of the loads, variances in those of the outputs' own spread.
    """

    # Rounding of double precision at thousands of equations needs some 1e-12; 1e-10 leaves room and
    # is a deviation of 1e-5 of the spread, below any tolerance of a surrogate of solves. It is in
    # every error bar: without it bars of nearly linear parts were missed by up to 26 times.
    nugget: float = 1e-10
    # A covariance that is singular even so (rows at almost the same wrench, no slopes) is tried
    # with ten times the nugget, and again, up to a deviation of 1 % of the spread: beyond that it
    # is a mistake.
    nugget_limit: float = 1e-4
    # With fewer rows nothing calibrates an error bar once a row is left out.
    min_rows: int = 4
    # The mean's coefficients have this variance: so wide that rows decide, but finite, so that
    # a load that no row varies gives a wide bar in place of a singular matrix.
    mean_variance: float = 1e6
    # An output whose variation is below this part of the largest of its kind (translations,
    # rotations) is a solver's rounding: it is answered, but does not count in the likelihood.
    rounding: float = 1e-9
    # Logarithms of the six inverse squared lengths: lengths of 33 to 0.14 half ranges. Longer is a
    # straight line, shorter than the distance of rows that anyone can pay for.
    theta_bounds: tuple[float, float] = (-7.0, 4.0)
    # Logarithm of the full kernel's weight: none of the response to nearly all of it.
    weight_bounds: tuple[float, float] = (-9.0, 5.0)
    # The two starts: lengths of 1.4 and of 0.7 half ranges, a full kernel of a third of an axis.
    theta_starts: tuple[float, ...] = (-0.7, 0.8)
    weight_start: float = -1.2
    # Logarithm of noise over the process variance, where it is tried: from none that the nugget
    # would not hide to ten times the deviation of the response, in steps of half the deviation that
    # 100 rows leave of it.
    ratio_bounds: tuple[float, float] = (-23.0, 4.6)
    ratio_step: float = 0.75
    # Prior: mean and deviation of the logarithm of an unknown noise's variance, over
    # the spread's (1 % of it, within a factor of 10), of the factor on a stated one (a factor of 3
    # on the uncertainty), and of inverse squared lengths (1.6 half ranges, within a factor of 2).
    # Without the last the most likely kernels are straight in most loads, and what they bend by is
    # taken for noise: 28 % of errors were outside in one output of `smooth`, 12 % with it.
    noise_prior: tuple[float, float] = (-9.2, 4.6)
    stated_prior: tuple[float, float] = (0.0, 2.3)
    length_prior: tuple[float, float] = (-1.0, 1.5)
    # Noise is averaged over the most likely kernel and these, of shorter and longer lengths: e to
    # half of it times. Those of less than a fiftieth of the posterior change nothing.
    length_shifts: tuple[float, ...] = (-3.0, -2.0, -1.0, 0.0, 1.0, 2.0, 3.0)
    min_probability: float = 0.02
    # Number of equations of the search for lengths of an output; the noise uses the number below.
    search_equations: int = 210
    # The likelihood costs the cube of its equations some fifty times over, and is flat: 420
    # equations of six outputs (60 solved rows, or as many measured ones) determine seven numbers,
    # in half a second; with 210 errors were up to twice as large, measured over synthetic
    # responses. 100 measured rows are too few: there noise and short lengths look alike.
    likelihood_equations: int = 420
    likelihood_steps: int = 60
    # The search ends where the likelihood's relative change is below this: bars do not change.
    likelihood_accuracy: float = 1e-6
    # Largest dense factor: 400 solved rows of seven equations, or 2,500 measured ones, take about a
    # second and 60 MB.
    dense_equations: int = 2800
    # Largest number of nearest rows, and of nearest solved rows, for sigma: 20 solved rows are
    # nearly as sharp as all (correlation 0.93 to 0.998, measured on a plate), and cost a fixed 140
    # x 140 triangle; 40 measured ones keep the triangles of 2,500 rows within 32 MB.
    deviation_rows: int = 40
    deviation_solves: int = 20
    # Up to this number of measured rows sigma is computed from all rows: a triangle of 4 MB an
    # output. By the 40 nearest of 800 rows with 1 % noise bars were 7 to 9 times the errors, by all
    # 3 to 4 times.
    global_rows: int = 1000
    # More measured rows than `many_rows` use inducing wrenches, if at most `inducing` of them leave
    # little variance beside the noise: 75 of 900 and 252 of 100,000 rows with 0.3 % noise.
    many_rows: int = 400
    inducing: int = 1000
    # Of more measured rows this number is chosen evenly: a tenth of a millisecond each, and they
    # determine the mean to a fortieth of their noise.
    most_rows: int = 100_000
    # Number of nearest solved rows whose second derivatives count too: 2 of 12 rows (126 equations)
    # give bars of 60 solves that are 1.1 times as wide as those of 20 rows with all (560
    # equations); 5 of 5 (140) are 1.6 times as wide.
    deviation_curved: int = 2
    # Answers computed at once: their covariances with 400 solved rows stay within 25 MB.
    chunk: int = 1000
    # Decimals of the logarithms of the estimate: a length to 0.05 %, independent of the units,
    # whose rounding moves it by some 1e-8.
    decimals: int = 3
    # Outputs whose noise over process variance is within this factor share one factorisation.
    like_noise: float = 2.0
    # Number of rows left out: enough for a 95 % quantile of six outputs, which share their tail.
    left_out_rows: int = 200
    # Random wrenches that stand for queries: their median is known to a tenth of its size.
    queries: int = 256
    # A left-out row is as far from the rest as queries are if its deviation is 0.6 of the median at
    # random wrenches: it lies a row distance from the others, they lie between rows. With 0.5 and
    # 0.8 as many bars hold, over nine made-up responses and three parts.
    comparable: float = 0.6
    # With fewer left-out rows errors are not known: with four a fifth more tables cover too much.
    min_left_out: int = 6
    # Quantile of neighbourhoods' deviations over those of the full factor that stands for all: with
    # the median 4 of 59 tables of 30 to 120 rows held below 90 % in one output, with this 2.
    neighbourhood_quantile: float = 0.4
    # From this number of rows that load several axes, these alone show the errors of wrenches of
    # several axes; fewer show no tail (with 4 to 10 rows 32 to 43 % of the covered are outside in
    # one output; with 15, 11 %).
    full_rows: int = 15
    # Probability that evenly spread rows leave a larger gap beyond the outermost rows than the
    # assumed one: with six loads of two ends each, one end in nine tables.
    beyond_rows: float = 0.01
    # Part of an output's mean: a solver's own rounding in an output that does not vary.
    error_floor: float = 1e-11
    # Half width of 95 % over the deviation of a normal distribution.
    half_width: float = 1.96
    # Half width of 95 % over the posterior deviation of noisy rows, whose covariance is of one
    # kind: with 1.96 the worst output of 7 in 19 tables had 10 to 11 % outside, and bars were 3.6
    # times the errors.
    posterior_width: float = 2.1


DEFAULTS = KrigingSettings()
