"""The joint in MuJoCo: three slides and a ball between base and tip carry the part's wrench."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from typing import TYPE_CHECKING, Any, NamedTuple, TypeAlias
from weakref import WeakKeyDictionary, WeakValueDictionary

import numpy as np

from ..errors import InvalidArgument, JointError, JointWarning, warn
from ..mujoco import Data, Model, engine, name_of
from ..wrenches import Vector
from .joint import DAMPING, FREEDOMS, Joint, quaternion
from .mujoco_scene import (
    PoseRun,
    block_positions,
    body_number,
    find_tip,
    refuse_rk4,
    require_version,
    warn_unstable,
)
from .report import JointReport

if TYPE_CHECKING:
    from wrenchbook.surrogate.kernel.joint import JointSteps

    from ..table import Table

_PGS = int(engine.mjtSolver.mjSOL_PGS)  # a plain int: a comparison with an enumeration takes 0.8 us
# The joints of each MjData by the first freedom of each tip and their id, since a step is one of
# all tips.
_Registered: TypeAlias = "WeakValueDictionary[tuple[int, int], MujocoJoint]"
_JOINTS: WeakKeyDictionary[Data, _Registered] = WeakKeyDictionary()


class _Law(NamedTuple):
    """The wrench of f free freedoms in a step, as force + slope @ velocity."""

    force: Vector  # (f,), N and N·m
    slope: Vector  # (f, f): N and N·m per m/s and rad/s
    velocity: Vector  # (f,), m and rad/s: velocity after the step


class MujocoJoint(Joint):
    """A part that bends between two bodies of a MuJoCo scene, on bases that move too.

    The tip's body is a child of the base's body and has three slides and a ball (of a part with
    locked freedoms those that are free) at the interface point, in this order: MuJoCo turns the
    axes of what follows a ball. The axes of the slides are those of the undeformed interface
    frame. The joints have no stiffness, damping or limits: the part has these. A part that moves at
    several interfaces has a tip at each, all children of the base.

    Parameters
    ----------
    model, data : MjModel, MjData
        The scene and its state.
    table : Table
        As of `Joint`.
    base, tip : str
        Names of the two bodies.
    bodies : mapping of str, optional
        In the place of `tip`: the tips by interface, ``{"left": "wheel_l", "right": "wheel_r"}``.
    damping : float
        Damping ratio of each mode of the part between the two bodies: 1 is critical damping.
    interface, method, inputs
        As of `Joint`.

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
    avoids it. MuJoCo's mass matrix does not couple several tips of a part: each feels its own
    contacts within the step, and those of the others with the step after.
    """

    _mass_remedy = f"{Joint._mass_remedy}, and call mj_step1 before pull_joints"
    # Tips of the scene of which this object is a copy.
    _others_copied: Mapping[int, Sequence[str]] = {}

    def __init__(
        self,
        model: Model,
        data: Data,
        table: Table,
        base: str = "base",
        tip: str = "tip",
        damping: float = DAMPING,
        *,
        bodies: Mapping[str, str] | None = None,
        interface: str | None = None,
        method: str | None = None,
        inputs: Mapping[str, float] | None = None,
    ) -> None:
        if not (isinstance(model, engine.MjModel) and isinstance(data, engine.MjData)):
            kinds = [f"{type(each).__module__}.{type(each).__name__}" for each in (model, data)]
            raise InvalidArgument(
                "model and data must be a mujoco.MjModel and a mujoco.MjData, not "
                f"{' and '.join(kinds)}; with dm_control, pass physics.model.ptr and "
                "physics.data.ptr"
            )
        super().__init__(table, damping, interface=interface, method=method, inputs=inputs)
        require_version()
        refuse_rk4(model)

        self._model = model
        self._data = data
        self._base, self._tips = base, self._bodies(tip, bodies)
        tips = ", ".join(map(repr, self._tips))
        self.name = f"{table.name} at {'tips' if self._several else 'tip'} {tips}"

        parent = body_number(model, base)
        for name in self._tips:
            actual = int(model.body_parentid[body_number(model, name)])
            if actual != parent:
                raise JointError(
                    f"body {name!r} must be a child of body {base!r}, but it is a child of "
                    f"{name_of(model, actual)!r}; pass the name of its parent as base"
                )
        # The last body towards the base that no freedom moves: a mocap body, or the world.
        while model.body_dofnum[top := int(model.body_weldid[parent])]:
            parent = int(model.body_parentid[top])
        self._unmoved = parent
        self._find_freedoms()

    def step(self) -> None:  # type: ignore[override]
        """Advance the scene by one time step; call it in the place of ``mj_step``.

        Raises
        ------
        JointRangeError
            See `Joint.step`.
        """
        step_joints(self)

    def _bodies(self, tip: str, bodies: Mapping[str, str] | None) -> tuple[str, ...]:
        """Return the names of the tips in the order of the interfaces."""
        names = self.interfaces
        if bodies is not None and names == ("",):
            raise JointError(
                f"{self._table.name} has one interface; give tip=BODY instead of bodies"
            )
        if not isinstance(bodies, Mapping | None):
            bodies = {}
        if bodies is None:
            bodies = {} if self._several else {names[0]: tip}
        wrong = [f"no body for {name!r}" for name in names if name not in bodies]
        wrong += [f"no interface {name!r} that moves" for name in bodies if name not in names]
        single = {str(body) for body in bodies.values()}
        if len(single) < len(bodies):
            wrong.append("one body at two interfaces")
        if wrong:
            expected = ", ".join(f"{name!r}: BODY" for name in names)
            raise JointError(f"{self._table.name}: {'; '.join(wrong)}. Write bodies={{{expected}}}")
        return tuple(bodies[name] for name in names)

    def _find_freedoms(self) -> None:
        """Find the tips' freedoms in the scene, and their pairs in its mass matrix."""
        self._runs: list[tuple[int, PoseRun]] = []  # with the index of a tip
        self._hinges: list[tuple[int, Vector, int]] = []  # index of a tip, then as `Tip.hinge`
        self._starts: list[int] = []  # each tip's first freedom in MuJoCo's arrays
        self._blocks: list[slice] = []  # freedoms of tips whose pairs are in the mass matrix
        pairs, dofs, ball_axes = [], [], []
        for k, name in enumerate(self._tips):
            free = self.free[self.free // FREEDOMS == k] % FREEDOMS
            first = len(dofs)
            tip = find_tip(self._model, name, free, self._table.name)
            self._starts.append(tip.dof)
            ball_axes.append(tip.ball_axes)
            self._runs += [(k, run) for run in tip.runs]
            if tip.hinge:
                self._hinges.append((k, *tip.hinge))
            block = tip.dof + np.arange(len(free))
            rows, columns, positions = block_positions(self._model, block)
            is_diagonal = len(rows) == len(block) > 1  # MuJoCo stores no pair of two freedoms
            if not is_diagonal:
                self._blocks.append(slice(first, first + len(block)))
                pairs.append([len(self.free) * (first + rows) + first + columns, positions])
            dofs += block.tolist()

        self._pairs, self._at_pairs = np.hstack([np.empty((2, 0), dtype=int), *pairs])
        self._dofs: Any = np.array(dofs) if self._several else slice(dofs[0], dofs[-1] + 1)
        self._units = np.eye(self._model.nv)[self._dofs]
        # Indices of the free freedoms in the kernel's arrays, (6 k,) and (6 k, 6 k).
        self._moving, self._square = self.free, np.ix_(self.free, self.free)
        if len(self.free) == self._size:  # slices are faster
            self._moving = self._square = slice(None)
        if self._several:
            self.spin_axes = np.array([np.eye(3) if axes is None else axes for axes in ball_axes])
        else:
            self.spin_axes = ball_axes[0]
        self._begin(self.spin_axes)
        self.attach(self._data, self._steps, 0)

    def attach(self, data: Data, steps: JointSteps, at: int) -> None:
        """Use entry `at` of the kernel's arrays for the tips of a scene.

        Attributes are views of both, which stay valid: a scene's arrays and the kernel's never
        move. Raises InvalidArgument if the data belong to another model.
        """
        if data.signature != self._model.signature:
            raise InvalidArgument(
                "data belongs to another model; create it from this model: mujoco.MjData(model)"
            )
        self._use(steps, at)

        before = _JOINTS.get(self._data, {})
        self._data = data
        self._base_before = None
        self._scene = self._model.opt
        self._solved = np.empty_like(self._units)
        self._tip_pose, self._inverse_mass = steps.poses[at], steps.inverse_masses[at]
        self._velocity_before = steps.velocities[at].reshape(-1)
        self._velocity_before[:] = np.nan
        names = "force", "rate", "spin"
        self._force, self._slope, self._spin = (self._reply[name] for name in names)
        poses = self._tip_pose.reshape(-1, 7)
        qpos = data.qpos
        self._pose_views = [
            (poses[k, to : to + count], qpos[start : start + count])
            for k, (to, start, count) in self._runs
        ]
        self._hinge_views = [(poses[k, 3:], axis, qpos[q : q + 1]) for k, axis, q in self._hinges]

        self._velocities = data.qvel
        self._applied = data.qfrc_applied
        self._mass = data.M
        self._base_pose = data.xpos[self._unmoved], data.xquat[self._unmoved]

        for start in self._starts:
            before.pop((start, id(self)), None)
            _JOINTS.setdefault(data, WeakValueDictionary())[start, id(self)] = self

    def __getstate__(self) -> dict[str, Any]:
        """Return the state without MuJoCo's options, which the model has and cannot be pickled."""
        others = {at: joint._tips for at, joint in _by_tip(self._data).items() if joint is not self}
        state = {name: value for name, value in self.__dict__.items() if name != "_scene"}
        return state | {"_others_copied": others}

    def __setstate__(self, state: dict[str, Any]) -> None:
        super().__setstate__(state)
        self.attach(self._data, self._steps, self._entry)

    def _read_pose(self) -> None:
        """Write the tips' translations and quaternions into the kernel's arrays."""
        for pose, numbers in self._pose_views:
            pose[:] = numbers
        for pose, axis, angle in self._hinge_views:
            pose[:] = quaternion(axis * angle)

    def read_scene(self) -> None:
        """Write the pose and the inverse mass of this step into the kernel's arrays."""
        if self._unmoved:
            self._watch_base()
        now = float(self._data.time)
        if now not in self._times:  # the scene was set to another state, whose energy is unknown
            if self._began and not self._warned_unstable:
                self._warned_unstable = warn_unstable(self._data, self.name)
            self._began = self._began and (self._began[0], np.nan)
            # Otherwise the inverse's last bits would depend on the earlier state.
            self._memory[0] = 0.0
        self._times = now, now + self._scene.timestep
        self._read_pose()
        # For modes that keep their energy, constraint forces of the last step are too old.
        if not self.damping:
            lags = (self._several or not self._blocks) and self._data.nefc
            self._velocity_before[self._moving] = np.nan if lags else self._velocities[self._dofs]
        engine.mj_solveM(self._model, self._data, self._solved, self._units)
        self._inverse_mass[self._square] = self._solved[:, self._dofs]  # by unit loads

    def _push(self) -> None:
        """Apply the part of this step's wrench that the motion before it determines.

        The rest depends on the velocity after the step, and is added to the mass matrix.
        """
        dt, (force, slope) = self._scene.timestep, self._law_of_free()
        # The mass matrix cannot be changed: use the last step's constraint forces.
        if not self._blocks:
            force = _with_last_contacts([self], self._solved)[0]
            slope = np.zeros_like(slope)
        self._pull(force, slope, dt)

    def _pull(self, force: Vector, slope: Vector, dt: float) -> None:
        """Apply a wrench that changes with the velocity after the step."""
        velocity = self._velocities[self._dofs]
        self._law = _Law(force.copy(), slope.copy(), velocity)
        self._applied[self._dofs] = -force - slope.dot(velocity)  # faster than @
        # The change by the velocity after the step.
        self._own_mass = self._mass.take(self._at_pairs)
        self._with_part = self._own_mass + dt * slope.take(self._pairs)
        self._mass[self._at_pairs] = self._with_part

    def _law_of_free(self) -> tuple[Vector, Vector]:
        """Return wrench and rate of the freedoms that move, (f,) and (f, f)."""
        return self._force.reshape(-1)[self._moving], self._slope[self._square]

    def report(self) -> JointReport:
        """Return coverage, largest error bars and energy of all steps since `restart`."""
        parts = joints_of(self._data)
        began = self._began
        time, energy = began or (0.0, np.nan)
        if began and all(part._began == began for part in parts) and self._data.time in self._times:
            return self._report(time, _energy(parts) - energy)
        return self._report(time)

    def restart(self) -> None:
        """Delete the state of the last step."""
        count = len(self.free)
        self._law = _Law(np.zeros(count), np.zeros((count, count)), np.zeros(count))
        # Time, s, and energy, J, of the scene at the start.
        self._began: tuple[float, float] | None = None
        self._times = (0.0, 0.0)  # times of the scene before and after the last step, s
        self._with_part = None
        super().restart()

    def lose_wrench(self) -> None:
        """Set the wrench of the last step to NaN."""
        self._law = self._law._replace(force=np.full(len(self.free), np.nan))

    @property
    def wrench(self) -> Vector:
        """The wrench on the part in the last step, by the velocity after it; see `Joint.wrench`."""
        force, slope, velocity = self._law
        pulled = np.zeros(self._size)
        pulled[self.free] = force + slope @ velocity
        each = pulled.reshape(-1, FREEDOMS)
        for wrench, spin in zip(each, self._spin.reshape(-1, 3, 3), strict=True):
            wrench[3:] = spin @ wrench[3:]
        return each if self._several else pulled

    def _watch_base(self) -> None:
        """Warn once if the base was moved by a body without velocity."""
        data, body = self._data, self._unmoved
        position, turned = self._base_pose
        pose = data.time, position.tobytes(), turned.tobytes()  # faster than lists
        before = self._base_before
        self._base_before = pose
        if before is None or pose[0] <= before[0] or pose[1:] == before[1:]:
            return
        self._unmoved = 0
        name = name_of(self._model, body)
        warn(
            f"{self.name}: base {self._base!r} follows the mocap body {name!r}, whose motion the "
            "tip does not feel. Give the base slides or a free joint, and "
            'hold it to the mocap body by <weld torquescale="10" '
            f'solref="{2 * float(self._model.opt.timestep):g} 1" solimp="0.9999 0.9999 0.001"/>',
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
    require_scene(joints)
    model, data = joints[0]._model, joints[0]._data
    joints[0]._with_part = None
    engine.mj_step1(model, data)
    if joints[0]._with_part is None:  # joints_in_mj_step has not set it
        pull(joints)
    advance(joints)


def advance(joints: Sequence[MujocoJoint]) -> None:
    """Advance a scene whose joints pull."""
    engine.mj_step2(joints[0]._model, joints[0]._data)
    for joint in joints:
        law = joint._law
        velocity = joint._velocities[joint._dofs].copy()
        joint._law = _Law(law.force, law.slope, velocity)  # faster than _replace
        joint._mass[joint._at_pairs], joint._with_part = joint._own_mass, None


def pull_joints(*joints: MujocoJoint) -> None:
    """Apply a scene's joints in a step: call it between ``mj_step1`` and ``mj_step2``.

    Until the next ``mj_step1`` or ``mj_forward`` ``data.M`` has the parts' implicit terms too.

    Raises the errors of `step_joints`.
    """
    require_scene(joints)
    pull(joints)


def require_scene(joints: Sequence[MujocoJoint]) -> None:
    """Raise JointError unless joints are all those of one scene, whose time step is above zero."""
    if not joints:
        raise JointError(
            "step_joints has no joints to step; pass all joints of the scene: step_joints(a, b)"
        )
    scenes = len({joint._data for joint in joints})
    if scenes != 1:
        raise JointError(
            f"the {len(joints)} joints belong to {scenes} different MjData; call step_joints once "
            "for each MjData, with its own joints"
        )
    refuse_rk4(joints[0]._model)  # the user may have chosen it since

    stepped = [start for joint in joints for start in joint._starts]
    of_scene = _by_tip(joints[0]._data)
    tips = ", ".join(repr(tip) for joint in joints for tip in joint._tips)
    if len(set(stepped)) < len(stepped):
        raise JointError(
            f"two of the joints at {tips} have the same tip, which can follow only one of them; "
            "pass each tip once"
        )
    _require_present(joints, of_scene)
    if len(of_scene) > len(stepped):
        unstepped = dict.fromkeys(joint for at, joint in of_scene.items() if at not in stepped)
        missing = ", ".join(repr(tip) for joint in unstepped for tip in joint._tips)
        raise JointError(
            f"the scene has joints at the tips {tips} and {missing}: a step of one joint advances "
            "the complete scene without the others. Call wrenchbook.step_joints(a, b) once instead "
            "of a.step(); b.step() (MujocoJoints: a.step(b))"
        )

    if not 0 < (step := joints[0]._scene.timestep) < np.inf:
        raise JointError(
            f"the scene's time step is {step} s; set model.opt.timestep to a finite number above 0"
        )


def _require_present(joints: Sequence[MujocoJoint], of_scene: Mapping[int, MujocoJoint]) -> None:
    """Raise JointError if a joint of the scene was not copied, or was replaced by a newer one."""
    for joint in joints:
        for start, tips in joint._others_copied.items():
            if start not in of_scene:
                raise JointError(
                    f"this scene is a copy without the joint at {', '.join(map(repr, tips))}; copy "
                    "all joints of a scene together: copy.deepcopy([a, b])"
                )
        for start, tip in zip(joint._starts, joint._tips, strict=True):
            if of_scene[start] is not joint:
                raise JointError(f"a newer joint at {tip!r} replaced this one; step the newer one")


def pull(joints: Collection[MujocoJoint]) -> None:
    """Add the joints to the equation of motion, once ``mj_step1`` has computed pose and motion."""
    first = next(iter(joints))
    model, data, dt = first._model, first._data, first._scene.timestep
    refuse_rk4(model)
    if any(len(joint._steps.replies) > 1 for joint in joints):
        raise JointError(
            "a joint of MujocoJoints cannot step alone; call MujocoJoints.step instead"
        )
    for joint in joints:  # after a second call, unless MuJoCo has computed the matrix again
        if joint._with_part is not None:
            if (data.M[joint._at_pairs] == joint._with_part).all():
                data.M[joint._at_pairs] = joint._own_mass
                engine.mj_factorM(model, data)
            joint._with_part = None
    now = float(data.time)
    for joint in joints:
        joint.read_scene()
        joint._steps.law(dt, joint.damping)
        joint._check_status()
    push(joints)
    if new := [joint for joint in joints if joint._began is None]:
        began = now, _energy(joints)
        for joint in new:
            joint._began = began


def push(joints: Collection[MujocoJoint]) -> None:
    """Add the kernel's wrenches and rates to the equation of motion of a scene."""
    first = next(iter(joints))
    several = []
    for joint in joints:
        if joint._several:
            several.append(joint)
        else:
            joint._push()
    engine.mj_factorM(first._model, first._data)
    if several:
        _push_together(several)
    if first._scene.solver == _PGS or first._scene.noslip_iterations:
        engine.mj_projectConstraint(first._model, first._data)


def _push_together(joints: Sequence[MujocoJoint]) -> None:
    """Apply the wrenches of joints with several tips, whose pairs are not in the mass matrix.

    With the last step's constraint forces the wrench is w', and the velocity after it v'. A tip
    reacts to this step's constraint forces by its block of A' = (A^-1 + dt C)^-1: D = (A'^-1 -
    A^-1) / dt is added to the mass matrix, and the wrench is w' + D (v - v').
    """
    dt = joints[0]._scene.timestep
    wrench, velocity, mobility, implicit = _with_last_contacts(joints)
    velocity = velocity - dt * mobility @ wrench
    pulled = np.linalg.solve(implicit.T, mobility)
    for joint in joints:
        first = len(velocity) - len(wrench)
        count = len(joint.free)
        slope = np.zeros((count, count))
        for block in joint._blocks:
            at = slice(first + block.start, first + block.stop)
            added = np.linalg.inv(pulled[at, at]) - np.linalg.inv(mobility[at, at])
            slope[block, block] = (0.5 / dt) * (added + added.T)
        joint._pull(wrench[:count] - slope @ velocity[first : first + count], slope, dt)
        wrench = wrench[count:]
    engine.mj_factorM(joints[0]._model, joints[0]._data)


def _with_last_contacts(
    joints: Sequence[MujocoJoint], solved: Vector | None = None
) -> tuple[Vector, Vector, Vector, Vector]:
    """Return w', v, A and I + dt C A of free freedoms (f,), by the last step's constraint forces.

    `solved` (f, nv) has the rows of A, if they are known.
    """
    model, data, dt = joints[0]._model, joints[0]._data, joints[0]._scene.timestep
    dofs = np.concatenate([np.arange(model.nv)[joint._dofs] for joint in joints])
    force = np.zeros(len(dofs))
    slope = np.zeros((len(dofs), len(dofs)))
    first = 0
    for joint in joints:
        block = slice(first, first := first + len(joint.free))
        force[block], slope[block, block] = joint._law_of_free()
    data.qfrc_applied[dofs] = 0.0
    engine.mj_fwdActuation(model, data)
    engine.mj_fwdAcceleration(model, data)
    pushed = np.empty((1, model.nv))
    engine.mj_solveM(model, data, pushed, data.qfrc_constraint[None])
    if solved is None:
        solved = np.empty((len(dofs), model.nv))
        engine.mj_solveM(model, data, solved, np.eye(model.nv)[dofs])
    velocity = (data.qvel + dt * (data.qacc_smooth + pushed[0]))[dofs]
    mobility = solved[:, dofs]
    implicit = np.eye(len(slope)) + dt * slope @ mobility
    return np.linalg.solve(implicit, force + slope @ velocity), velocity, mobility, implicit


def _by_tip(data: Data) -> dict[int, MujocoJoint]:
    """Return the newest joint of each tip by the tip's first freedom."""
    return {start: joint for (start, _), joint in _JOINTS.get(data, {}).items()}


def joints_of(data: Data) -> list[MujocoJoint]:
    """Return the joints of a scene."""
    return list(dict.fromkeys(_by_tip(data).values()))


def warn_bare(model: Model) -> None:
    """Warn of a scene without joints whose model has joints in another scene."""
    if model.signature in {data.signature for data in [*_JOINTS] if _by_tip(data)}:
        warn(
            "an MjData steps without a joint, and others of its model have joints: nothing holds "
            "its tip. Make a MujocoJoint for each MjData, and keep it",
            JointWarning,
        )


def _energy(joints: Collection[MujocoJoint]) -> float:
    """Return the energy of a scene and the energy stored in its parts, J, half a step ago.

    MuJoCo's velocities belong between two positions: at that time the energy of an oscillation has
    no ripple.
    """
    first = next(iter(joints))
    model, data, fields = first._model, first._data, engine.mjtState.mjSTATE_INTEGRATION
    then = engine.MjData(model)
    state = np.empty(engine.mj_stateSize(model, fields))
    engine.mj_getState(model, data, state, fields)
    engine.mj_setState(model, then, state, fields)
    engine.mj_integratePos(model, then.qpos, then.qvel, -0.5 * first._scene.timestep)
    engine.mj_fwdPosition(model, then)
    engine.mj_energyPos(model, then)
    engine.mj_energyVel(model, then)
    total, now, data.qpos[:] = float(then.energy.sum()), data.qpos.copy(), then.qpos
    for joint in joints:
        steps = joint._steps
        memory, replies = steps.memory.copy(), steps.replies.copy()
        joint._read_pose()
        steps.law(joint._scene.timestep, joint.damping)
        total += float(steps.history["stored"][0]) if not joint._status[0] else np.nan
        steps.memory[:], steps.replies[:] = memory, replies
    data.qpos[:] = now
    return total
