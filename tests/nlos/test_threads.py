"""`nlos` computes with threads that do not spin: OpenBLAS has one, and the others are as many as a container grants,
unless the environment says otherwise."""

import os
import subprocess
import sys

import pytest

LOOK = """
import os, sys
from nlos.__main__ import main
sys.argv = ["nlos", "--version"]
try:
    main()
except SystemExit:
    pass
import numpy as np
np.ones((600, 600)) @ np.ones((600, 600))
print(len(os.listdir("/proc/self/task")), os.environ["OPENBLAS_NUM_THREADS"])
"""


@pytest.mark.skipif(not os.path.isdir("/proc/self/task"), reason="counts threads as Linux lists them")
@pytest.mark.parametrize("said", [None, "2"])
def test_openblas_has_one_thread_unless_the_environment_says_otherwise(said: str | None) -> None:
    if said is not None and len(os.sched_getaffinity(0)) < 2:
        pytest.skip("needs two processors")
    environment = {name: value for name, value in os.environ.items() if not name.endswith("_NUM_THREADS")}
    environment |= {} if said is None else {"OPENBLAS_NUM_THREADS": said}
    done = subprocess.run(
        [sys.executable, "-c", LOOK], env=environment, capture_output=True, text=True, check=True, timeout=240
    )
    assert done.stdout.splitlines()[-1] == ("1 1" if said is None else "2 2")


GRANTED = """
import os, sys
import nlos.__main__ as command
sys.argv, command.granted = ["nlos", "--version"], lambda: 3
try:
    command.main()
except SystemExit:
    print(os.environ["OMP_NUM_THREADS"])
"""


@pytest.mark.parametrize("said", [None, "5"])
def test_as_many_threads_as_a_container_grants_unless_the_environment_says_otherwise(said: str | None) -> None:
    environment = {name: value for name, value in os.environ.items() if not name.endswith("_NUM_THREADS")}
    environment |= {} if said is None else {"OMP_NUM_THREADS": said}
    done = subprocess.run(
        [sys.executable, "-c", GRANTED], env=environment, capture_output=True, text=True, check=True, timeout=240
    )
    assert done.stdout.splitlines()[-1] == (said or "3")
