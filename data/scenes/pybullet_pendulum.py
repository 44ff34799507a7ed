"""A pendulum in PyBullet on a bar that bends.

Start ``wrenchbook serve``, then ``python data/scenes/pybullet_pendulum.py``. The rigid system has a
fixed base, which takes the deformed pose; its first link is held by a fixed joint with a
force-torque sensor.
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

pybullet: Any = _pybullet  # compiled: it tells no types
P0 = np.array([0.0, 0.0, 1.0])  # m: the undeformed interface
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
        # Forces about the joint, in the child's axes; otherwise about its centre of mass.
        pybullet.setPhysicsEngineParameter(
            jointFeedbackMode=pybullet.JOINT_FEEDBACK_IN_JOINT_FRAME, physicsClientId=engine
        )
        pybullet.enableJointForceTorqueSensor(robot, joint, physicsClientId=engine)

    def read(self) -> np.ndarray:
        """Return the wrench on the component, shape (6,), N and N·m, for `Mount.step`."""
        state = pybullet.getJointState(self._robot, self._joint, physicsClientId=self._engine)
        on_component = conventions.from_pybullet(state[2], component="parent")
        base = pybullet.getBasePositionAndOrientation(self._robot, physicsClientId=self._engine)
        axes = np.array(pybullet.getMatrixFromQuaternion(base[1])).reshape(3, 3)
        turned = conventions.moved(on_component, rotation=axes)
        return self.mount.wrench_of(turned[:3], turned[3:], base[0])

    def step(self) -> np.ndarray:
        """Read, ask and set the new pose after a ``stepSimulation``; return the wrench."""
        wrench = self.read()
        R, p = self.mount.step(wrench)
        pybullet.resetBasePositionAndOrientation(
            self._robot, p.tolist(), _quaternion(R).tolist(), physicsClientId=self._engine
        )
        return wrench


def _quaternion(R: np.ndarray) -> np.ndarray:
    """Return (x, y, z, w) of a rotation, shape (3, 3): the eigenvector of Bar-Itzhack's matrix."""
    K = np.zeros((4, 4))
    K[:3, :3] = R + R.T - np.trace(R) * np.eye(3)
    K[:3, 3] = K[3, :3] = [R[2, 1] - R[1, 2], R[0, 2] - R[2, 0], R[1, 0] - R[0, 1]]
    K[3, 3] = np.trace(R)
    quaternion = np.linalg.eigh(K)[1][:, -1]
    return quaternion if quaternion[3] >= 0 else -quaternion


def scene(mount: Mount, angle: float = 0.5) -> tuple[PybulletMount, int]:
    """Make the pendulum, hanging at an angle, rad; return its mount and PyBullet's engine."""
    engine = pybullet.connect(pybullet.DIRECT)
    pybullet.setGravity(0, 0, -9.81, physicsClientId=engine)
    pybullet.setTimeStep(1e-3, physicsClientId=engine)
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
    pybullet.setJointMotorControl2(  # PyBullet brakes its joints unless told not to
        robot, 1, pybullet.VELOCITY_CONTROL, force=0, physicsClientId=engine
    )
    pybullet.resetJointState(robot, 1, angle, physicsClientId=engine)
    return PybulletMount(mount, robot, 0, engine), engine


def main(server: str, seconds: float) -> None:
    """Let it swing, every step answered by the downloaded table."""
    with Client(server, timeout=120) as client:
        client.displacement("bar", [0, 0, -20.0], on_thin="wait", wait_s=100)  # its one solve
        client.component("bar", wait_s=60)  # which waits for the row to be in use
        mount = Mount(client.download("bar"), "bar", np.eye(3), P0)
    on, engine = scene(mount)
    for _ in range(round(seconds / 1e-3)):
        pybullet.stepSimulation(physicsClientId=engine)
        wrench = on.step()
    print(f"wrench at the end: {wrench.round(2).tolist()} N and N·m")
    print(f"translation: {(1e3 * mount.displacement[:3]).round(3).tolist()} mm")
    print(mount.coverage)
    pybullet.disconnect(physicsClientId=engine)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    server = os.environ.get("WRENCHBOOK_SERVER", "http://127.0.0.1:8000")
    parser.add_argument("--server", default=server)
    parser.add_argument("--seconds", type=float, default=1.0)
    options = parser.parse_args()
    main(options.server, options.seconds)
