"""What a picture frees is there for the next one: the system is asked for no memory again."""

import platform
import subprocess
import sys

import pytest

ASKS = """
import resource, sys
import numpy as np
from nlos.live.own_process import keep_freed_memory

if sys.argv[1] == "kept":
    assert keep_freed_memory()

def faults():
    before = resource.getrusage(resource.RUSAGE_SELF).ru_minflt
    for _ in range(20):
        held = [np.ones(1 << 21, np.uint8) for _ in range(8)]
        del held
    return resource.getrusage(resource.RUSAGE_SELF).ru_minflt - before

faults()
print(faults())
"""


@pytest.mark.skipif(platform.libc_ver()[0] != "glibc", reason="another library hands out memory")
def test_freed_memory_is_not_asked_for_again() -> None:
    asked = [
        int(subprocess.run([sys.executable, "-c", ASKS, how], capture_output=True, text=True, check=True).stdout)
        for how in ("kept", "as ever")
    ]
    assert asked[0] < 0.1 * asked[1]
