"""A mass at the end of a bar that bends, in many environments of MJX at once.

``wrenchbook export bar bar.wbt`` makes the table, then ``python data/scenes/mjx_joint.py bar.wbt``
runs. The kernel answers on the host, once a step for all environments; MJX has the rest on its
device. The part is in MJX's equation of motion, (M + dt C) a = f - w - C v, as in `MujocoJoint`.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import mujoco as _mujoco
import numpy as np
from mujoco import mjx as _mjx

from wrenchbook import Table, arrays

mujoco: Any = _mujoco  # compiled: they have no types
mjx: Any = _mjx
SCENE = """
<mujoco>
  <option timestep="0.001" jacobian="dense"/>
  <worldbody>
    <body name="carriage">
      <joint name="lift" type="slide" axis="0 0 1"/>
      <geom size=".02" mass="1e7" contype="0" conaffinity="0"/>
      <body name="tip" pos="1 0 0">
        <joint type="slide" axis="1 0 0"/><joint type="slide" axis="0 1 0"/>
        <joint type="slide" axis="0 0 1"/><joint type="ball"/>
        <geom size=".05" mass="3" pos="0.02 0 0.03" contype="0" conaffinity="0"/>
      </body>
    </body>
  </worldbody>
</mujoco>
"""


def stepper(model: Any, table: Table, tip: str = "tip", **options: Any) -> tuple[Callable, int]:
    """Return a step (data, memory) -> (data, memory, answers), in the place of ``mjx.step``.

    The tip has three slides along its own axes and a ball, as `MujocoJoint` needs them. The
    integrator is Euler, the Jacobian dense: MJX then has the mass matrix as a square.
    """
    first = model.body(tip).jntadr[0]
    at, dof = int(model.jnt_qposadr[first]), int(model.jnt_dofadr[first])
    dt, tips = float(model.opt.timestep), slice(dof, dof + 6)
    on_device = mjx.put_model(model)
    joint, size = arrays.jax_joint(table, dt, axes=np.eye(3), **options)

    def step(data: Any, memory: Any) -> tuple[Any, Any, arrays.JointAnswers]:
        data = mjx.fwd_position(on_device, data)
        mass, speed = mjx.full_m(on_device, data), data.qvel[tips]
        inverse = jnp.linalg.inv(mass)[tips, tips]
        part = joint(memory, data.qpos[at : at + 7], speed, inverse)
        pushed = data.qfrc_applied.at[tips].set(-part.force - part.rate @ speed)
        data = data.replace(qfrc_applied=pushed)
        data = data.tree_replace({"_impl.M": mass.at[tips, tips].add(dt * part.rate)})
        data = mjx.factor_m(on_device, data)
        for stage in (mjx.fwd_velocity, mjx.fwd_actuation, mjx.fwd_acceleration):
            data = stage(on_device, data)
        constrained = data._impl.efc_J.size > 0
        data = mjx.solve(on_device, data) if constrained else data.replace(qacc=data.qacc_smooth)
        return mjx.euler(on_device, data), part.memory, part

    return step, size


def main(table: Table, count: int = 256, steps: int = 200) -> tuple[np.ndarray, np.ndarray]:
    """Shake the carriages, each at its own frequency; return those, Hz, and heights (n,), m."""
    model = mujoco.MjModel.from_xml_string(SCENE)
    step, size = stepper(model, table)
    hertz = np.linspace(1.0, 20.0, count)

    def run(frequency: Any) -> Any:
        def advance(state: Any, _: Any) -> Any:
            data, memory = state
            push = 1e7 * (9.81 + 2.0 * jnp.sin(2 * jnp.pi * frequency * data.time))
            data = data.replace(qfrc_applied=data.qfrc_applied.at[0].set(push))
            data, memory, part = step(data, memory)
            return (data, memory), part.status

        start = mjx.make_data(model), jnp.zeros(size)
        (data, _), status = jax.lax.scan(advance, start, length=steps)
        return data.qpos[3], status

    go = jax.jit(jax.vmap(run))
    jax.block_until_ready(go(hertz))
    began = time.perf_counter()
    heights, status = jax.block_until_ready(go(hertz))
    took = time.perf_counter() - began
    print(
        f"{count} environments, {steps} steps: {1e6 * took / count / steps:.1f} us a step of each"
    )
    print(f"{int((status != 0).any(axis=1).sum())} without a wrench in some step")
    return hertz, np.asarray(heights)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("table", help="a packed table, .wbt")
    parser.add_argument("--count", type=int, default=256)
    parser.add_argument("--steps", type=int, default=200)
    arguments = parser.parse_args()
    jax.config.update("jax_enable_x64", True)
    main(Table.open(arguments.table), arguments.count, arguments.steps)
