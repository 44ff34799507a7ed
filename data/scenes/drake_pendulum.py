"""A pendulum in Drake on a bar that bends.

Start ``wrenchbook serve``, then ``python data/scenes/drake_pendulum.py``. The rigid system is
welded to a frame whose offset is a parameter of the context, which takes the deformed pose; the
weld's reaction is the sensor.
"""

from __future__ import annotations

import argparse
import os
from typing import Any

import numpy as np
import pydrake.all as _drake

from wrenchbook import Client, Mount, conventions

drake: Any = _drake  # compiled: it has no types
P0 = np.array([0.0, 0.0, 1.0])  # m: the undeformed interface


class DrakeMount:
    """Reads the reaction of a weld and writes the pose of the frame it is welded to."""

    def __init__(self, mount: Mount, plant: Any, context: Any, frame: Any, weld: Any) -> None:
        self.mount, self._plant, self._context = mount, plant, context
        self._frame, self._weld = frame, weld

    def read(self) -> np.ndarray:
        """Return the wrench on the component, shape (6,), N and N·m, for `Mount.step`."""
        # Listed by joint; none has been removed, so the weld's index is that of its reaction.
        reactions = self._plant.get_reaction_forces_output_port().Eval(self._context)
        # On the child, at its frame, in its axes, torque first.
        on_component = conventions.from_drake(
            reactions[int(self._weld.index())], component="parent"
        )
        pose = self._weld.frame_on_child().CalcPoseInWorld(self._context)
        turned = conventions.moved(on_component, rotation=pose.rotation().matrix())
        return self.mount.wrench_of(turned[:3], turned[3:], pose.translation())

    def step(self) -> np.ndarray:
        """Read the weld's reaction, set the new pose at a sync, and return the wrench."""
        wrench = self.read()
        R, p = self.mount.step(wrench)
        moved = drake.RigidTransform(drake.RotationMatrix.ProjectToRotationMatrix(R), p)
        self._frame.SetPoseInParentFrame(self._context, moved)
        return wrench


def scene(mount: Mount, angle: float = 0.5) -> tuple[DrakeMount, Any, Any]:
    """Make the pendulum, hanging at an angle, rad; return its mount, the plant and its context."""
    plant = drake.MultibodyPlant(time_step=0.0)
    R0, p0 = mount.undeformed
    at = drake.RigidTransform(drake.RotationMatrix(R0), p0)
    frame = plant.AddFrame(drake.FixedOffsetFrame("interface", plant.world_frame(), at))
    block = plant.AddRigidBody("mounted", _inertia(0.5, [0.01, 0, 0.02], [1e-3, 1e-3, 1e-3]))
    rod = plant.AddRigidBody("rod", _inertia(2.0, [0, 0, -0.3], [0.02, 0.02, 1e-3]))
    weld = plant.WeldFrames(frame, block.body_frame())
    hinge_pose = drake.RigidTransform(np.array([0.02, -0.03, 0.1]))
    hinge = plant.AddJoint(
        drake.RevoluteJoint(
            "hinge",
            plant.AddFrame(drake.FixedOffsetFrame("hinge_at", block.body_frame(), hinge_pose)),
            rod.body_frame(),
            np.array([0.0, 1.0, 0.0]),
        )
    )
    plant.Finalize()
    context = plant.CreateDefaultContext()
    hinge.set_angle(context, angle)
    return DrakeMount(mount, plant, context, frame, weld), plant, context


def _inertia(mass: float, centre: list[float], moments: list[float]) -> Any:
    """Return a body's inertia, from its mass, kg, centre, m, and moments about that, kg m^2."""
    return drake.SpatialInertia.MakeFromCentralInertia(
        mass, np.array(centre), drake.RotationalInertia(*moments)
    )


def main(server: str, seconds: float) -> None:
    """Let it swing, answered every 5 ms by the downloaded table."""
    with Client(server, timeout=120) as client:
        client.displacement("bar", [0, 0, -20.0], on_thin="wait", wait_s=100)  # its one solve
        client.component("bar", wait_s=60)  # which waits for the row to be in use
        mount = Mount(client.download("bar"), "bar", np.eye(3), P0)
    pendulum, plant, context = scene(mount)
    simulator = drake.Simulator(plant, context)
    wrench = pendulum.step()
    for sync in range(1, round(seconds / 0.005) + 1):
        simulator.AdvanceTo(0.005 * sync)
        wrench = pendulum.step()
    print(f"wrench at the end: {wrench.round(2).tolist()} N and N·m")
    print(f"translation: {(1e3 * mount.displacement[:3]).round(3).tolist()} mm")
    print(mount.coverage)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    server = os.environ.get("WRENCHBOOK_SERVER", "http://127.0.0.1:8000")
    parser.add_argument("--server", default=server)
    parser.add_argument("--seconds", type=float, default=1.0)
    main(**vars(parser.parse_args()))
