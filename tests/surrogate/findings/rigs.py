"""Made-up test rigs: parts with a known response, measured with a known error."""

from __future__ import annotations

import numpy as np

from wrenchbook.surrogate.table.rows import LoadRange, Rows

CAUSES = {  # what is done to a measurement, and the finding that names it
    "outliers in one output": "outlier",
    "outliers in all outputs": "outlier",
    "-9999 mm": "sentinel",
    "all loads with the wrong sign": "sign",
    "one load with the wrong sign": "sign",
    "millimetres under a header of metres": "unit",
    "kilonewtons under a header of newtons": "unit",
    "degrees under a header of radians": "unit",
    "moments about another point": "lever",
    "drift of 3 to 10 %": "drift",
    "hysteresis of 2 %": "hysteresis",
    "hysteresis of 8 %": "hysteresis",
}
DIRECTED = ("hysteresis of 2 %", "hysteresis of 8 %")  # needs rows in the order of a motion


def cantilever(rng):
    """Return the compliance (6, 6), SI, of a beam in a frame of its own, and its length, m."""
    length, width, height = rng.uniform(0.1, 0.6), *rng.uniform(0.005, 0.05, 2)
    young = rng.choice([70e9, 210e9, 3e9])
    shear, area = young / 2.6, width * height
    about_y, about_z = width * height**3 / 12, height * width**3 / 12
    c = np.zeros((6, 6))
    c[0, 0] = length / young / area
    c[1, 1], c[2, 2] = length**3 / 3 / young / about_z, length**3 / 3 / young / about_y
    c[3, 3] = length / shear / (3 * min(about_y, about_z))
    c[4, 4], c[5, 5] = length / young / about_y, length / young / about_z
    c[1, 5] = c[5, 1] = length**2 / 2 / young / about_z
    c[2, 4] = c[4, 2] = -(length**2) / 2 / young / about_y
    lever = np.eye(6)
    lever[3:, :3] = np.cross(rng.uniform(-0.1, 0.1, 3), np.eye(3)).T
    turn = np.linalg.qr(rng.normal(size=(3, 3)))[0]
    turn *= np.sign(np.linalg.det(turn))
    both = np.kron(np.eye(2), turn) @ lever.T
    return both @ c @ both.T, length


class Rig:
    """A part that is linear or stiffens by up to 15 %, and loads of one of three designs."""

    def __init__(self, seed, kinds=("random", "sweeps", "motion")):
        self.rng = np.random.default_rng(seed)
        self.compliance, length = cantilever(self.rng)
        force = 0.01 * length / np.abs(self.compliance[:3, :3]).max()
        moment = 0.02 / np.abs(self.compliance[3:, 3:]).max()
        self.high = np.repeat([float(f"{force:.1g}"), float(f"{moment:.1g}")], 3)
        self.range = LoadRange(-self.high, self.high)
        self.stiffening = self.rng.uniform(0, 0.15) * self.rng.choice([0, 1])
        self.mixing = self.rng.normal(size=(6, 6))
        self.noise = self.rng.choice([0.0, 0.001, 0.003, 0.01])  # of each output's range
        self.wrench = self.loads(self.rng.choice(kinds), int(self.rng.integers(200, 1000)))
        self.displacement = self.respond(self.wrench)
        self.size = np.ptp(self.displacement, axis=0)

    def respond(self, wrench):
        linear = wrench @ self.compliance.T
        size = np.abs(self.high * np.abs(self.compliance)).sum(axis=1)
        bent = (wrench / self.high @ self.mixing.T / 6) ** 2
        return linear * (1 - self.stiffening * (linear / size) ** 2) + 0.02 * self.stiffening * (
            size * bent
        )

    def loads(self, kind, count):
        if kind == "random":
            return self.rng.uniform(-1, 1, (count, 6)) * self.high
        if kind == "sweeps":  # one load after the other, up, down and back
            each = count // 6
            wave = np.interp(np.arange(each) / each, [0, 0.25, 0.75, 1], [0, 1, -1, 0])
            return np.kron(np.diag(self.high), wave[:, None])
        time, wrench = np.linspace(0, count / 40, count), np.zeros((count, 6))
        for load in range(6):
            for frequency in self.rng.uniform(0.3, 2, 2):
                phase = self.rng.uniform(0, 6)
                wrench[:, load] += self.rng.normal() * np.sin(2 * np.pi * frequency * time + phase)
        return wrench / np.abs(wrench).max(axis=0) * self.high * self.rng.uniform(0.6, 1, 6)

    def measured(self, error=None):
        """Return the rows as measured with an error of `CAUSES`, and with noise."""
        wrench, moved = self.wrench.copy(), self.displacement.copy()
        rng, count = self.rng, len(wrench)
        if error == "drift of 3 to 10 %":
            slope = rng.uniform(0.03, 0.1) * rng.choice([-1, 1], 6) * self.size
            moved += slope * np.linspace(0, 1, count)[:, None]
        if error in DIRECTED:
            loop = 0.02 if "2" in error else 0.08
            moved -= loop / 2 * self.size * np.sign(np.diff(moved, axis=0, prepend=moved[:1]))
        moved += self.noise * self.size * rng.normal(size=moved.shape)
        if error in RECORDED:
            RECORDED[error](self, wrench, moved)
        return Rows.of(wrench, moved, source=["rig"] * count)


def _outliers(rig, moved, outputs):
    some = rig.rng.choice(len(moved), 3, replace=False)
    by = rig.rng.choice([-1, 1], 3) * rig.rng.uniform(0.5, 4, 3)
    moved[np.ix_(some, outputs)] += by[:, None] * rig.size[outputs]


def _sentinels(rig, wrench, moved):
    moved[rig.rng.choice(len(moved), 2, replace=False), rig.rng.integers(3)] = -9.999


def _lever(rig, wrench, moved):
    lever = rig.rng.uniform(0.05, 0.2, 3) * rig.rng.choice([-1, 1], 3)
    wrench[:, 3:] += np.cross(lever, wrench[:, :3])


def _scaled(which, columns, factor):
    def change(rig, wrench, moved):
        (wrench, moved)[which][:, columns] *= factor

    return change


def _one_sign(rig, wrench, moved):
    wrench[:, rig.rng.integers(6)] *= -1


RECORDED = {  # what becomes of the numbers once they are measured
    "outliers in one output": lambda rig, wrench, moved: _outliers(rig, moved, [0]),
    "outliers in all outputs": lambda rig, wrench, moved: _outliers(rig, moved, [*range(6)]),
    "-9999 mm": _sentinels,
    "all loads with the wrong sign": _scaled(0, slice(0, 6), -1),
    "one load with the wrong sign": _one_sign,
    "millimetres under a header of metres": _scaled(1, slice(0, 3), 1000),
    "kilonewtons under a header of newtons": _scaled(0, slice(0, 3), 1e-3),
    "degrees under a header of radians": _scaled(1, slice(3, 6), 57.29578),
    "moments about another point": _lever,
}
