"""An archive of a hundred scans on a cluster: five broken, a worker killed, the scheduler killed and begun again."""

import json
import os
import signal
import threading
import time
from pathlib import Path

import pytest

from tests.nlos.test_archives import archive, dask, free_port, nlos, record, times

SOAK = bool(os.environ.get("NLOS_SOAK"))


@pytest.mark.soak
@pytest.mark.skipif(not SOAK, reason="a campaign of minutes: make soak")
def test_ninety_five_results_and_five_reasons_whatever_dies(tmp_path: Path) -> None:
    archive(tmp_path / "in", 95, points=16, bins=128)
    out = tmp_path / "out"

    def when(count: int, done: threading.Event) -> None:
        while len(list(out.glob("*/depth.png"))) < count and not done.is_set():
            time.sleep(0.02)

    over = threading.Event()
    with dask(tmp_path, port := free_port(), 2) as (scheduler, crew):

        def kill() -> None:
            when(15, over)
            crew[0].send_signal(signal.SIGKILL)
            when(40, over)
            scheduler.send_signal(signal.SIGKILL)

        killer = threading.Thread(target=kill, daemon=True)
        killer.start()
        first = nlos(
            tmp_path, "reconstruct", "in", "-o", "out", "--no-volume", "--scheduler", f"tcp://127.0.0.1:{port}"
        )
        over.set()
        killer.join(10)
    assert first.returncode == 9, first.stderr
    assert "is gone" in first.stderr
    assert "Traceback" not in first.stderr
    rows, before = record(out), times(out)
    assert len(rows) == 100
    known = {name for name, row in rows.items() if row["outcome"] == "done"}
    with dask(tmp_path, port := free_port(), 2):
        again = ("--skip-existing", "--scheduler", f"tcp://127.0.0.1:{port}")
        second = nlos(tmp_path, "reconstruct", "in", "-o", "out", "--no-volume", *again)
    assert second.returncode == 7, second.stderr
    rows, after = record(out), times(out)
    twice = [name for name, at in before.items() if after[name] != at]
    print(json.dumps({"figure": "done_twice", "value": len(twice), "known_when_the_scheduler_died": len(known)}))
    assert len(after) == 95
    assert sorted(name for name, row in rows.items() if row["outcome"] == "done") == sorted(after)
    failed = {name: row["reason"] for name, row in rows.items() if row["outcome"] == "failed"}
    assert len(failed) == 5
    assert all(name.startswith("broken") and reason for name, reason in failed.items())
    assert not known & set(twice), "what was known to be done is not done again"
    assert len(twice) <= 2, "one at each worker was under way"
