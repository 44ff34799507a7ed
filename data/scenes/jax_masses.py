"""4096 masses that drop onto one flexible part, at once, in JAX; `plate_thin` is the shipped plate.

``wrenchbook fill plate_thin`` and ``wrenchbook export plate_thin plate.wbt`` make the table, then
``python data/scenes/jax_masses.py plate.wbt`` runs. Each mass stands on a damped leg, somewhere on
the plate's interface: an environment of reinforcement learning has the same shape. All masses take
one step in one call, and the derivative of where they come to rest by their mass is exact.
"""

from __future__ import annotations

import argparse
import time
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from wrenchbook import Table, arrays

GRAVITY, STEP = 9.81, 1e-3  # m/s², s
STIFFNESS, DAMPING = 2e4, 600.0  # of a leg, N/m and N·s/m


def wrenches(push: Any, feet: Any) -> Any:
    """Return the wrenches (k, 6), N and N·m, of legs that push (k,), N, down at feet (k, 2), m."""
    x, y = feet.T
    zeros = jnp.zeros_like(push)
    return jnp.stack((zeros, zeros, -push, -y * push, x * push, zeros), axis=1)


def heights(moved: Any, feet: Any) -> Any:
    """Return the heights (k,), m, of the plate under feet (k, 2), m."""
    return moved[:, 2] + feet[:, 1] * moved[:, 3] - feet[:, 0] * moved[:, 4]


def drop(answers: Any, masses: Any, feet: Any, steps: int) -> tuple[Any, Any]:
    """Let masses (k,), kg, drop by 5 mm onto feet (k, 2), m.

    The legs feel the plate of the step before: they are softer than the plate. Its speed, which is
    quasi-static, damps nothing.

    Returns
    -------
    arrays
        The legs' last forces (k,), N, and the plate's displacements (k, 6), m and rad.
    """

    def step(state: Any, _: Any) -> Any:
        z, speed, _, moved = state
        height = heights(moved, feet)
        squeezed = STIFFNESS * (height - z) - DAMPING * speed
        push = jnp.where(height > z, jnp.maximum(squeezed, 0.0), 0.0)
        speed = speed + STEP * (push / masses - GRAVITY)
        moved = answers.displacement(wrenches(push, feet))
        return (z + STEP * speed, speed, push, moved), None

    zeros = jnp.zeros_like(masses)
    flat = jnp.zeros((len(masses), 6), masses.dtype)
    start = (zeros + 0.005, zeros, zeros, flat)
    (_, _, push, moved), _ = jax.lax.scan(step, start, length=steps)
    return push, moved


def main(table: Table, count: int = 4096, steps: int = 1000) -> tuple[Any, Any, Any]:
    """Run the drop; return masses (k,), kg, displacements (k, 6), m and rad, du_z/dm (k,), m/kg."""
    answers = arrays.jax(table)
    random = np.random.default_rng(1)
    masses = jnp.asarray(random.uniform(5, 40, count))
    feet = jnp.asarray(random.uniform(-0.02, 0.02, (count, 2)))

    def sag(masses: Any) -> tuple[Any, Any]:
        push, moved = drop(answers, masses, feet, steps)
        return moved[:, 2], (push, moved)

    # One direction holds all derivatives: no mass acts on another's plate.
    run = jax.jit(lambda m: jax.jvp(sag, (m,), (jnp.ones_like(m),), has_aux=True))
    _, slope, (push, moved) = jax.block_until_ready(run(masses))
    start = time.perf_counter()
    jax.block_until_ready(run(masses))
    took = time.perf_counter() - start
    covered = jax.jit(answers)(wrenches(push, feet)).coverage == 0
    print(f"{count} masses, {steps} steps with derivatives: {took:.2f} s")
    print(f"u_z from {1e3 * moved[:, 2].min():.3f} to {1e3 * moved[:, 2].max():.3f} mm, ", end="")
    print(f"covered {100 * covered.mean():.0f} %, du_z/dm {1e6 * slope.mean():.2f} um/kg")
    return masses, moved, slope


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("table", help="a packed table, .wbt")
    parser.add_argument("--count", type=int, default=4096)
    parser.add_argument("--steps", type=int, default=1000)
    options = parser.parse_args()
    jax.config.update("jax_enable_x64", True)
    main(Table.open(options.table), options.count, options.steps)
