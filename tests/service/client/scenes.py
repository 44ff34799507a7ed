"""MuJoCo scenes on a mount."""

from __future__ import annotations

from typing import Any

import mujoco as _mujoco
import numpy as np

mujoco: Any = _mujoco

GRAVITY = np.array([0.0, 0.0, -9.81])  # m/s^2
SENSORS = (
    '<sensor><force name="mount_force" site="mount"/>'
    '<torque name="mount_torque" site="mount"/></sensor>'
)
# A block of 0.5 kg and on it a rod of 2 kg on a hinge; the site is off the division point, turned.
PENDULUM = {
    "hinge": np.array([0.02, -0.03, 0.1]),  # m, from the division point
    "length": 0.3,  # m, from the hinge to the rod's centre of mass
    "mass": 2.0,  # kg
    "inertia": 0.02,  # kg m^2, about the hinge's axis, at the centre of mass
    "block": np.array([0.01, 0.0, 0.02]),  # m: the block's centre of mass
    "block_mass": 0.5,  # kg
}


def made(
    *,
    worldbody: str = "",
    mounted: str = "",
    rod: str = "",
    base: str = "",
    quat: str = "1 0 0 0",
    option: str = "",
    extra: str = "",
    sensors: str = SENSORS,
) -> tuple[Any, Any]:
    """A pendulum on a mount, with pieces of XML in its places."""
    model = mujoco.MjModel.from_xml_string(f"""
<mujoco>
  <option timestep="0.001" {option}/>
  <worldbody>
    {worldbody}
    <body name="base" mocap="true" pos="0.4 -0.2 1.5" quat="{quat}">
      {base}
      <body name="mounted">
        {mounted}
        <site name="mount" pos="0.03 0.02 -0.01" quat="0.9 0.1 0.3 0.2"/>
        <inertial mass="0.5" pos="0.01 0 0.02" diaginertia="1e-3 1e-3 1e-3"/>
        <body name="rod" pos="0.02 -0.03 0.1" {rod}>
          <joint name="hinge" type="hinge" axis="0 1 0"/>
          <inertial mass="2" pos="0 0 -0.3" diaginertia="0.02 0.02 0.001"/>
          <site name="tip" pos="0 0 -0.3"/>
        </body>
      </body>
    </body>
  </worldbody>
  {extra}
  {sensors}
</mujoco>""")
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    return model, data


def pendulum_wrench(angle: float, speed: float, axes: np.ndarray) -> np.ndarray:
    """The pendulum's wrench on its mount, (6,), in closed form; `axes` is R0."""
    P, pull = PENDULUM, axes.T @ GRAVITY
    centre = P["length"] * np.array([-np.sin(angle), 0.0, -np.cos(angle)])
    about = np.array([0.0, 1.0, 0.0])
    turning = P["inertia"] + P["mass"] * P["length"] ** 2
    spin_up = np.cross(centre, P["mass"] * pull)[1] / turning
    moves = spin_up * np.cross(about, centre) - speed**2 * centre
    rod, block = P["mass"] * (pull - moves), P["block_mass"] * pull
    moment = np.cross(P["hinge"] + centre, rod) + np.cross(P["block"], block)
    return np.concatenate([rod + block, moment - P["inertia"] * spin_up * about])
