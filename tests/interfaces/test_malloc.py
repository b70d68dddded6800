"""Memory that the command line keeps. Oracle: the pages that the system counts for a process of its own."""

import platform
import subprocess
import sys

import pytest

CHILD = """
import ctypes, os
from pathlib import Path
from rvjax._jax import programs

def resident():
    return int(Path("/proc/self/statm").read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE")

if {keep}:
    programs.keep_memory()
libc = ctypes.CDLL(None)
libc.malloc.restype, libc.free.argtypes = ctypes.c_void_p, [ctypes.c_void_p]
before = resident()
block = libc.malloc({size})
ctypes.memset(block, 1, {size})
libc.free(block)
print(resident() - before)
"""


@pytest.mark.skipif(platform.libc_ver()[0] != "glibc", reason="another C library")
def test_a_large_block_stays_with_the_process():
    size = 64 * 2**20

    def left(keep):
        code = CHILD.format(keep=keep, size=size)
        return int(subprocess.run([sys.executable, "-c", code], capture_output=True, check=True).stdout)

    assert left(keep=True) > 0.9 * size
    assert left(keep=False) < 0.1 * size
