"""The engine MuJoCo, for joints and mounts: its types, names of its objects, and its resets."""

from __future__ import annotations

from typing import Any, TypeAlias

from .errors import required

Model: TypeAlias = Any  # mujoco.MjModel, mujoco.MjData: compiled, without types
Data: TypeAlias = Any

engine: Any = required("mujoco", "a MuJoCo scene", "'wrenchbook[mujoco]'")
OBJECT = engine.mjtObj
_UNSTABLE = tuple(
    getattr(engine.mjtWarning, f"mjWARN_BAD{name}") for name in ("QPOS", "QVEL", "QACC")
)


def was_reset(data: Data) -> bool:
    """Return whether MuJoCo has reset a scene because it was unstable."""
    return any(data.warning[kind].number for kind in _UNSTABLE)


def id_of(model: Model, kind: int, name: str) -> int:
    """Return the number of a named object of a kind of `OBJECT`, -1 if there is none."""
    # MuJoCo ends the process if a name is None.
    return engine.mj_name2id(model, kind, name) if isinstance(name, str) else -1


def name_of(model: Model, number: int, kind: int = OBJECT.mjOBJ_BODY) -> str:
    """Return the name of an object, by default a body, or its number after ``#`` without one."""
    return engine.mj_id2name(model, kind, int(number)) or f"#{number}"
