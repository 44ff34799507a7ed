"""Functions that behave in the sandbox as a hostile file makes its reader behave."""

import io
import os
import resource
import signal
import stat
import sys
from pathlib import Path

import numpy as np

from wrenchbook.service.sandbox import Part


def doubled(path, factor):
    yield Part({"read": path.read_text(), "factor": factor}, {"rows": np.arange(6.0).reshape(2, 3)})
    yield Part({}, {"none": np.empty((0, 6)), "flags": np.array([True, False])})


def greedy(path):
    yield Part({"bytes": len(bytearray(1 << 40))})


def endless(path):
    while True:
        pass


def asleep(path):
    signal.pause()
    yield Part()


def timers(path):
    yield Part(
        {
            "processor": signal.getitimer(signal.ITIMER_PROF)[0],
            "hard": resource.getrlimit(resource.RLIMIT_CPU)[1],
            "elapsed": signal.getitimer(signal.ITIMER_REAL)[0],
        }
    )


def disarming(path):
    signal.setitimer(signal.ITIMER_REAL, 0)
    signal.pause()
    yield Part()


def wordy(path):
    while True:
        yield Part({}, {"zeros": np.zeros(1 << 17)})


def crashing(path):
    os.kill(os.getpid(), signal.SIGSEGV)


def killed(path):
    os.kill(os.getpid(), signal.SIGKILL)  # as the out-of-memory killer does


def refusing(path):
    raise LookupError("there is no such column")


def stumbling(path):
    raise ValueError(f"{path}/none is not there")


def lying(path, content=b"\xff" * 64):
    # The only regular file that is open is the one for the answer.
    mine = [fd for fd in range(3, 64) if Path(f"/proc/self/fd/{fd}").exists()]
    answer = next(fd for fd in mine if stat.S_ISREG(os.fstat(fd).st_mode))
    os.write(answer, content)
    return ()


def boasting(path):
    header = io.BytesIO()
    form = {"descr": "|u1", "fortran_order": False, "shape": (10**30,)}
    np.lib.format.write_array_header_1_0(header, form)
    return lying(path, header.getvalue())


def babbling(path):
    lying(path)
    os._exit(0)


def vanishing(path):
    os._exit(0)


def leaving(path):
    os._exit(3)


def modules(path):
    yield Part({"modules": sorted(sys.modules), "pid": os.getpid(), "parent": os.getppid()})
