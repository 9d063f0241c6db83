"""How much faster a second worker makes an archive: `nlos reconstruct` on Dask workers of one thread each, here; and
what `--scheduler local` brings, which starts them itself.

Seconds are wall time from the first result to the last, so that starting the workers does not count; for `local` and
the loop without workers, that it is compared with, they are those of the whole command. Run it on two cores that do
nothing else.
"""

import json
import os
import socket
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import h5py
import numpy as np

FILES, POINTS, BINS = 40, 64, 512


def figure(name: str, value: float, unit: str, target: float | None = None) -> None:
    met = None if target is None else bool(value >= target)
    print(
        json.dumps({"figure": name, "value": round(value, 4), "unit": unit, "target": target, "met": met}), flush=True
    )


def rate(folder: Path, workers: int) -> float:
    """Files a second."""
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    address, base = f"tcp://127.0.0.1:{port}", [sys.executable, "-m"]
    quiet = {"stderr": subprocess.DEVNULL, "env": os.environ | {"OMP_NUM_THREADS": "1"}}
    host = ["--host", "127.0.0.1", "--port", str(port), "--no-dashboard"]
    started = [subprocess.Popen([*base, "distributed.cli.dask_scheduler", *host], **quiet)]  # type: ignore[call-overload]
    words = [*base, "distributed.cli.dask_worker", address, "--nthreads", "1", "--no-dashboard", "--no-nanny"]
    started += [subprocess.Popen([*words, "--death-timeout", "60"], **quiet) for _ in range(workers)]  # type: ignore[call-overload]
    silent = {"stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL}
    out = folder / f"out{workers}"
    try:
        words = [*base, "nlos", "reconstruct", str(folder / "in"), "-o", str(out), "--method", "lct", "--no-volume"]
        for _ in range(20):
            if subprocess.run([*words, "--scheduler", address, "-q"], **silent, check=False).returncode == 0:
                break
        at = sorted(path.stat().st_mtime for path in out.glob("*/depth.png"))
    finally:
        for process in started:
            process.kill()
            process.wait()
    return (len(at) - 1 - 2 * workers) / (at[-1 - workers] - at[workers])  # not the first and last ones of each worker


def whole_s(folder: Path, *scheduler: str) -> float:
    """Of one command, its start included."""
    out = folder / f"whole{len(list(folder.iterdir()))}"
    words = [sys.executable, "-m", "nlos", "reconstruct", str(folder / "in"), "-o", str(out), "--method", "lct"]
    began = time.monotonic()
    subprocess.run(
        [*words, "--no-volume", "-q", *scheduler], stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL, check=True
    )
    return time.monotonic() - began


def main() -> None:
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        (folder / "in").mkdir()
        for number in range(FILES):
            with h5py.File(folder / "in" / f"{number:03d}.h5", "w") as file:
                counts = np.random.default_rng(number).poisson(1.0, (POINTS, POINTS, BINS))
                file.create_dataset("histograms", data=counts.astype(np.uint16), compression=1)
                file.attrs.update({"bin_width_s": 32e-12, "wall_size_m": 2.0})
        one, two = rate(folder, 1), rate(folder, 2)
        figure("files_per_s_one_worker", one, "1/s")
        figure("files_per_s_two_workers", two, "1/s")
        figure("two_workers", two / one, "times as fast as one", 1.8)
        loop_s, local_s = whole_s(folder), whole_s(folder, "--scheduler", "local")
        figure("loop_s", loop_s, "s")
        figure("local_s", local_s, "s")
        figure("local", loop_s / local_s, "times as fast as a loop", 1.0)


if __name__ == "__main__":
    main()
