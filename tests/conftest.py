"""One thread a test process: several run side by side, and threads that wait for each other's cores cost all."""

import atexit
import itertools
import os
import shutil
import tempfile

import pytest

_STATE = tempfile.mkdtemp(prefix="nlos-state-")
atexit.register(shutil.rmtree, _STATE, ignore_errors=True)
_numbers = itertools.count()
os.environ["NLOS_STATE"] = _STATE

for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS"):
    os.environ.setdefault(name, "1")


@pytest.fixture(autouse=True)
def trips_of_a_test_stay_in_it(monkeypatch: pytest.MonkeyPatch) -> None:
    """Trips outlast a program; not a test, nor do they reach whoever runs the tests."""
    monkeypatch.setenv("NLOS_STATE", os.path.join(_STATE, str(next(_numbers))))
