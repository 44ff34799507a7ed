"""MuJoCo scenes with a joint, and packed tables of linear and made-up parts."""

from __future__ import annotations

from typing import Any

import mujoco as _mujoco
import numpy as np
from scipy.spatial.transform import Rotation

from tests.service.client.answers import bar_compliance
from wrenchbook.service.client import Table
from wrenchbook.surrogate.build import build
from wrenchbook.surrogate.kernel.binding import PackedTable
from wrenchbook.surrogate.packed.writer import pack
from wrenchbook.surrogate.table.rows import LoadRange, Rows

mujoco: Any = _mujoco

HIGH = np.array([4000.0, 800.0, 800.0, 200.0, 200.0, 200.0])  # N and N·m
SLIDES = "".join(f'<joint type="slide" axis="{axis}"/>' for axis in ("1 0 0", "0 1 0", "0 0 1"))
FREEDOMS = SLIDES + '<joint type="ball"/>'
SILENT = 'contype="0" conaffinity="0"'


def linear_table(compliance: np.ndarray | None = None, high: np.ndarray = HIGH) -> Table:
    """A table of a linear part; the bar of 1 m by default."""
    matrix = bar_compliance() if compliance is None else compliance
    wrenches = np.diag(high)
    rows = Rows.of(
        wrenches, wrenches @ matrix.T, compliance=np.tile(matrix, (6, 1, 1)), source=["fea"] * 6
    )
    return packed_table(rows, LoadRange(-high, high), linear=True)


def packed_table(rows: Rows, load_range: LoadRange, **options: Any) -> Table:
    """A table in this process."""
    content = b"".join(pack(build(rows, load_range, **options)))
    return Table(PackedTable.from_bytes(content), "bar")


def known_law(wrench: np.ndarray) -> np.ndarray:
    """The displacement of a bar that yields up to a tenth more or less, by all loads together."""
    share = np.tanh(wrench / HIGH @ np.array([0.3, 0.2, -0.4, 0.1, 0.2, 0.3]))
    return wrench @ bar_compliance().T * (1.0 + 0.1 * share)[..., None]


def known_table(count: int, seed: int = 0) -> Table:
    """Rows of `known_law` with tangents, at random wrenches; one of no load."""
    wrenches = np.random.default_rng(seed).uniform(-1, 1, (count, 6)) * HIGH
    wrenches[0] = 0.0
    around = np.einsum("ij,s->sij", np.diag(1e-6 * HIGH), [1.0, -1.0])[:, None]
    ahead, behind = known_law(wrenches[None, :, None] + around.reshape(2, 1, 6, 6))
    slopes = ((ahead - behind) / (2e-6 * HIGH)[:, None]).transpose(0, 2, 1)
    source = ["fea"] * count
    rows = Rows.of(wrenches, known_law(wrenches), compliance=slopes, source=source)
    return packed_table(rows, LoadRange(-HIGH, HIGH))


def scene(
    tip: str,
    dt: float = 1e-3,
    *,
    base: str = "",
    base_geom: str = f'<geom size=".02" mass="50" {SILENT}/>',
    joints: str = FREEDOMS,
    option: str = "",
    world: str = "",
    extra: str = "",
    height: float = 1.0,
    gravity: str = "0 0 -9.81",
) -> tuple[Any, Any]:
    """A tip, 1 m along x of a base, with the joints of a part between them."""
    model = mujoco.MjModel.from_xml_string(f"""
<mujoco>
  <option timestep="{dt}" gravity="{gravity}" {option}/>
  <worldbody>{world}
    <body name="base" pos="0 0 {height}">{base}{base_geom}
      <body name="tip" pos="1 0 0">{joints}{tip}</body>
    </body>
  </worldbody>
  {extra}
</mujoco>""")
    return model, mujoco.MjData(model)


def displacement_in(data: Any) -> np.ndarray:
    """The displacement, m and rad, of the last three slides and ball of a scene."""
    turned = Rotation.from_quat(data.qpos[-4:], scalar_first=True).as_rotvec()
    return np.concatenate([data.qpos[-7:-4], turned])


def sphere(mass: float, at: str = "0 0 0", geom: str = SILENT) -> str:
    """A sphere of 5 cm radius."""
    return f'<geom size=".05" mass="{mass}" pos="{at}" {geom}/>'
