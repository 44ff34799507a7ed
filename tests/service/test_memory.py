"""How much address space the threads of a server take."""

import ctypes
import subprocess
import sys

import pytest

# In a process of its own: how many heaps there may be is set once, for all of its threads.
PROGRAM = """
import resource, threading
from wrenchbook.service.files.program import keep_few_heaps
keep_few_heaps()
resource.setrlimit(resource.RLIMIT_AS, (1 << 30, 1 << 30))
end = threading.Event()
def hold():
    kept = [bytearray(1000) for _ in range(1000)]
    end.wait()
threads = [threading.Thread(target=hold) for _ in range(40)]
for thread in threads:
    thread.start()
end.set()
"""


@pytest.mark.skipif(not hasattr(ctypes.CDLL(None), "mallopt"), reason="glibc's heaps")
def test_forty_threads_start_in_a_gigabyte_of_addresses():
    run = subprocess.run([sys.executable, "-c", PROGRAM], capture_output=True, text=True)
    assert (run.returncode, run.stderr) == (0, "")
