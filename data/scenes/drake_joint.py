"""A pendulum in Drake at the end of a bar that bends, on a carriage that is shaken.

``wrenchbook export bar bar.wbt`` makes the table, then ``python data/scenes/drake_joint.py
bar.wbt`` runs. `DrakeJoint` is a system that reads the plant's state and gives spatial forces on
the two bodies: the law of `wrenchbook.Joint`, for a discrete plant of the same step.
"""

from __future__ import annotations

import argparse
from typing import Any

import numpy as np
import pydrake.all as _drake

from wrenchbook import Joints, Table

drake: Any = _drake  # compiled: it has no types
PUSH, HERTZ = 400.0, 2.0  # N, on the carriage


class DrakeJoint(_drake.LeafSystem):
    """A part between the undeformed interface frame, on the base, and the tip's interface frame.

    Inputs are the plant's state and its applied generalised forces, the output is for its applied
    spatial forces. The plant is discrete, and six freedoms are free between base and tip.
    """

    def __init__(self, plant: Any, table: Table, undeformed: Any, tip: Any, **options: Any) -> None:
        super().__init__()
        self.plant, self.undeformed, self.tip = plant, undeformed, tip
        self.joint, self.dt = Joints(table, 1, **options), plant.time_step()
        self.context = plant.CreateDefaultContext()
        self.DeclareVectorInputPort("state", plant.num_multibody_states())
        self.DeclareVectorInputPort("applied", plant.num_velocities())
        # The kernel's memory between steps is the system's state: an output changes nothing.
        self._memory = self.DeclareDiscreteState(self.joint.memory.size)
        self.DeclarePeriodicDiscreteUpdateEvent(self.dt, 0.0, self.update)
        forces = [drake.ExternallyAppliedSpatialForce() for _ in range(2)]
        self.DeclareAbstractOutputPort(
            "forces", lambda: drake.AbstractValue.Make(forces), self.forces
        )

    def update(self, context: Any, states: Any) -> None:
        """Store the kernel's memory of this step as the system's state."""
        self.wrench(context)
        states.set_value(self._memory, self.joint.memory.ravel())

    def wrench(self, context: Any) -> np.ndarray:
        """Return the wrench on the part in a step from this state, (6,), N and N·m."""
        plant, state = self.plant, self.context
        plant.SetPositionsAndVelocities(state, self.get_input_port(0).Eval(context))
        count = plant.num_velocities()
        forces = drake.MultibodyForces(plant)
        plant.CalcForceElementsContribution(state, forces)  # gravity and springs
        push = self.get_input_port(1).Eval(context)
        push = push - plant.CalcInverseDynamics(state, np.zeros(count), forces)
        mass = plant.CalcMassMatrix(state)
        speed = plant.GetVelocities(state) + self.dt * np.linalg.solve(mass, push)
        kind, frame, point = drake.JacobianWrtVariable.kV, self.undeformed, np.zeros(3)
        jacobian = plant.CalcJacobianSpatialVelocity(state, kind, self.tip, point, frame, frame)
        jacobian = jacobian[[3, 4, 5, 0, 1, 2]]  # Drake has rotations first
        inverse = jacobian @ np.linalg.solve(mass, jacobian.T)
        pose = self.tip.CalcPose(state, self.undeformed)
        at = np.concatenate([pose.translation(), pose.rotation().ToQuaternion().wxyz()])
        self.joint.memory[:] = context.get_discrete_state(self._memory).value()
        return self.joint.step(at[None], (jacobian @ speed)[None], inverse, self.dt, threads=1)[0]

    def forces(self, context: Any, output: Any) -> None:
        """Write the wrench on the base, and its negative on the tip, both at the interface."""
        wrench = self.wrench(context)
        turned = self.undeformed.CalcPoseInWorld(self.context).rotation().matrix()
        force, moment = turned @ wrench[:3], turned @ wrench[3:]
        on_bodies = []
        for frame, sign in ((self.tip, -1.0), (self.undeformed, 1.0)):
            body = frame.body()
            on_body = drake.ExternallyAppliedSpatialForce()
            on_body.body_index = body.index()
            on_body.p_BoBq_B = self.tip.CalcPose(self.context, body.body_frame()).translation()
            on_body.F_Bq_W = drake.SpatialForce(tau=sign * moment, f=sign * force)
            on_bodies.append(on_body)
        output.set_value(on_bodies)


def scene(table: Table, dt: float = 1e-3, angle: float = 0.5) -> tuple[Any, Any, Any]:
    """Make the carriage on a spring, the bar and the pendulum at an angle, rad.

    Returns the simulator, the plant, and the plant's context.
    """
    builder = drake.DiagramBuilder()
    plant = builder.AddSystem(drake.MultibodyPlant(time_step=dt))
    carriage = plant.AddRigidBody("carriage", _sphere(20.0, 0.1))
    tip = plant.AddRigidBody("tip", _sphere(1.0, 0.03))
    rod = plant.AddRigidBody("rod", _sphere(2.0, 0.05, [0.0, 0.0, -0.3]))
    up, world = np.array([0.0, 0.0, 1.0]), plant.world_frame()
    lift = plant.AddJoint(drake.PrismaticJoint("lift", world, carriage.body_frame(), up))
    plant.AddForceElement(drake.PrismaticSpring(lift, 0.0, 2e4))
    at = drake.RigidTransform(np.array([1.0, 0.0, 0.0]))
    end = plant.AddFrame(drake.FixedOffsetFrame("undeformed", carriage.body_frame(), at))
    plant.AddJoint(drake.QuaternionFloatingJoint("part", end, tip.body_frame()))
    axis = np.array([0.0, 1.0, 0.0])
    hinge = plant.AddJoint(drake.RevoluteJoint("hinge", tip.body_frame(), rod.body_frame(), axis))
    plant.Finalize()
    part = builder.AddSystem(DrakeJoint(plant, table, end, tip.body_frame()))
    on_lift = np.eye(plant.num_velocities())[lift.velocity_start()]
    push = builder.AddSystem(
        drake.Sine(PUSH * on_lift, 2 * np.pi * HERTZ * np.ones_like(on_lift), 0.0 * on_lift)
    )
    builder.Connect(push.get_output_port(0), plant.get_applied_generalized_force_input_port())
    builder.Connect(push.get_output_port(0), part.get_input_port(1))
    builder.Connect(plant.get_state_output_port(), part.get_input_port(0))
    builder.Connect(part.get_output_port(0), plant.get_applied_spatial_force_input_port())
    simulator = drake.Simulator(builder.Build())
    context = plant.GetMyMutableContextFromRoot(simulator.get_mutable_context())
    hinge.set_angle(context, angle)
    return simulator, plant, context


def _sphere(mass: float, radius: float, centre: Any = (0.0, 0.0, 0.0)) -> Any:
    """Return the inertia of a solid sphere, kg and m, about a body's origin."""
    moment = 0.4 * mass * radius**2
    return drake.SpatialInertia.MakeFromCentralInertia(
        mass, np.array(centre), drake.RotationalInertia(moment, moment, moment)
    )


def main(table: Table, seconds: float = 1.0) -> None:
    """Shake it, and print the deflection of the bar and the pendulum's angle."""
    simulator, plant, context = scene(table)
    simulator.AdvanceTo(seconds)
    pose = plant.GetFrameByName("tip").CalcPose(context, plant.GetFrameByName("undeformed"))
    print(f"deflection: {(1e3 * pose.translation()).round(3).tolist()} mm")
    print(f"pendulum: {plant.GetJointByName('hinge').get_angle(context):.4f} rad")


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("table", help="a packed table, .wbt")
    parser.add_argument("--seconds", type=float, default=1.0)
    arguments = parser.parse_args()
    main(Table.open(arguments.table), arguments.seconds)
