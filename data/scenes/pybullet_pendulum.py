"""Example: a pendulum in PyBullet on a bar that bends.

Start ``wrenchbook serve``, then ``python data/scenes/pybullet_pendulum.py``. The base of the rigid
system is set to the deformed pose of the bar's interface. A fixed joint with a force-torque sensor
holds the first link to the base.
"""

from __future__ import annotations

import argparse
import os
import tempfile
from pathlib import Path
from typing import Any

import numpy as np
import pybullet as _pybullet

from wrenchbook import Client, Mount, conventions

pybullet: Any = _pybullet  # a compiled module without types
STEP_S = 1e-3
POINT = np.array([0.0, 0.0, 1.0])  # m: the undeformed interface point
URDF = """<robot name="pendulum">
  <link name="base"><inertial><mass value="0"/><inertia ixx="0" iyy="0" izz="0" ixy="0" ixz="0"
    iyz="0"/></inertial></link>
  <link name="mounted"><inertial><origin xyz="0.01 0 0.02"/><mass value="0.5"/>
    <inertia ixx="1e-3" iyy="1e-3" izz="1e-3" ixy="0" ixz="0" iyz="0"/></inertial></link>
  <joint name="mount" type="fixed"><parent link="base"/><child link="mounted"/></joint>
  <link name="rod"><inertial><origin xyz="0 0 -0.3"/><mass value="2"/>
    <inertia ixx="0.02" iyy="0.02" izz="1e-3" ixy="0" ixz="0" iyz="0"/></inertial></link>
  <joint name="hinge" type="continuous"><parent link="mounted"/><child link="rod"/>
    <origin xyz="0.02 -0.03 0.1"/><axis xyz="0 1 0"/></joint>
</robot>"""


class PybulletMount:
    """Reads PyBullet's force-torque sensor and writes the base's pose."""

    def __init__(self, mount: Mount, robot: int, joint: int, engine: int) -> None:
        self.mount, self._robot, self._joint, self._engine = mount, robot, joint, engine
        # Moments about the joint, in the child's axes; by default about its centre of mass.
        pybullet.setPhysicsEngineParameter(
            jointFeedbackMode=pybullet.JOINT_FEEDBACK_IN_JOINT_FRAME, physicsClientId=engine
        )
        pybullet.enableJointForceTorqueSensor(robot, joint, physicsClientId=engine)

    def read(self) -> np.ndarray:
        """Return the wrench on the component, shape (6,), N and N·m, for `Mount.step`."""
        state = pybullet.getJointState(self._robot, self._joint, physicsClientId=self._engine)
        in_link = conventions.from_pybullet(state[2], component="parent")
        point, orientation = pybullet.getBasePositionAndOrientation(
            self._robot, physicsClientId=self._engine
        )
        axes = np.array(pybullet.getMatrixFromQuaternion(orientation)).reshape(3, 3)
        in_world = conventions.moved(in_link, rotation=axes)
        return self.mount.wrench_of(in_world[:3], in_world[3:], point)

    def step(self) -> np.ndarray:
        """Read the wrench after a ``stepSimulation``, set the new pose; return the wrench."""
        wrench = self.read()
        axes, point = self.mount.step(wrench)
        pybullet.resetBasePositionAndOrientation(
            self._robot, point.tolist(), _quaternion(axes).tolist(), physicsClientId=self._engine
        )
        return wrench


def _quaternion(R: np.ndarray) -> np.ndarray:
    """Return (x, y, z, w) of a rotation (3, 3), by the method of Bar-Itzhack (2000)."""
    K = np.zeros((4, 4))
    K[:3, :3] = R + R.T - np.trace(R) * np.eye(3)
    K[:3, 3] = K[3, :3] = [R[2, 1] - R[1, 2], R[0, 2] - R[2, 0], R[1, 0] - R[0, 1]]
    K[3, 3] = np.trace(R)
    quaternion = np.linalg.eigh(K)[1][:, -1]
    return quaternion if quaternion[3] >= 0 else -quaternion


def scene(mount: Mount, angle: float = 0.5) -> tuple[PybulletMount, int]:
    """Make the pendulum at an angle from its rest, rad; return its mount and PyBullet's engine."""
    engine = pybullet.connect(pybullet.DIRECT)
    pybullet.setGravity(0, 0, -9.81, physicsClientId=engine)
    pybullet.setTimeStep(STEP_S, physicsClientId=engine)
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "pendulum.urdf"
        path.write_text(URDF)
        robot = pybullet.loadURDF(
            str(path),
            basePosition=mount.undeformed[1].tolist(),
            baseOrientation=_quaternion(mount.undeformed[0]).tolist(),
            useFixedBase=True,
            flags=pybullet.URDF_USE_INERTIA_FROM_FILE,
            physicsClientId=engine,
        )
    pybullet.changeDynamics(
        robot, -1, linearDamping=0, angularDamping=0, jointDamping=0, physicsClientId=engine
    )
    pybullet.setJointMotorControl2(  # by default PyBullet brakes its joints
        robot, 1, pybullet.VELOCITY_CONTROL, force=0, physicsClientId=engine
    )
    pybullet.resetJointState(robot, 1, angle, physicsClientId=engine)
    return PybulletMount(mount, robot, 0, engine), engine


def main(server: str, seconds: float) -> None:
    """Simulate the pendulum with answers from the downloaded table; print the last ones."""
    with Client(server, timeout=120) as client:
        # The bar is linear: one solve determines its table.
        client.displacement("bar", [0, 0, -20.0], on_thin="wait", wait_s=100)
        client.component("bar", wait_s=60)  # once the table has the row
        mount = Mount(client.download("bar"), "bar", np.eye(3), POINT)
    pendulum, engine = scene(mount)
    wrench = np.zeros(6)
    for _ in range(round(seconds / STEP_S)):
        pybullet.stepSimulation(physicsClientId=engine)
        wrench = pendulum.step()
    print(f"wrench at the end: {wrench.round(2).tolist()} N and N·m")
    print(f"translation: {(1e3 * mount.displacement[:3]).round(3).tolist()} mm")
    print(mount.coverage)
    pybullet.disconnect(physicsClientId=engine)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    server = os.environ.get("WRENCHBOOK_SERVER", "http://127.0.0.1:8000")
    parser.add_argument("--server", default=server)
    parser.add_argument("--seconds", type=float, default=1.0)
    main(**vars(parser.parse_args()))
