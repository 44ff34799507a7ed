"""The mount on a real server with real solves: DirectFEA, and a table that fills meanwhile."""

from __future__ import annotations

import numpy as np
import pytest

from tests.service.client.scenes import made, mujoco
from wrenchbook.service.client import ServerUnreachable
from wrenchbook.service.client.mount import Mount, MountWarning
from wrenchbook.service.client.mount.mujoco_mount import MujocoMount

WEIGHT = np.array([0.0, 0.0, -30.0])  # N
LEVER = np.array([0.2, 0.0, 0.05])  # m


def lever(R, p):
    return np.concatenate([WEIGHT, np.cross(R @ LEVER, WEIGHT)])


def test_direct_fea_settles_where_the_table_does(server):
    client = server.start()
    solving = Mount(client, "bar", np.eye(3), np.zeros(3), mode="solve", solve_timeout=600)
    solved = solving.settle(lever, accuracy=0.1)
    assert solved.answer.source in ("fea", "table")
    by_table = Mount(client, "bar", np.eye(3), np.zeros(3), relaxation="newton")
    settled = by_table.settle(lever, accuracy=1e-6)
    assert settled.iterations <= 4
    off = np.abs(solved.displacement - settled.displacement)
    assert (off < 1e-6).all()  # m and rad: the bar's tolerance
    assert settled.displacement[2] < -1e-3


def test_a_loop_goes_on_over_an_empty_table_and_has_its_wrenches_solved(server):
    client = server.start()
    mount = Mount(client, "plate_thin", np.eye(3), np.zeros(3))
    with pytest.warns(MountWarning, match="cannot answer"):
        mount.step([0, 0, -60.0], [0, 5.0, 0])
    assert not mount.displacement.any()
    client.wait(mount.last.job, timeout=600)
    client.component("plate_thin", wait_s=60)
    mount.step([0, 0, -60.0], [0, 5.0, 0])
    assert mount.coverage.covered == 1
    assert mount.displacement[2] < 0
    server.kill()
    before = mount.displacement.copy()
    with pytest.raises(ServerUnreachable, match=r"wrenchbook serve|try again"):
        mount.step([0, 0, -70.0], [0, 5.0, 0])
    assert np.array_equal(mount.displacement, before)


def test_a_recorded_loop_queues_nothing_and_loses_nothing(server):
    client = server.start()
    model, data = made()
    mount = MujocoMount(
        model, data, source=client, component="plate_thin", mode="record", sync=0.005
    )
    data.qpos[0] = 1.0  # it swings
    for _ in range(3000):
        mujoco.mj_step(model, data)
        mount.step()
    mount.close()
    recorded = client.recording("plate_thin")
    assert recorded.total == 600
    assert len(recorded.wrenches) + recorded.merged == 600
    assert client.jobs("plate_thin") == []
    assert np.array_equal(data.mocap_pos[0], [0.4, -0.2, 1.5])  # rigid meanwhile
