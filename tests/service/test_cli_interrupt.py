"""Ctrl-C cancels the solves that the command itself has queued."""

from __future__ import annotations

import signal
import subprocess
import sys
from pathlib import Path

from tests.service.live import served


def test_ctrl_c_cancels_the_solves_of_a_fill_and_no_others(tmp_path: Path):
    """A fill that was interrupted left its solves in the queue."""
    with served(tmp_path) as client:
        other = client.solve("plate", [1, 2, -3], [0, 0, 0]).job
        assert other is not None
        # A shell starts its background commands with SIGINT ignored, and children inherit it.
        words = ["env", "--default-signal=INT", sys.executable, "-P", "-m", "wrenchbook"]
        words += ["fill", "plate", "--budget", "3"]
        words += ["--server", client.url]
        with subprocess.Popen(
            words,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
        ) as command:
            assert command.stdout is not None
            assert command.stdout.readline() == "choosing wrenches for plate\n"
            assert command.stdout.readline()  # the round: its solves are queued
            command.send_signal(signal.SIGINT)
            _, errors = command.communicate(timeout=60)
        states = {job.id: job.status for job in client.jobs("plate")}
        assert states.pop(other.id) == "waiting"
        assert set(states.values()) == {"cancelled"}
        assert command.returncode == 130
        assert " ".join(errors.split()) == (
            f"Interrupted: {len(states)} solve(s) of this command cancelled."
        )
