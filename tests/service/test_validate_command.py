"""``wrenchbook validate``: the suite in a process of its own, its status handed on."""

import subprocess
import sys

import pytest


def command(*words):
    return subprocess.run(
        [sys.executable, "-m", "service.cli.main", "validate", *words],
        capture_output=True,
        text=True,
        timeout=120,
        check=False,
    )


@pytest.mark.parametrize(("options", "told"), [((), "6 pass"), (("--markdown",), "| pass |")])
def test_a_topic_is_verified_and_printed(options, told):
    done = command("curved_beam", *options)
    assert done.returncode == 0, done.stderr
    assert told in done.stdout
    assert "MacNeal and Harder 1985" in done.stdout


def test_an_unknown_topic_is_refused_with_the_ones_there_are():
    done = command("shell")
    assert done.returncode == 2
    assert "curved_beam" in done.stderr
