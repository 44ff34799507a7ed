"""The engine MuJoCo, and facts of its models by name or number."""

from __future__ import annotations

from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from ..errors import JointError, required

Model: TypeAlias = Any  # mujoco.MjModel, mujoco.MjData: compiled, without types
Data: TypeAlias = Any

engine: Any = required("mujoco", "MujocoJoint", "'wrenchbook[mujoco]'")
OBJECT = engine.mjtObj
_RK4 = int(engine.mjtIntegrator.mjINT_RK4)  # to compare with an enumeration takes 0.8 us


def refuse_rk4(model: Model) -> None:
    """Raise JointError if a model is integrated by RK4."""
    if model.opt.integrator == _RK4:
        raise JointError(
            "the integrator RK4 evaluates forces four times a step, but the joint only once; use "
            "Euler, implicit or implicitfast"
        )


def block_positions(model: Model, dofs: NDArray[np.intp]) -> list[NDArray[np.intp]]:
    """Return rows, columns and places in MuJoCo's mass matrix of pairs of some freedoms."""
    if [int(number) for number in engine.__version__.split(".")[:2]] < [3, 17]:
        # Constraints of 3.3.7 do not feel what is added to the matrix.
        raise JointError("MujocoJoint needs MuJoCo 3.17 or newer; run: pip install 'mujoco>=3.17'")
    entries = []
    for row, dof in enumerate(dofs.tolist()):
        start, count = int(model.M_rowadr[dof]), int(model.M_rownnz[dof])
        columns = model.M_colind[start : start + count] - dofs[0]
        entries += [(row, int(at), start + k) for k, at in enumerate(columns) if at >= 0]
    return list(np.array(entries).T)


def body_number(model: Model, name: str) -> int:
    """Return the number of a named body; JointError if there is none."""
    # MuJoCo ends the process at a name that is None.
    number = engine.mj_name2id(model, OBJECT.mjOBJ_BODY, name) if isinstance(name, str) else -1
    if number < 0:
        names = [engine.mj_id2name(model, OBJECT.mjOBJ_BODY, k) for k in range(1, model.nbody)]
        known = ", ".join(repr(text) for text in names if text) or "none with a name"
        raise JointError(f"the scene has no body {name!r}; it has {known}")
    return number
