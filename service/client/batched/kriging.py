"""The Gaussian process of a packed table on arrays: the law of surrogate/kernel/wb_kriging.c."""

from __future__ import annotations

from collections.abc import Mapping
from itertools import combinations_with_replacement
from typing import Any

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]

PANEL = 16  # rows of a panel of a packed triangle: surrogate/packed/kriging_arrays.py
TIE = 1e-10  # of squared distances: rows as near as this are equally near (wb_kriging.c)
CHUNK = 1024  # wrenches at once, of values and slopes: covariances stay in the processor's caches
BLOCK = 64  # wrenches of one neighbourhood that one product takes, at most
LEAST = 1e-30  # of squared distances: the square root has a finite derivative from there on


class Kriging:
    """Values, derivatives and interpolation errors of n inputs and m outputs.

    Parameters
    ----------
    own : Backend
        Of `jax` or `torch`.
    arrays : mapping
        Those of surrogate/packed/kriging_arrays.py.
    """

    def __init__(self, own: Any, arrays: Mapping[str, Any]) -> None:
        self.own, self.xp = own, own.xp
        inputs, stride = arrays["x"].shape
        self.x = own.put(arrays["x"])
        self.weights = own.put(arrays["weights"].T)
        self.coefficients, self.centre, self.rate, self.offset, self.spread, self.deviation = (
            own.put(arrays[name])
            for name in ("coefficients", "centre", "rate", "offset", "spread", "deviation")
        )
        self.tangent, self.span = own.put(arrays["tangent"]), own.put(arrays["span"])
        # The table states what sums lose in float64; no error bar is below it.
        self.lost = own.put(arrays["lost"] * (own.rounding / float(np.finfo(float).eps)))
        self.floor, self.inputs, self.stride = float(arrays["floor"][0]), inputs, stride
        self.bent = "smoothness" in arrays
        self.pairs = list(combinations_with_replacement(range(inputs), 2))
        readings = arrays["weights"].shape[1] // stride
        self.chunk = max(CHUNK * (1 + inputs) // readings, 1)
        # By covariance: its terms, which outputs it is of, and the shares of these.
        self.covariances: list[tuple[Floats, Any, list[dict[str, Any]]]] = []
        for number in range(int(arrays["shares"][0])):
            terms = arrays.get(f"share{number}/own_terms", arrays["terms"])
            share = _share(own, arrays, number)
            if self.covariances and self.covariances[-1][0] is terms:
                _, outputs, shares = self.covariances.pop()
                self.covariances.append((terms, outputs | share["outputs"], [*shares, share]))
            else:
                self.covariances.append((terms, share["outputs"], [share]))

    def values(self, w: Any) -> Any:
        """Return the outputs (k, m), m and rad, at inputs (k, n), SI."""
        return self.own.chunks(lambda part: (self._values(part),), self.chunk, w)[0]

    def slopes(self, w: Any) -> Any:
        """Return the derivatives (k, m, n), SI, at inputs (k, n), SI."""
        return self.own.chunks(lambda part: (self._slopes(part),), self.chunk, w)[0]

    def _values(self, w: Any) -> Any:
        at = self._scaled(w)
        normal = self.xp.zeros_like(w[:, :1] + self.offset)
        for covariance, outputs, _ in self.covariances:
            flat, _ = self._covariances(at, covariance)
            normal = self.xp.where(outputs, self._normal(flat, at), normal)
        return normal * self.spread + self.offset

    def _scaled(self, w: Any) -> Any:
        return (w - self.centre) * self.rate

    def _normal(self, flat: Any, at: Any) -> Any:
        """Return outputs less `offset` over `spread`, (k, m), from covariances and scaled loads."""
        return flat @ self.weights + self.coefficients[0] + at @ self.coefficients[1:]

    def _correlations(self, at: Any, covariance: Floats) -> tuple[list[Any], list[tuple[Any, ...]]]:
        """Return distances (k, s) by each load and, by term, what Matern's correlation is made of.

        With c = (1 + a + 2/5 a^2 + a^3/15) exp(-a) and a^2 = 7 q these are c, -2 dc/dq and
        4 d²c/dq², (k, s) each, dimensionless. With second derivatives they are those of
        c = (1 + a + 3/7 a^2 + 2/21 a^3 + a^4/105) exp(-a) and a^2 = 9 q, and -8 d³c/dq³.
        """
        xp, found = self.xp, []
        apart = [at[:, load, None] - self.x[load] for load in range(self.inputs)]
        for *rates, prior in covariance.tolist():
            squares = [rate * d * d for rate, d in zip(rates, apart, strict=True) if rate > 0]
            q = sum(squares) if squares else xp.zeros_like(apart[0])
            a = xp.sqrt((9.0 if self.bent else 7.0) * xp.clip(q, LEAST, None))
            decay = xp.exp(-a) * prior
            two = (1 + a) * decay
            three = (1 + a + a * a * (1 / 3)) * decay
            four = (1 + a + 0.4 * a * a + a * a * a * (1 / 15)) * decay
            if self.bent:
                five = 1 + a + a * a * (3 / 7) + a * a * a * (2 / 21) + (a * a) * (a * a) / 105
                found.append((five * decay, 9 / 7 * four, 81 / 35 * three, 243 / 35 * two))
            else:
                found.append((four, 1.4 * three, 49 / 15 * two))
        return apart, found

    def _covariances(self, at: Any, covariance: Floats) -> tuple[Any, list[Any]]:
        """Return the covariances of a value with the p readings of rows, (k, p s).

        Also the distances by each load, (k, s) each; all are dimensionless, as are the
        covariance's terms (t, n + 1).
        """
        apart, terms = self._correlations(at, covariance)
        by_load = [self._sum(covariance, terms, 1, load) for load in range(self.inputs)]
        flat = [sum(term[0] for term in terms)]
        flat += [one * d for one, d in zip(by_load, apart, strict=True)]
        for a, b in self.pairs if self.bent else ():
            second = self._sum(covariance, terms, 2, a, b) * apart[a] * apart[b]
            flat.append(second - by_load[a] if a == b else second)
        return self.xp.concatenate(flat, axis=1), apart

    def _sum(self, covariance: Floats, terms: list[Any], which: int, *loads: int) -> Any:
        """Return the sum over the terms, each times its rates of some loads, (k, s)."""
        rates = covariance[:, list(loads)].prod(axis=1).tolist()
        found = [rate * term[which] for rate, term in zip(rates, terms, strict=True) if rate > 0]
        return sum(found) if found else self.xp.zeros_like(terms[0][0])

    def _slopes(self, w: Any) -> Any:
        at = self._scaled(w)
        normal = self.xp.zeros_like(at[:, :, None] + self.offset)
        for covariance, outputs, _ in self.covariances:
            found = self._normal_slopes(at, covariance)
            normal = self.xp.where(outputs, found, normal)
        slopes = self.xp.einsum("kaq,q,a->kqa", normal, self.spread, self.rate)
        return slopes + self.tangent

    def _normal_slopes(self, at: Any, covariance: Floats) -> Any:
        """Return the derivatives of outputs over `spread` by scaled loads, (k, n, m)."""
        apart, terms = self._correlations(at, covariance)
        loads = range(self.inputs)
        by_load = [self._sum(covariance, terms, 1, load) for load in loads]
        both = {pair: self._sum(covariance, terms, 2, *pair) for pair in self.pairs}
        both |= {(b, a): one for (a, b), one in both.items()}
        flat = []
        for c in loads:
            own = [-by_load[c] * apart[c]]
            for a in loads:
                second = both[a, c] * apart[a] * apart[c]
                own.append(by_load[c] - second if a == c else -second)
            for a, b in self.pairs if self.bent else ():
                third = self._sum(covariance, terms, 3, a, b, c)
                third = -third * apart[a] * apart[b] * apart[c]
                # where two of the three loads are one
                for one, other, left in ((a, b, c), (a, c, b), (b, c, a)):
                    third = third + both[one, left] * apart[left] if one == other else third
                own.append(third)
            flat.append(self.xp.concatenate(own, axis=1))
        return self.xp.stack(flat, axis=1) @ self.weights + self.coefficients[1:]

    def errors(self, w: Any) -> Any:
        """Return 95 % interpolation errors (k, m), m and rad, at inputs (k, n); NaN if unknown."""
        xp, at = self.xp, self._scaled(w)
        spanned = ((self.span[0] <= at) & (at <= self.span[1])).all(axis=1)
        normal = wide = xp.zeros_like(w[:, :1] + self.offset)
        for covariance, outputs, shares in self.covariances:
            flat, apart = self._covariances(at, covariance)
            normal = xp.where(outputs, self._normal(flat, at), normal)
            for share in shares:
                distance = sum(share["rates"][a] * d * d for a, d in enumerate(apart))
                distance = distance + share["penalty"]
                closest = xp.argmin(distance, axis=1)[:, None]
                near = distance <= self.own.along(distance, closest, 1) + TIE
                anchor = xp.argmax(self.own.whole(near), axis=1)
                sigma = xp.sqrt(self._squared_deviation(share, anchor, flat, at))
                own = sigma[:, None] * self._factors(share, sigma)
                own = xp.where(spanned[:, None], own, np.nan)
                wide = xp.where(share["outputs"], own, wide)
        size = (abs(normal) + 1.0) * self.spread + abs(self.offset)
        least = xp.maximum(self.floor * size, self.lost + xp.zeros_like(size))
        wide = wide * self.deviation
        return xp.where(wide < least, least, wide)

    def _factors(self, share: Mapping[str, Any], sigma: Any) -> Any:
        """Return what deviations (k,) are multiplied by for 95 % errors, (k, m); NaN if unknown."""
        xp, levels, factors = self.xp, share["sigma"], share["factors"]
        last = levels.shape[0] - 1
        if last < 0:
            return sigma[:, None] * np.nan + self.offset * np.nan
        if last < 1:
            found = factors[0] + 0.0 * sigma[:, None]
        else:
            place = xp.clip((levels <= sigma[:, None]).sum(axis=1) - 1, 0, last - 1)
            low, high = levels[place], levels[place + 1]
            part = xp.clip((sigma - low) / (high - low), 0.0, 1.0)[:, None]
            found = factors[place] + part * (factors[place + 1] - factors[place])
        return xp.where((sigma <= share["reach"])[:, None], found, np.nan)

    def _squared_deviation(self, share: Mapping[str, Any], anchor: Any, flat: Any, at: Any) -> Any:
        """Return sigma squared over the process variance, (k,), by the neighbourhoods of rows (k,).

        Wrenches are sorted into blocks of one neighbourhood each, since products of matrices are
        faster than a triangle for each wrench.
        """
        own, xp = self.own, self.xp
        count, hoods = flat.shape[0], share["triangles"].shape[0]
        size = min(max(2 * count // hoods, 1), BLOCK)
        blocks = (count + min(count, hoods) * (size - 1)) // size
        hood = share["number"][anchor]
        order = xp.argsort(hood)
        held = own.whole(hood[:, None] == own.arange(hoods)).sum(axis=0)  # wrenches of each
        padded = (held + size - 1) // size * size
        first, start = xp.cumsum(held, axis=0) - held, xp.cumsum(padded, axis=0) - padded
        ends = start + padded
        slots = own.arange(blocks * size).reshape(blocks, size)
        of_block = xp.clip((ends <= slots[:, :1]).sum(axis=1), 0, hoods - 1)
        sorted_at = slots - (start - first)[of_block][:, None]
        wrench = order[xp.clip(sorted_at, 0, count - 1)]
        chosen = own.along(flat[wrench], share["places"][of_block][:, None, :], 2)
        reduced = chosen @ share["triangles"][of_block]
        settled = reduced @ share["unsettled"][of_block]
        slot = (start - first)[hood] + xp.argsort(order)
        spent = (reduced * reduced).sum(axis=2).reshape(-1)[slot]
        terms = xp.concatenate((xp.ones_like(at[:, :1]), at), axis=1)
        left = terms - settled.reshape(blocks * size, -1)[slot]
        loose = ((left @ share["mean_covariance"]) * left).sum(axis=1)
        return xp.maximum(share["prior"] - spent, share["least"][anchor]) + loose


def _share(own: Any, arrays: Mapping[str, Any], number: int) -> dict[str, Any]:
    """Return the arrays of one factor, its triangles whole and transposed: (h, e, e)."""
    share = {
        name.partition("/")[2]: array
        for name, array in arrays.items()
        if name.startswith(f"share{number}/")
    }
    panels, size = share.pop("panels"), share["places"].shape[1]
    triangles, at = np.zeros((len(panels), size, size)), 0
    for top in range(0, size, PANEL):
        end = top + PANEL
        panel = panels[:, at : at + PANEL * end].reshape(-1, end, PANEL)
        triangles[:, :end, top:end] = panel
        at += PANEL * end
    share["unsettled"] = share["unsettled"].transpose(0, 2, 1)
    share["outputs"] = share["outputs"].astype(bool)
    share["rates"] = share.pop("own_rates", arrays["rates"])
    share["prior"] = share.pop("own_terms", arrays["terms"])[:, -1].sum()
    return {name: own.put(one) for name, one in (share | {"triangles": triangles}).items()}
