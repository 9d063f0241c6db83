"""An imported scan as a recording of our own: one sample per measured point, and what else its file said."""

import json
import os
from collections.abc import Callable
from pathlib import Path

import numpy as np

from nlos.acquisition.errors import InvalidData, StorageError
from nlos.acquisition.importers.imported import FreePoints, ImportedScan
from nlos.acquisition.planning.plan import ScanPlan
from nlos.acquisition.planning.positions import free, pixels
from nlos.acquisition.recording.empty_file import put_in_place
from nlos.acquisition.recording.new_name import file_to_write
from nlos.acquisition.recording.provenance import Header
from nlos.acquisition.recording.recording import Recording
from nlos.acquisition.recording.writer import RecordingWriter
from nlos.acquisition.recording.writer_lock import lock_file
from nlos.acquisition.response import as_json
from nlos.acquisition.sample import Sample
from nlos.drivers.tcspc.counter import Histogram, HistogramAxis, HistogramFlag

_KEY = "imported"


def write_recording(
    scan: ImportedScan, source: Path, target: Path, *, overwrite: bool = False,
    step: Callable[[int], None] = lambda by: None,
) -> int:  # fmt: skip
    """Writes `target`, which appears once it is whole, and calls `step(1)` after each point; returns how many points it
    holds. Raises `InvalidData` where counts are not whole numbers of 32 bits, `StorageError` where `target` exists."""
    held = scan.held
    if (most := float(held.counts.max(initial=0))) > np.iinfo(np.uint32).max:
        raise InvalidData(
            f"{source}: {most:.0f} counts in one bin are more than the 32 bits of a recording hold; reconstruct it as "
            "it is"
        )
    counts = held.counts.astype(np.uint32)
    if not np.array_equal(counts, held.counts):
        raise InvalidData(
            f"{source}: its counts are not whole numbers, so they are not photon counts; reconstruct it as it is"
        )
    exposed = np.nonzero(held.exposure_s > 0)
    if isinstance(held, FreePoints):
        positions, histograms = free(held.x_m[exposed], held.y_m[exposed]), counts[exposed]
    else:
        positions, histograms = pixels(held.wall, *exposed), np.moveaxis(counts, 0, -1)[exposed]
    dwell_s, time = held.exposure_s[exposed], held.time
    axis = HistogramAxis(time.bins, time.bin_width_s, time.start_s)
    plan = ScanPlan(held.wall, axis, positions, dwell_s, np.zeros(len(dwell_s), np.int32))
    header = Header(scan_json=json.dumps({_KEY: _said(scan, source)})).stamped()
    started_s = np.concatenate([[0.0], np.cumsum(dwell_s)])
    if os.path.lexists(target) and not overwrite:  # a link to nothing, too
        raise StorageError(f"{target}: exists. Choose another name, or use --overwrite.")
    target = file_to_write(target)
    partial = target.with_name(f".{target.name}.part")
    try:
        with RecordingWriter.create(partial, plan, header, overwrite=True) as writer:
            for point in plan:
                histogram = np.ascontiguousarray(histograms[point.number])
                begun_s = float(started_s[point.number])
                writer.write(
                    Sample(
                        point,
                        Histogram(
                            histogram,
                            time.bin_width_s,
                            time.start_s,
                            point.dwell_s,
                            sync_count=0,
                            total_count=int(histogram.sum(dtype=np.int64)),
                            flags=HistogramFlag.NONE,
                            gate_opened_s=begun_s,
                        ),
                        begun_s,
                    )
                )
                step(1)
            for note in scan.notes:
                writer.log("import_note", note)
        put_in_place(partial, target)
    except StorageError as error:
        raise StorageError(str(error).replace(str(partial), str(target))) from error
    finally:
        partial.unlink(missing_ok=True)
        lock_file(partial).unlink(missing_ok=True)  # where the writer was broken into as it began
    return len(plan)


def said_by_source(recording: Recording) -> dict[str, object]:
    """What the file that a recording was imported from said; empty for recordings that were not imported."""
    scan = json.loads(recording.header.scan_json)
    said = scan.get(_KEY, {}) if isinstance(scan, dict) else {}
    return said if isinstance(said, dict) else {}


def _said(scan: ImportedScan, source: Path) -> dict[str, object]:
    offsets = scan.time_offset_bins
    return {
        "file": source.name,
        "format": scan.source_format,
        "rectified": scan.rectified,
        "rectified_assumed": scan.rectified_assumed,
        "no_direct_light": scan.no_direct_light,
        "wall_known": scan.wall_known,
        "direct_cut_bins": scan.direct_cut_bins,
        "falloff": scan.falloff,
        "response": as_json(scan.response),
        "time_offset_bins": None if offsets is None else np.round(offsets, 4).tolist(),
    }
