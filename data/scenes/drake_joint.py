"""A pendulum in Drake at the end of a bar that bends, on a carriage that is shaken.

``wrenchbook export bar bar.wbt`` makes the table, then ``python data/scenes/drake_joint.py
bar.wbt`` runs. `DrakeJoint` is a system that reads the plant's state and gives spatial forces on
the two bodies: the law of `wrenchbook.Joint`, for a discrete plant of the same step.
"""

from __future__ import annotations

import argparse
from typing import Any

import numpy as np
import pydrake.common.value as _value
import pydrake.math as _math
import pydrake.multibody.math as _spatial
import pydrake.multibody.plant as _plant
import pydrake.multibody.tree as _tree
import pydrake.systems.analysis as _analysis
import pydrake.systems.framework as _framework
import pydrake.systems.primitives as _primitives

from wrenchbook import Joints, Table

value: Any = _value  # compiled: they tell no types
math: Any = _math
spatial: Any = _spatial
plants: Any = _plant
tree: Any = _tree
analysis: Any = _analysis
framework: Any = _framework
primitives: Any = _primitives
PUSH, HERTZ = 400.0, 2.0  # N, on the carriage


class DrakeJoint(_framework.LeafSystem):
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
        # What the kernel keeps from step to step is the system's state: an output changes nothing.
        memory = self.DeclareDiscreteState(self.joint.memory.size)
        self.DeclarePeriodicDiscreteUpdateEvent(self.dt, 0.0, self.update)
        forces = [plants.ExternallyAppliedSpatialForce() for _ in range(2)]
        self.DeclareAbstractOutputPort(
            "forces", lambda: value.AbstractValue.Make(forces), self.forces
        )
        self._memory = memory

    def update(self, context: Any, states: Any) -> None:
        """Keep the kernel's memory of this step."""
        self.wrench(context)
        states.set_value(self._memory, self.joint.memory.ravel())

    def wrench(self, context: Any) -> np.ndarray:
        """Return the wrench on the part in a step from this state, (6,), N and N·m."""
        plant, here = self.plant, self.context
        plant.SetPositionsAndVelocities(here, self.get_input_port(0).Eval(context))
        count = plant.num_velocities()
        forces = tree.MultibodyForces(plant)
        plant.CalcForceElementsContribution(here, forces)  # gravity and springs
        push = self.get_input_port(1).Eval(context)
        push = push - plant.CalcInverseDynamics(here, np.zeros(count), forces)
        mass = plant.CalcMassMatrix(here)
        speed = plant.GetVelocities(here) + self.dt * np.linalg.solve(mass, push)
        jacobian = plant.CalcJacobianSpatialVelocity(
            here,
            tree.JacobianWrtVariable.kV,
            self.tip,
            np.zeros(3),
            self.undeformed,
            self.undeformed,
        )[[3, 4, 5, 0, 1, 2]]  # Drake has rotations first
        inverse = jacobian @ np.linalg.solve(mass, jacobian.T)
        pose = self.tip.CalcPose(here, self.undeformed)
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
            on_body = plants.ExternallyAppliedSpatialForce()
            on_body.body_index = body.index()
            on_body.p_BoBq_B = self.tip.CalcPose(self.context, body.body_frame()).translation()
            on_body.F_Bq_W = spatial.SpatialForce(tau=sign * moment, f=sign * force)
            on_bodies.append(on_body)
        output.set_value(on_bodies)


def scene(table: Table, dt: float = 1e-3, angle: float = 0.5) -> tuple[Any, Any, Any]:
    """Make the carriage on a spring, the bar and the pendulum at an angle, rad.

    Returns the simulator, the plant, and the plant's context.
    """
    builder = framework.DiagramBuilder()
    plant = builder.AddSystem(plants.MultibodyPlant(time_step=dt))
    carriage = plant.AddRigidBody("carriage", _sphere(20.0, 0.1))
    tip = plant.AddRigidBody("tip", _sphere(1.0, 0.03))
    rod = plant.AddRigidBody("rod", _sphere(2.0, 0.05, [0.0, 0.0, -0.3]))
    up, world = np.array([0.0, 0.0, 1.0]), plant.world_frame()
    lift = plant.AddJoint(tree.PrismaticJoint("lift", world, carriage.body_frame(), up))
    plant.AddForceElement(tree.PrismaticSpring(lift, 0.0, 2e4))
    at = math.RigidTransform(np.array([1.0, 0.0, 0.0]))
    end = plant.AddFrame(tree.FixedOffsetFrame("undeformed", carriage.body_frame(), at))
    plant.AddJoint(tree.QuaternionFloatingJoint("part", end, tip.body_frame()))
    axis = np.array([0.0, 1.0, 0.0])
    hinge = plant.AddJoint(tree.RevoluteJoint("hinge", tip.body_frame(), rod.body_frame(), axis))
    plant.Finalize()
    part = builder.AddSystem(DrakeJoint(plant, table, end, tip.body_frame()))
    on_lift = np.eye(plant.num_velocities())[lift.velocity_start()]
    push = builder.AddSystem(
        primitives.Sine(PUSH * on_lift, 2 * np.pi * HERTZ * np.ones_like(on_lift), 0.0 * on_lift)
    )
    builder.Connect(push.get_output_port(0), plant.get_applied_generalized_force_input_port())
    builder.Connect(push.get_output_port(0), part.get_input_port(1))
    builder.Connect(plant.get_state_output_port(), part.get_input_port(0))
    builder.Connect(part.get_output_port(0), plant.get_applied_spatial_force_input_port())
    simulator = analysis.Simulator(builder.Build())
    context = plant.GetMyMutableContextFromRoot(simulator.get_mutable_context())
    hinge.set_angle(context, angle)
    return simulator, plant, context


def _sphere(mass: float, radius: float, centre: Any = (0.0, 0.0, 0.0)) -> Any:
    """Return the inertia of a solid sphere, kg and m, about a body's origin."""
    moment = 0.4 * mass * radius**2
    return tree.SpatialInertia.MakeFromCentralInertia(
        mass, np.array(centre), tree.RotationalInertia(moment, moment, moment)
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
