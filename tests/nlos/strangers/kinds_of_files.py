"""One small good file of every kind that some verb reads, and the verbs that read it."""

import gzip
import shutil
import socket
from collections.abc import Sequence
from pathlib import Path

import h5py
import numpy as np

from nlos.acquisition.exporters.matlab import write_matlab
from nlos.acquisition.exporters.npz import write_npz
from nlos.acquisition.exporters.ptu import write_ptu
from nlos.acquisition.exporters.scan_arrays import arrays_of_import
from nlos.acquisition.exporters.ytal import write_ytal
from nlos.acquisition.importers.formats import read_any
from nlos.acquisition.importers.to_recording import write_recording
from nlos.acquisition.recording.recording import Recording, Status
from nlos.acquisition.recording.writer import RecordingWriter
from nlos.acquisition.served.ticket import Ticket, new_keys
from nlos.recon.weights.files import find_weights
from nlos.runs.index import RunsIndex
from tests.acquisition.importers.sdt_files import write_sdt

SHARED = Path(__file__).parents[4] / "shared" / "data" / "tcspc"
BY_PHCONVERT = Path(__file__).parents[2] / "acquisition" / "importers" / "phconvert_scan.h5.gz"
CONFIGS = Path(__file__).parents[3] / "configs"
SHAPE = (6, 5, 256)  # no two alike
BIN_S = 32e-12

RECORDING = (
    ("info",), ("verify",), ("recover", "-o", "new.h5", "--overwrite"),
    ("export", "--to", "npz,mat,ytal,ptu", "--overwrite"),
    ("reconstruct", "--method", "backprojection", "--overwrite"), ("calibrate", "-o", "c.h5", "--overwrite"),
    ("replay", "--speed", "max", "-o", "new.h5", "--overwrite"), ("report", "-o", "r.html", "--overwrite"),
    ("plan", "demo", "--like"), ("serve", "--idle-s", "0"), ("live", "--idle-s", "0", "--method", "backprojection"),
)  # fmt: skip
FOREIGN = (
    ("info",), ("import", "-o", "new.h5", "--overwrite"), ("reconstruct", "--method", "backprojection", "--overwrite"),
    ("calibrate", "-o", "c.h5", "--overwrite"), ("export", "--to", "npz", "-o", "out.npz", "--overwrite"), ("verify",),
    ("report", "-o", "r.html", "--overwrite"),
)  # fmt: skip
PICTURE = (("export", "--to", "ply", "--overwrite"), ("export", "--to", "vti", "--overwrite"), ("info",), ("verify",))
CONSTANTS = (
    ("reconstruct", "good.h5", "--method", "backprojection", "--overwrite", "--constants"),
    ("calibrate", "good.h5", "-o", "c.h5", "--overwrite", "--response"), ("info",),
)  # fmt: skip
SPOTS = (("calibrate", "good.h5", "-o", "c.h5", "--overwrite", "--spots"),)
SCENE = (("evaluate", "--methods", "backprojection", "--conditions", "transient", "--overwrite", "--data"), ("info",))
YAML = (("plan",), ("devices", "--bench"))
BENCH = (("plan", "demo", "--bench"), ("devices", "--bench"))
WEIGHTS = (("reconstruct", "good.h5", "--method", "lfe", "--overwrite", "--weights"),)
TICKET = (("reconstruct", "--method", "backprojection", "--follow", "-o", "far", "--overwrite"), ("info",),
          ("serve", "good.h5", "--idle-s", "0"))  # fmt: skip
RUNS = (("runs", "--folder", "shelf"), ("runs", "--folder", "shelf", "--rebuild"), ("runs", "cap", "--folder", "shelf"))
KINDS = (
    "plain", "npz", "mat", "ytal", "ptu", "mat73", "plain_free", "recording", "killed", "free_recording", "picture",
    "constants", "response", "spots", "scene", "scan_yaml", "bench_yaml", "queue_yaml", "train_yaml", "weights", "phd",
    "t3r", "pt3", "ht3", "ptu_t2", "sdt", "photon_hdf5",
)  # fmt: skip


KEPT = ("ticket", "runs_index")
"""What programs keep for each other: of a served recording, and of a folder of recordings."""


def laid(folder: Path, kind: str, path: Path, words: Sequence[str], raw: bytes) -> tuple[str, ...]:
    """The command that reads `raw` instead of the good file at `path`; puts it where the command looks for it."""
    if kind == "runs_index":
        path.write_bytes(raw)
        return tuple(words)
    if words[0] == "serve" and kind == "ticket":
        (folder / "good.ticket").write_bytes(raw)
        return tuple(words)
    damaged = folder / f"damaged{path.suffix}"
    damaged.write_bytes(raw)
    return (*words, damaged.name)


def verbs_of(kind: str) -> tuple[tuple[str, ...], ...]:
    """The commands that read a file of a kind; its name is to be appended."""
    special = {"recording": RECORDING, "killed": RECORDING, "free_recording": RECORDING, "picture": PICTURE}
    special |= {"constants": CONSTANTS, "response": CONSTANTS, "spots": SPOTS, "scene": SCENE, "scan_yaml": YAML}
    special |= {"bench_yaml": BENCH, "queue_yaml": (("queue", "--plan"),), "weights": WEIGHTS}
    special |= {"train_yaml": (("train", "--check", "-o", "trained", "--overwrite"),)}
    return (special | {"ticket": TICKET, "runs_index": RUNS}).get(kind, FOREIGN)


def make(folder: Path) -> dict[str, Path]:
    """Kind -> a good file of it, in `folder`; `good.h5` beside them is a recording for verbs that take two files."""
    rng = np.random.default_rng(0)
    kinds = {"plain": folder / "plain.h5"}
    counts = _counted(rng)
    with h5py.File(kinds["plain"], "w") as file:
        file["histograms"], file["time_offset_bins"] = counts, np.full(SHAPE[:2], 2.0)
        file.attrs.update({"bin_width_s": BIN_S, "wall_size_m": [0.7, 0.5], "direct_cut_bins": 3, "rectified": 0})
    scan = read_any(kinds["plain"])
    arrays = arrays_of_import(scan, kinds["plain"])
    for kind, suffix, write in (("npz", ".npz", write_npz), ("mat", ".mat", write_matlab),
                                ("ytal", ".hdf5", write_ytal), ("ptu", ".ptu", write_ptu)):  # fmt: skip
        kinds[kind] = folder / f"scan{suffix}"
        write(arrays, kinds[kind])
    kinds["sdt"], kinds["photon_hdf5"] = write_sdt(folder / "scan.sdt", [counts]), folder / "photons.h5"
    kinds["photon_hdf5"].write_bytes(gzip.decompress(BY_PHCONVERT.read_bytes()))
    kinds["mat73"] = folder / "scan73.mat"
    with h5py.File(kinds["mat73"], "w", userblock_size=512) as file:
        file["meas"] = np.ascontiguousarray(counts.astype(np.float64).T)
        file["bin_resolution"], file["wall_size"] = 32e-12, 2.0
    kinds["plain_free"] = folder / "free.h5"
    with h5py.File(kinds["plain_free"], "w") as file:
        file["histograms"] = counts.reshape(-1, SHAPE[2])
        file["x_m"], file["y_m"] = rng.uniform(-0.3, 0.3, (2, SHAPE[0] * SHAPE[1]))
        file.attrs.update({"bin_width_s": BIN_S, "rectified": 0})
    for kind, source in (("recording", "plain"), ("killed", "plain"), ("free_recording", "plain_free")):
        kinds[kind] = folder / f"{kind}.h5"
        write_recording(read_any(kinds[source]), kinds[source], kinds[kind])
    write_recording(scan, kinds["plain"], folder / "good.h5")
    with Recording.open(folder / "good.h5") as recording:
        writer = RecordingWriter.create(kinds["killed"], recording.plan, recording.header, overwrite=True)
        for sample in list(recording.samples())[:17]:
            writer.write(sample)
        writer.finish(Status.RUNNING)
    kinds["picture"], kinds["constants"], kinds["response"] = (
        folder / f"{n}.h5" for n in ("picture", "constants", "irf")
    )
    with h5py.File(kinds["picture"], "w") as file:
        file["albedo"], file["depth_m"] = rng.random((4, 5)), np.ones((4, 5))
        file["x_m"], file["y_m"], file["confidence"] = np.arange(5.0), np.arange(4.0), np.ones((4, 5))
        file["volume"], file["depths_m"] = rng.random((6, 4, 5)), np.linspace(0.5, 1, 6)
        file.attrs.update({"method": "lct", "settings": "{}", "seconds": 1.0, "weights_sha256": "", "software": "",
                           "wall_size_m": (1.0, 1.0)})  # fmt: skip
    _write_constants(kinds["constants"])
    with h5py.File(kinds["response"], "w") as file:
        file["counts"] = np.exp(-0.5 * ((np.arange(64) - 20) / 3) ** 2) * 1e4
        file["time_s"] = np.arange(64) * BIN_S
    kinds["spots"] = folder / "spots.csv"
    kinds["spots"].write_text(
        "x_deg,y_deg,x_m,y_m\n" + "".join(f"{x},{y},{x / 60},{y / 60}\n" for x, y in rng.uniform(-5, 5, (9, 2)))
    )
    kinds["scene"] = folder / "scene.h5"
    with h5py.File(kinds["scene"], "w") as file:
        file["transient"] = counts.astype(np.float32)
        file["gt_intensity"], file["gt_depth"], file["gt_mask"] = (np.ones(SHAPE[:2], np.float32) for _ in range(3))
        file.attrs.update({"bin_width_s": BIN_S, "wall_size_m": 0.7})
    kinds["scan_yaml"] = folder / "scan.yaml"
    kinds["scan_yaml"].write_text(
        "wall: {width_m: 0.5, height_m: 0.5, rows: 4, cols: 4}\npattern: serpentine\ndwell_ms: 2\n"
        "histogram: {bins: 1024, bin_width_ps: 16, offset_ns: 10}\n"
    )
    kinds |= _settings(folder)
    kinds["weights"] = folder / "lfe.safetensors"
    shutil.copyfile(find_weights("lfe"), kinds["weights"])
    for kind, name in (("phd", "picoharp_v20.phd"), ("t3r", "timeharp_v50.t3r"), ("pt3", "picoharp_topfluorPE.pt3"),
                       ("ht3", "hydraharp_v20.ht3"), ("ptu_t2", "hydraharp_v30_t2.ptu")):  # fmt: skip
        if (SHARED / name).is_file() and (SHARED / name).stat().st_size:
            kinds[kind] = folder / name
            shutil.copyfile(SHARED / name, kinds[kind])
    kinds |= _kept(folder)
    return {kind: kinds[kind] for kind in (*KINDS, *KEPT) if kind in kinds}


def _kept(folder: Path) -> dict[str, Path]:
    """A ticket that nobody answers any more, and the index of three recordings, one of them of a killed scan."""
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        port = taken.getsockname()[1]
    with Recording.open(folder / "good.h5") as recording:
        identity = recording.header.identity
    keys = new_keys()
    Ticket(f"tcp://127.0.0.1:{port}", keys[0], *new_keys(), identity).save(folder / "run.ticket")
    (folder / "shelf" / "cap").mkdir(parents=True)
    for name in ("free_recording", "good", "killed"):
        shutil.copyfile(folder / f"{name}.h5", folder / "shelf" / ("cap" if name == "good" else "") / f"{name}.h5")
    with RunsIndex(folder / "shelf") as index:
        index.update()
    return {"ticket": folder / "run.ticket", "runs_index": index.place}


def _settings(folder: Path) -> dict[str, Path]:
    """A bench, a queue of two scans and a training of few steps, each as a file of its own."""
    kinds = {kind: folder / f"{kind}.yaml" for kind in ("bench_yaml", "queue_yaml", "train_yaml")}
    shutil.copyfile(CONFIGS / "bench" / "simulated.yaml", kinds["bench_yaml"])
    kinds["queue_yaml"].write_text(
        "folder: series\noperator: Ada\non_alarm: skip\nruns:\n"
        "  - {scan: scan.yaml, sample: hat, set: {dwell_ms: 1}}\n  - {scan: scan.yaml, note: again}\n"
    )
    kinds["train_yaml"].write_text(
        "method: unet\nmethod_settings: {widths: [4, 8], finish_widths: [8, 8], core_points: 8}\n"
        "data: {scenes: 4, rows: 8, cols: 8, bins: 64, bin_width_ps: 256.0}\n"
        "validation: {seed: 2, scenes: 2, rows: 8, cols: 8, bins: 64, bin_width_ps: 256.0}\n"
        "samples: 8\nbatch: 2\nwarm_up_steps: 1\n"
    )
    return kinds


def _counted(rng: np.random.Generator) -> np.ndarray:
    """A wall of 0.7 x 0.5 m seen from 1 m, and a patch 0.4 m behind it: (H, W, T)."""
    x, y = np.meshgrid((np.arange(SHAPE[1]) - 2) * 0.14, (2.5 - np.arange(SHAPE[0])) * 0.5 / 6)
    direct = 2 * np.sqrt(x**2 + y**2 + 1) / 299792458 / BIN_S - 200
    hidden = direct + 2 * np.sqrt(x**2 + y**2 + 0.16) / 299792458 / BIN_S
    bins = np.arange(SHAPE[2])
    rates = 3000 * np.exp(-0.5 * ((bins - direct[..., None]) / 1.5) ** 2)
    rates += 60 * np.exp(-0.5 * ((bins - hidden[..., None]) / 1.5) ** 2) + 0.1
    return rng.poisson(rates).astype(np.uint16)


def _write_constants(path: Path) -> None:
    from nlos.calibration.arrivals import Arrivals
    from nlos.calibration.constants import BenchConstants, Quantity, save

    arrivals = Arrivals(np.array([0.0, 0.0, 1.0]), 1e-9, np.eye(4) * 1e-12, 1e-12, *np.zeros((3, 4)))
    save(
        BenchConstants({"mirror": "a"}, "2026-01-01T00:00:00", ("x",), BIN_S, arrivals, dark_hz=Quantity(100.0, 1.0)),
        path,
    )
