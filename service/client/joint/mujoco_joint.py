"""The joint in MuJoCo: three slides and a ball between base and tip carry the part's wrench."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, TypeAlias
from weakref import WeakKeyDictionary, WeakValueDictionary

import numpy as np
from numpy.typing import NDArray

from ..errors import JointError, JointWarning, required, warn
from .joint import FREEDOMS, Joint, quaternion

if TYPE_CHECKING:
    from ..table import Table

Model: TypeAlias = Any  # mujoco.MjModel, mujoco.MjData: compiled, without types
Data: TypeAlias = Any

engine: Any = required("mujoco", "MujocoJoint", "'wrenchbook[mujoco]'")
_JOINT, _OBJECT = engine.mjtJoint, engine.mjtObj
_SQUARE = 1e-5  # the axes of the slides are unit and orthogonal to the six digits of MuJoCo's XML
# The joints of each MjData by the first freedom of their tips: a step is of all of them.
_JOINTS: WeakKeyDictionary[Data, WeakValueDictionary[int, MujocoJoint]] = WeakKeyDictionary()
_REMEDY = "make the scene with: wrenchbook joint NAME --base BODY --tip BODY scene.xml"


class MujocoJoint(Joint):
    """A part that bends between two bodies of a MuJoCo scene, on bases that move too.

    The tip's body is a child of the base's body and has three slides and a ball (of a part with
    locked freedoms those that are free) at the interface point, in this order: MuJoCo turns the
    axes of what follows a ball. The axes of the slides are those of the undeformed interface
    frame. The joints have no stiffness, damping or limits: the part has these.

    Parameters
    ----------
    model, data : MjModel, MjData
    table : Table
    base, tip : str
        Names of the two bodies.
    damping : float
        Share of critical damping of each mode of the part between the two bodies.
    **options
        Of `Joint`.

    Raises
    ------
    JointError
        If the scene has no such bodies or joints, or its integrator is RK4.
    InvalidArgument
        See `Joint`.

    Notes
    -----
    Generalised forces on the slides and the ball act on both sides, so that the reaction on the
    base is there by itself. `step` takes the place of ``mj_step``; of several joints in one scene
    `step_joints` does. Contacts and other constraints feel the part within the step, so that stiff
    parts on MuJoCo's default contacts do not chatter. Where the base is fixed to the world and the
    tip's centre of mass is the interface point MuJoCo stores a diagonal mass matrix, and the
    contact forces of the last step stand for those of this one: an empty ``<body/>`` in the tip
    avoids it.
    """

    def __init__(
        self,
        model: Model,
        data: Data,
        table: Table,
        base: str = "base",
        tip: str = "tip",
        damping: float = 0.02,
        **options: Any,
    ) -> None:
        super().__init__(table, damping, **options)
        if model.opt.integrator == engine.mjtIntegrator.mjINT_RK4:
            raise JointError(
                "the integrator RK4 evaluates forces four times a step, and the joint once: use "
                "Euler, implicit or implicitfast"
            )
        self._model, self._data = model, data
        parent, body = _body(model, base), _body(model, tip)
        if model.body_parentid[body] != parent:
            raise JointError(f"body {tip!r} must be a child of body {base!r}; {_REMEDY}")
        self._find(body, tip)
        self._base, self._tip, self._pose = base, tip, None
        self._name = f"{table.name} at tip {tip!r}"
        # The last body towards the base that no freedom moves: a mocap body, or the world.
        while model.body_dofnum[top := int(model.body_weldid[parent])]:
            parent = int(model.body_parentid[top])
        self._still = parent
        _JOINTS.setdefault(data, WeakValueDictionary())[self._dofs.start] = self

    def step(self) -> None:  # type: ignore[override]
        """Advance the scene by one time step; call it in the place of ``mj_step``.

        Raises
        ------
        JointRangeError
            See `Joint.step`.
        """
        step_joints(self)

    def _find(self, body: int, name: str) -> None:
        """Find the joints of the tip: axes, places in qpos and qvel."""
        model, first = self._model, int(self._model.body_jntadr[body])
        joints = list(range(first, first + int(model.body_jntnum[body])))
        kinds = [int(model.jnt_type[joint]) for joint in joints]
        moves, turns = self.free[self.free < 3], self.free[self.free >= 3]
        if len(turns) not in (0, 1, 3):
            raise JointError(
                f"{self._table.name} locks one rotation of three: no MuJoCo joint does"
            )
        turning = {0: [], 1: [_JOINT.mjJNT_HINGE], 3: [_JOINT.mjJNT_BALL]}[len(turns)]
        expected = [int(kind) for kind in [_JOINT.mjJNT_SLIDE] * len(moves) + turning]
        if kinds != expected:
            also = {0: "", 1: " and a hinge", 3: " and a ball"}[len(turns)]
            raise JointError(
                f"body {name!r} must have {len(moves)} slides{also}, in this order; {_REMEDY}"
            )
        for joint in joints:
            dof = int(model.jnt_dofadr[joint])
            forces = {
                "stiffness": model.jnt_stiffness[joint],
                "damping": model.dof_damping[dof],
                "frictionloss": model.dof_frictionloss[dof],
                "a limited range": model.jnt_limited[joint],
            }
            present = [word for word, value in forces.items() if np.any(value)]
            if present:
                raise JointError(
                    f"a joint of body {name!r} has {present[0]}, which would add to the part's "
                    "own: remove it (a default class may set it)"
                )
        # The interface frame's axes in the tip's body; of a part with locked freedoms the body's.
        axis_of = {
            int(at): axis for at, axis in zip(self.free, model.jnt_axis[joints], strict=False)
        }
        straight = [axis_of[at] for at in range(3) if at in axis_of]
        left, _, right = np.linalg.svd(np.array(straight).T if len(straight) == 3 else np.eye(3))
        self._axes = left @ right
        hinges = [] if len(turns) == 3 else turns.tolist()
        along = [at for at in range(3) if at in axis_of] + hinges
        off = [np.abs(axis_of[at] - self._axes[:, at % 3]).max() for at in along]
        if max(off, default=0.0) > _SQUARE or np.linalg.det(self._axes) < 0:
            raise JointError(
                f"the joints of body {name!r} must have the interface frame's axes in the order x, "
                "y, z: unit, orthogonal and right-handed; of a part with locked freedoms these are "
                f"the body's own; {_REMEDY}"
            )
        self._slides = np.array(
            [model.jnt_qposadr[joint] for joint in joints[: len(moves)]], dtype=int
        )
        self._turn = int(model.jnt_qposadr[joints[-1]]) if turning else -1
        start = int(model.jnt_dofadr[first]) if joints else 0
        count = len(self.free)
        self._dofs = slice(start, start + count)
        self._units = np.eye(model.nv)[self._dofs]
        self._solved, self._square = np.empty_like(self._units), np.ix_(self.free, self.free)
        self._places = _places(model, np.arange(start, start + count))
        self._diagonal = len(self._places[0]) == count > 1
        self._turns, self._moves = len(turns) == 3, self.free[self.free < 3]
        self._hinge = np.zeros(3)
        self._hinge[turns[:1] - 3] = 1.0
        axes = np.ascontiguousarray(self._axes) if self._turns else None
        self._steps = self._table.packed.joints(1, self._at.start, self._method, axes)
        self.inputs = self.inputs

    def _push(self) -> None:
        """Apply the wrench of this step, as far as the motion before it determines it.

        The rest depends on the velocity after the step, and enters the mass matrix.
        """
        model, data, dofs, steps = self._model, self._data, self._dofs, self._steps
        dt = float(model.opt.timestep)
        self._watch_base()
        position, pose = data.qpos, steps.poses[0]
        pose[self._moves] = position[self._slides]
        if self._turns:
            pose[3:] = position[self._turn : self._turn + 4]
        elif self._turn >= 0:
            pose[3:] = quaternion(self._hinge * position[self._turn])
        engine.mj_solveM(model, data, self._solved, self._units)
        # Accelerations of the freedoms by unit loads on them.
        steps.inverse_masses[0][self._square] = self._solved[:, dofs]
        steps.law(dt, self.damping)
        self._heed(reply := steps.replies[0])
        force, slope = reply["force"][self.free], reply["rate"][self._square]
        applied = data.qfrc_applied
        if self._diagonal:  # nothing can be added to it: the last step's constraint forces stand
            applied[dofs] = 0.0
            engine.mj_fwdActuation(model, data)
            engine.mj_fwdAcceleration(model, data)
            pushed = np.empty((1, model.nv))
            engine.mj_solveM(model, data, pushed, data.qfrc_constraint[None])
            velocity = (data.qvel + dt * (data.qacc_smooth + pushed[0]))[dofs]
            implicit = np.eye(len(slope)) + dt * slope @ self._solved[:, dofs]
            force = np.linalg.solve(implicit, force + slope @ velocity)
            slope = np.zeros_like(slope)
        self._law = force, slope
        applied[dofs] = -(force + slope @ data.qvel[dofs])

    def _pull(self) -> None:
        """Take the wrench of the step from the velocity after it."""
        (force, slope), reply = self._law, self._steps.replies[0]
        pulled = np.zeros(FREEDOMS)
        pulled[self.free] = force + slope @ self._data.qvel[self._dofs]
        pulled[3:] = reply["spin"] @ pulled[3:]
        self.wrench = self._steps.history["last"][0] = pulled

    def _watch_base(self) -> None:
        """Warn once that the base has been put elsewhere by a body without velocity."""
        data, body = self._data, self._still
        if body == 0:  # the world
            return
        pose = np.concatenate([[data.time], data.xpos[body], data.xquat[body]])
        before, self._pose = self._pose, pose
        if before is None or pose[0] <= before[0] or (pose[1:] == before[1:]).all():
            return
        self._still = 0
        name = engine.mj_id2name(self._model, _OBJECT.mjOBJ_BODY, body) or f"#{body}"
        warn(
            f"{self._name}: base {self._base!r} moves by body {name!r}, which is moved between "
            "steps (a mocap body): MuJoCo gives it no velocity and no acceleration, so the tip "
            "does not feel the motion. Give the base joints of its own (slides or a "
            'free joint), and hold it to the mocap body by <weld torquescale="10" solref="'
            f'{2 * float(self._model.opt.timestep):g} 1" solimp="0.9999 0.9999 0.001"/>',
            JointWarning,
        )


def step_joints(*joints: MujocoJoint) -> None:
    """Advance a scene with one joint or more by a time step, in the place of ``mj_step``.

    The equation of motion with the joints' wrenches w + C v, v the velocity after the step, is
    (M + dt C) a = f - w - C v0: MuJoCo solves it with its contacts and other constraints.

    Raises
    ------
    JointError
        If the joints are not all of one scene, each of a tip, or its step is not above zero; see
        `Joint.step`.
    JointRangeError
        See `Joint.step`; the scene is where it was.
    """
    if not joints or any(joint._data is not joints[0]._data for joint in joints):
        raise JointError("step_joints takes the joints of one scene: one or more of the same data")
    data, stepped = joints[0]._data, {joint._dofs.start for joint in joints}
    if len(stepped) < len(joints):
        raise JointError("two joints have one tip, which would feel one of them: leave one out")
    every = [joint for joint in _JOINTS.get(data, {}).values() if joint._data is data]
    missing = [repr(joint._tip) for joint in every if joint._dofs.start not in stepped]
    if missing:
        tips = ", ".join(repr(joint._tip) for joint in joints)
        raise JointError(
            f"the scene has joints at the tips {tips} and {', '.join(missing)}: a step of one "
            "advances all of the scene, and the others would not pull. Call step_joints(a, b) of "
            "wrenchbook once with all of them, in the place of a.step(); b.step()"
        )
    model = joints[0]._model
    step = float(model.opt.timestep)
    if not step > 0:
        raise JointError(f"the scene's time step is {step} s: set it above 0")
    engine.mj_step1(model, data)
    for joint in joints:
        joint._push()
    for joint in joints:
        # What the velocity after the step changes.
        rows, columns, at = joint._places
        data.M[at] += step * joint._law[1][rows, columns]
    engine.mj_factorM(model, data)
    if model.opt.solver == engine.mjtSolver.mjSOL_PGS or model.opt.noslip_iterations:
        engine.mj_projectConstraint(model, data)
    engine.mj_step2(model, data)
    for joint in joints:
        joint._pull()


def _places(model: Model, dofs: NDArray[np.intp]) -> list[NDArray[np.intp]]:
    """Return rows, columns and places in MuJoCo's mass matrix of pairs of some freedoms."""
    if not hasattr(model, "M_rowadr"):
        raise JointError("MujocoJoint needs MuJoCo 4.0 or newer: pip install 'mujoco>=4.0'")
    entries = []
    for row, dof in enumerate(dofs.tolist()):
        start, count = int(model.M_rowadr[dof]), int(model.M_rownnz[dof])
        columns = model.M_colind[start : start + count] - dofs[0]
        entries += [(row, int(at), start + k) for k, at in enumerate(columns) if at >= 0]
    return list(np.array(entries).T)


def _body(model: Model, name: str) -> int:
    """Return the number of a named body."""
    number = engine.mj_name2id(model, _OBJECT.mjOBJ_BODY, name)
    if number < 0:
        names = [engine.mj_id2name(model, _OBJECT.mjOBJ_BODY, k) for k in range(1, model.nbody)]
        known = ", ".join(repr(text) for text in names if text) or "none with a name"
        raise JointError(f"the scene has no body {name!r}; it has {known}")
    return number
