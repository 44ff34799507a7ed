"""What straight direction influence leaves out, as far as the rows show it.

The composition has no term for loads of different axes acting together, nor for the influence on
u_i of loads that are not axis i's. Both show in rows: a row clean for another axis shows u_i under
that axis' loads, a full wrench shows everything, a tangent shows it to first order. A polynomial
fitted to them (influence.py) is the error to be expected, with its sign; for what it misses the
bar grows with the loads as

    across_i * |off-axis loads| + together_k * product_k ** power_k

on scaled loads, product_k being the root of the sum of squares of the load products which output
k's composition has no term for. The factors cover 95 % of what the rows show.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from surrogate.bars.conformal import LEVEL, conformal_factor
from surrogate.influence import NO_INFLUENCE, Influence
from surrogate.table.axes import AXES
from surrogate.table.rows import Floats

POWERS = (1.0, 0.5)
ACROSS_LEVEL = 0.9
CAUTION = 10.0  # products of loads are seldom large in few rows


@dataclass(frozen=True)
class LeftOut:
    """Factors of the error bar's part for what the composition leaves out.

    Attributes
    ----------
    scale : tuple of float, length 6, N and N·m
        Half widths of the load range.
    across : tuple of float, length 3, m
        Per unit of scaled off-axis load, on u_x, u_y, u_z.
    together : tuple of float, length 6, m and rad
        Per unit of scaled load product.
    power : tuple of float, length 6
    shown : int
        How many full-wrench rows stand behind `together`.
    influence : Influence
        The polynomial.
    """

    scale: tuple[float, ...]
    across: tuple[float, ...] = (0.0,) * 3
    together: tuple[float, ...] = (0.0,) * 6
    power: tuple[float, ...] = (1.0,) * 6
    shown: int = 0
    influence: Influence = NO_INFLUENCE

    @property
    def silent(self) -> bool:
        """Whether no row shows that anything is left out."""
        return not (any(self.across) or any(self.together)) and self.influence.silent

    def widen(
        self, wrench: Sequence[float], spread: list[float], bent: list[float] | None = None
    ) -> None:
        """Add the squared bars for one wrench of floats to `spread`, length 6.

        What is to be expected is added to `bent`, length 6, with its sign, or its square to
        `spread` if that is None.
        """
        if any(self.across) or any(self.together):
            bars = self.bars_of(wrench)
            for output in range(6):
                spread[output] += bars[output] * bars[output]
        if not self.influence.silent:
            for output, share in enumerate(self.influence.at(wrench)):
                if bent is None:
                    spread[output] += share * share
                else:
                    bent[output] += share

    def widen_many(self, wrenches: Floats, spread: Floats, bent: Floats | None = None) -> None:
        """Do the same for wrenches (n, 6), `spread` and `bent` (n, 6)."""
        if any(self.across) or any(self.together):
            spread += self.bars(wrenches) ** 2
        if not self.influence.silent and bent is not None:
            bent += self.influence.many(wrenches)
        elif not self.influence.silent:
            spread += self.influence.many(wrenches) ** 2

    def bars_of(self, wrench: Sequence[float]) -> list[float]:
        """Return the six bars, m and rad, for one wrench of floats."""
        a, b, c, d, e, f = (w / s for w, s in zip(wrench, self.scale, strict=True))
        a, b, c, d, e, f = a * a, b * b, c * c, d * d, e * e, f * f
        off = (b + c + d, a + c + e, a + b + f)
        on = (a + e + f, b + d + f, c + d + e)
        pairs = (b * c, a * c, a * b)
        bars = []
        for axis in range(3):
            product = off[axis] * on[axis] + pairs[axis]
            together = self.together[axis] * product ** (0.5 * self.power[axis])
            bars.append(self.across[axis] * off[axis] ** 0.5 + together)
        turned = sum(pairs) + a * d + b * e + c * f + d * e * f
        bars.extend(self.together[k] * turned ** (0.5 * self.power[k]) for k in (3, 4, 5))
        return bars

    def bars(self, wrenches: Floats) -> Floats:
        """Return the bars, m and rad, for wrenches of shape (n, 6)."""
        off, product = _sizes(wrenches / np.array(self.scale))
        bars = np.array(self.together) * product ** np.array(self.power)
        bars[:, :3] += np.array(self.across) * off
        return bars


def _sizes(scaled: Floats) -> tuple[Floats, Floats]:
    """Return |off-axis loads| (n, 3) and the left-out products (n, 6) of scaled wrenches (n, 6)."""
    square = scaled**2
    force, moment = square[:, :3], square[:, 3:]
    pairs = np.stack([force[:, (i + 1) % 3] * force[:, (i + 2) % 3] for i in range(3)], axis=1)
    on = np.stack([square[:, list(axis.inputs)].sum(axis=1) for axis in AXES], axis=1)
    off = np.stack([square[:, axis.others].sum(axis=1) for axis in AXES], axis=1)
    turned = pairs.sum(axis=1) + (force * moment).sum(axis=1) + moment.prod(axis=1)
    product = np.concatenate((off * on + pairs, np.repeat(turned[:, None], 3, axis=1)), axis=1)
    return np.sqrt(off), np.sqrt(product)


def product_sizes(scaled: Floats) -> Floats:
    """Return the size of the load products that each output's composition leaves out, (n, 6)."""
    return _sizes(scaled)[1]


def across_axes(
    wrench: Floats, missed: Floats, clean: np.ndarray, scale: Floats
) -> tuple[float, ...]:
    """Return the factors `across` that rows clean for another axis show.

    `missed` is, for wrenches (n, 6), what neither the axes' own bars nor the polynomial explain,
    zero where nothing was composed; `clean` the (n, 3) mask of which row is clean for which axis.
    """
    off, _ = _sizes(wrench / scale)
    factors = []
    for axis in range(3):
        # Each other axis' rows by themselves: one of the two may have no influence at all.
        shown = [clean[:, other] & ~clean[:, axis] for other in range(3) if other != axis]
        factors.append(
            max(float(_factor(missed[rows, axis], off[rows, axis], ACROSS_LEVEL)) for rows in shown)
        )
    return tuple(factors)


def acting_together(
    left_out: LeftOut, wrench: Floats, missed: Floats
) -> tuple[tuple[float, ...], tuple[float, ...]]:
    """Return `together` and `power` from full wrenches (h, 6) and what was missed at them (h, 6).

    What `across` explains already is not counted twice; per output the power that makes the
    narrower bars is taken.
    """
    off, product = _sizes(wrench / np.array(left_out.scale))
    excess = np.abs(missed)
    excess[:, :3] = np.maximum(excess[:, :3] - np.array(left_out.across) * off, 0.0)
    factors, powers = [], []
    for output in range(6):
        tried = []
        for power in POWERS:
            size = product[:, output] ** power
            factor = float(_factor(excess[:, output], size))
            tried.append((factor * float(size.mean()), factor, power))
        _, factor, power = min(tried)
        factors.append(factor)
        powers.append(power)
    return tuple(factors), tuple(powers)


def _factor(missed: Floats, size: Floats, level: float = LEVEL) -> np.float64:
    """Return the factor on sizes (h,) which covers a level of what was missed (h,)."""
    if not len(missed):
        return np.float64(0.0)
    return conformal_factor(missed[:, None], size[:, None], level, CAUTION)[0]
