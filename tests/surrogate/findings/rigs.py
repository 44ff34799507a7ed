"""Made-up test rigs: parts with a known response, measured with a known error."""

from __future__ import annotations

import numpy as np
from scipy.spatial.transform import Rotation

from wrenchbook.surrogate.table.rows import LoadRange, Rows

CAUSES = {  # what is done to a measurement, and the finding that names it
    "a channel at one value": "dead",
    "a channel that stays for a third of the rows": "stuck",
    "a channel that ends at 70 % of its range": "clipped",
    "a channel of noise": "noise",
    "loads in another frame": "asymmetry",
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


SHAPES = {  # what bends each mode's response, of a size from -1 to 1
    "linear": np.zeros_like,
    "stiffening": lambda size: -(size**3),
    "softening": lambda size: size**3 + 0.5 * size**2,
    "saturating": lambda size: np.tanh(3 * size) - size,
    "clearance": np.zeros_like,
}


class Rig:
    """A part whose response is the gradient of a complementary energy, and its loads.

    The energy is a sum of functions of linear combinations of loads, so a response of any kind is
    reciprocal at every load.

    Parameters
    ----------
    seed : int
    kinds : sequence of str
        Of the loads, of which one is drawn: see `loads`.
    responses : sequence of str
        Of `SHAPES`, of which one is drawn.
    rows : tuple of int
        Least and largest number of rows.
    noises : sequence of float
        Of each output's range, of which one is drawn.
    resolutions : sequence of float
        Steps of the readings, of each output's range, of which one is drawn.
    outputs : int
        The first three are measured, or all six.
    """

    def __init__(
        self,
        seed,
        kinds=("random", "sweeps", "motion"),
        responses=("linear", "stiffening"),
        rows=(200, 1000),
        noises=(0.0, 0.001, 0.003, 0.01),
        resolutions=(0.0,),
        outputs=6,
    ):
        self.rng = np.random.default_rng(seed)
        self.compliance, length = cantilever(self.rng)
        force = 0.01 * length / np.abs(self.compliance[:3, :3]).max()
        moment = 0.02 / np.abs(self.compliance[3:, 3:]).max()
        self.high = np.repeat([float(f"{force:.1g}"), float(f"{moment:.1g}")], 3)
        self.range = LoadRange(-self.high, self.high)
        self.response = str(self.rng.choice(responses))
        self.strength = self.rng.uniform(
            0.05, 0.3
        )  # of a size; at 0.33 a stiffening part gives no more
        energies = self.compliance * np.outer(self.high, self.high)
        self.stiffness, self.modes = np.linalg.eigh(energies)
        self.noise = self.rng.choice(noises)
        self.resolution = self.rng.choice(resolutions)
        self.kind, self.outputs = str(self.rng.choice(kinds)), outputs
        self.wrench = self.loads(self.kind, int(self.rng.integers(*rows)))
        self.displacement = self.respond(self.wrench)
        self.size = np.ptp(self.displacement, axis=0)

    def respond(self, wrench):
        scaled = wrench / self.high
        largest = np.abs(self.modes).sum(axis=0)
        size = scaled @ self.modes / largest
        bent = size + self.strength * SHAPES[self.response](size)
        energies = (bent * largest * self.stiffness) @ self.modes.T
        if self.response == "clearance":  # of the joint, felt by each force by itself
            play = 0.3 * self.strength * np.abs(np.diag(self.compliance)) * self.high**2
            energies[:, :3] += (play * np.tanh(scaled / 0.005))[:, :3]
        return energies / self.high

    def loads(self, kind, count):
        if kind == "random":
            return self.rng.uniform(-1, 1, (count, 6)) * self.high
        if kind == "sweeps":  # one load after the other, up, down and back
            each = count // 6
            wave = np.interp(np.arange(each) / each, [0, 0.25, 0.75, 1], [0, 1, -1, 0])
            return np.kron(np.diag(self.high), wave[:, None])
        if kind == "several":  # two or three loads at a time, the others at rest
            some = self.rng.permuted(np.tile(np.arange(6), (count, 1)), axis=1) < 3
            return np.where(some, self.rng.uniform(-1, 1, (count, 6)), 0.0) * self.high
        if kind == "grid":  # all levels of two loads after another
            side, pairs = max(int((count / 3) ** 0.5), 4), ((0, 4), (1, 3), (2, 5))
            levels, parts = np.linspace(-1, 1, side), []
            for pair in pairs:
                parts.append(np.zeros((side * side, 6)))
                parts[-1][:, pair] = np.stack(np.meshgrid(levels, levels), axis=-1).reshape(-1, 2)
            return np.concatenate(parts) * self.high
        if kind == "slow":  # all loads at once, one to three cycles each
            turns = self.rng.uniform(0.7, 3, (3, 6)) * np.linspace(0, 1, count)[:, None, None]
            waves = np.sin(2 * np.pi * turns + self.rng.uniform(0, 6, (3, 6)))
            wrench = (waves * self.rng.uniform(0.2, 0.5, (3, 6))).sum(axis=1)
            return wrench / np.abs(wrench).max(axis=0) * self.high
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
        step = self.resolution * self.size
        moved = np.round(moved / step) * step if self.resolution else moved
        if error in RECORDED:
            RECORDED[error](self, wrench, moved)
        moved[:, self.outputs :] = np.nan
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


def _turned(rig, wrench, moved):
    axis = rig.rng.normal(size=3)
    turn = Rotation.from_rotvec(np.radians(40) * axis / np.linalg.norm(axis)).as_matrix()
    wrench[:] = wrench @ np.kron(np.eye(2), turn).T


def _dead(rig, wrench, moved):
    moved[:, rig.rng.integers(rig.outputs)] = rig.rng.choice([0.0, 1.23e-4])


def _stuck(rig, wrench, moved):
    """Hold the output that moves most in a third of the rows."""
    first = rig.rng.integers(len(moved) // 2)
    held = slice(first, first + len(moved) // 3)
    output = np.argmax(np.ptp(moved[held, : rig.outputs], axis=0) / rig.size[: rig.outputs])
    moved[held, output] = moved[first, output]


def _clipped(rig, wrench, moved):
    output = rig.rng.integers(rig.outputs)
    moved[:, output] = moved[:, output].clip(*(0.7 * f(moved[:, output]) for f in (np.min, np.max)))


def _noise(rig, wrench, moved):
    output = rig.rng.integers(rig.outputs)
    moved[:, output] = 0.3 * rig.size[output] * rig.rng.normal(size=len(moved))


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
    "loads in another frame": _turned,
    "a channel at one value": _dead,
    "a channel that stays for a third of the rows": _stuck,
    "a channel that ends at 70 % of its range": _clipped,
    "a channel of noise": _noise,
}
