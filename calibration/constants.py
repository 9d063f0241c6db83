"""The measured constants of a bench: numbers, uncertainties, the devices they hold for, and where they came from.

One HDF5 file. Attributes: format "nlos-constants", version 1, `about` (JSON: devices, date, sources), and each scalar
with its error under its own name (`dead_time_s`, `dead_time_s_error`). Datasets: `response`, `arrivals/...` (the fit,
`x_m`, `y_m`, `residual_s`, and for other readers `arrival_s`, the offset map itself), `direct_shape`,
`dark_per_bin_hz` (attributes `bin_width_s`, `start_s`). What was not measured is not there.
"""

import json
import os
import secrets
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, fields
from pathlib import Path

import h5py
import numpy as np
import numpy.typing as npt

from nlos.acquisition.importers.untrusted_hdf5 import find_dataset, read_only
from nlos.acquisition.recording.disk_refusal import told_of
from nlos.acquisition.recording.new_name import file_to_write, put_new
from nlos.acquisition.recording.shown_to_hdf5 import written_hdf5
from nlos.acquisition.recording.validation import json_object
from nlos.acquisition.transient import TimeAxis
from nlos.calibration.arrivals import Arrivals
from nlos.calibration.bench_facts import Facts, changes
from nlos.calibration.errors import ForeignConstants, InvalidData, PoorCalibration
from nlos.calibration.geometry import ScannerGeometry
from nlos.calibration.impulse_response import ImpulseResponse, from_histogram

Floats = npt.NDArray[np.float64]
FORMAT, VERSION = "nlos-constants", 1
LARGEST_ARRAY = 4096 * 4096


@dataclass(frozen=True)
class Quantity:
    """A measured number and its standard error."""

    value: float
    error: float


@dataclass(frozen=True)
class BenchConstants:
    """What a calibration run found. None: not measured."""

    devices: Mapping[str, str]
    """Role ("mirror", "counter", ...) -> model and serial number."""
    measured_utc: str
    """ISO 8601."""
    sources: tuple[str, ...]
    """The recordings that the numbers came from."""
    bin_width_s: float
    arrivals: Arrivals | None = None
    response: ImpulseResponse | None = None
    direct_shape: Floats | None = None  # (T,): share of the direct light in bins from its arrival on
    direct_end_bin: int = 0
    dark_hz: Quantity | None = None
    dark_per_bin_hz: Floats | None = None  # (T,) of the dark run's own time axis
    dark_time: TimeAxis | None = None
    """That axis; None in files of before it was kept."""
    ambient_hz: Quantity | None = None
    dead_time_s: Quantity | None = None
    afterpulse_probability: Quantity | None = None
    afterpulse_decay_s: float | None = None
    geometry: ScannerGeometry | None = None
    geometry_errors: Mapping[str, float] = field(default_factory=dict)
    bench: str = ""
    """The name of the bench they belong to; empty where the recording did not say."""
    bench_facts: Facts = field(default_factory=dict)
    """What of that bench they depend on, as it was: `facts_of`."""
    warnings: tuple[str, ...] = ()
    """What was said against them when they were measured."""

    @property
    def aims(self) -> bool:
        """Whether a scan may be aimed by them unasked: only spots tell mirror gain and wall distance apart."""
        return self.geometry is not None and "x_gain" in self.geometry_errors

    def stale(self, devices: Mapping[str, str], facts: Facts) -> list[str]:
        """What is not as it was when they were measured, with both values; devices not known are not compared."""
        others = [
            f"{role} {self.devices[role]} then, {name} now"
            for role, name in devices.items()
            if self.devices.get(role, name) != name
        ]
        return others + changes(self.bench_facts, facts)

    def refuse_other_models(self, devices: Mapping[str, str]) -> None:
        """Raises `ForeignConstants` where a device of the same role is of another model."""
        for role, name in devices.items():
            mine = self.devices.get(role)
            if mine is not None and mine.split()[:1] != name.split()[:1]:
                raise ForeignConstants(
                    f"these constants of {self.measured_utc} are for the {role} {mine}, the data come from {name}. "
                    "Calibrate with a recording of this bench."
                )

    def summary(self) -> dict[str, object]:
        """The numbers as plain JSON values: what a recording keeps of the constants that took part in its scan."""
        numbers = {name: getattr(self, name) for name in _QUANTITIES}
        return {
            "measured_utc": self.measured_utc,
            "bench": self.bench,
            "sources": list(self.sources),
            "devices": dict(self.devices),
            "geometry": None if self.geometry is None else asdict(self.geometry),
            "delay_s": None if self.arrivals is None else self.arrivals.delay_s,
            **{name: None if q is None else asdict(q) for name, q in numbers.items()},
        }

    def check(self) -> None:
        """Raises `PoorCalibration` where a number is worse than its own limits."""
        arrivals = self.arrivals
        if arrivals is not None and not arrivals.rms_s <= self.bin_width_s:
            worst = int(np.argmax(np.abs(arrivals.residual_s)))
            raise PoorCalibration(
                f"direct arrivals scatter by {arrivals.rms_s * 1e12:.1f} ps RMS about the wall's fit, more than one "
                f"bin ({self.bin_width_s * 1e12:.1f} ps), most at point {worst} at ({arrivals.x_m[worst]:+.3f} m, "
                f"{arrivals.y_m[worst]:+.3f} m) by {arrivals.residual_s[worst] * 1e12:+.0f} ps. Expose longer, and "
                "check that the wall is plane and that the time window holds its direct light."
            )
        if arrivals is None and self.dark_hz is None:
            raise PoorCalibration("nothing was measured that could be kept.")


_QUANTITIES = ("dark_hz", "ambient_hz", "dead_time_s", "afterpulse_probability")


def save(constants: BenchConstants, path: Path, overwrite: bool = False) -> None:
    """Writes one file, whole or not at all. Raises `PoorCalibration`, `FileExistsError` without `overwrite`, and
    `StorageError` where the disk does not take it."""
    constants.check()
    if os.path.lexists(path) and not overwrite:  # a link to nothing, too
        raise FileExistsError(f"{path} exists; --overwrite replaces it")
    path = file_to_write(path)
    about = {"devices": dict(constants.devices), "measured_utc": constants.measured_utc, "sources": constants.sources}
    about |= {"bench": constants.bench, "bench_facts": dict(constants.bench_facts)}
    about |= {"warnings": list(constants.warnings)}
    if constants.geometry is not None:
        about["geometry"] = asdict(constants.geometry)
        about["geometry_errors"] = dict(constants.geometry_errors)
    partial = path.with_name(f".{path.name}.{os.getpid()}-{secrets.token_hex(4)}.part")
    try:
        with told_of(path, partial), written_hdf5(partial) as file:
            file.attrs["format"], file.attrs["version"] = FORMAT, VERSION
            file.attrs["about"] = json.dumps(about)
            file.attrs["bin_width_s"] = constants.bin_width_s
            file.attrs["direct_end_bin"] = constants.direct_end_bin
            for name in _QUANTITIES:
                quantity = getattr(constants, name)
                if quantity is not None:
                    file.attrs[name], file.attrs[f"{name}_error"] = quantity.value, quantity.error
            if constants.afterpulse_decay_s is not None:
                file.attrs["afterpulse_decay_s"] = constants.afterpulse_decay_s
            for name in ("direct_shape", "dark_per_bin_hz"):
                if getattr(constants, name) is not None:
                    file[name] = getattr(constants, name)
            if constants.dark_time is not None and constants.dark_per_bin_hz is not None:
                file["dark_per_bin_hz"].attrs["bin_width_s"] = constants.dark_time.bin_width_s
                file["dark_per_bin_hz"].attrs["start_s"] = constants.dark_time.start_s
            if constants.response is not None:
                file["response"] = constants.response.density
                file["response"].attrs["step_s"] = constants.response.step_s
                file["response"].attrs["start_s"] = constants.response.start_s
            if constants.arrivals is not None:
                for item in fields(constants.arrivals):
                    file[f"arrivals/{item.name}"] = getattr(constants.arrivals, item.name)
                file["arrivals/arrival_s"] = constants.arrivals.at(constants.arrivals.x_m, constants.arrivals.y_m)
        with told_of(path, partial):
            if overwrite:
                os.replace(partial, path)
            else:
                put_new(partial, path)
    finally:
        partial.unlink(missing_ok=True)


def load(path: Path) -> BenchConstants:
    """Reads what `save` wrote. Raises `FileNotFoundError`, and `InvalidData` naming the file and what is wrong."""
    if not path.is_file():
        raise FileNotFoundError(f"{path}: no such file")
    try:
        with read_only(path) as file:
            if file.attrs.get("format") != FORMAT or file.attrs.get("version") != VERSION:
                raise InvalidData(f"{path}: not a constants file of version {VERSION}")
            return _read(file)
    except (OSError, LookupError, TypeError, ValueError, AttributeError, RuntimeError, ArithmeticError) as error:
        if isinstance(error, InvalidData):
            raise
        raise InvalidData(f"{path}: not a readable constants file: it is damaged, or something else") from error


def load_response(path: Path) -> ImpulseResponse:
    """An impulse response from a file: a constants file, or HDF5 with one histogram of a sharp reflection, `counts`
    over `time_s` or `sum` with the attribute `bin_width_s`. The median is taken as background. Raises `InvalidData`."""
    if not path.is_file():
        raise FileNotFoundError(f"{path}: no such file")
    try:
        with read_only(path) as file:
            if file.attrs.get("format") == FORMAT:
                response = _read(file).response
                if response is None:
                    raise InvalidData(f"{path}: these constants hold no impulse response")
                return response
            counts = _array(file, "counts" if find_dataset(file, "counts") is not None else "sum", 1)
            if find_dataset(file, "time_s") is not None:
                time_s = _array(file, "time_s", 1)
                width_s = float(np.ptp(time_s)) / max(len(time_s) - 1, 1)
                even = time_s[0] + np.arange(len(time_s)) * width_s
                if len(time_s) != len(counts) or np.abs(time_s - even).max() > 0.1 * width_s:
                    raise InvalidData(f"{path}: time_s is not {len(counts)} even steps, one for each of counts")
            else:
                width_s = _finite(file.attrs["bin_width_s"])
        return from_histogram(counts - np.median(counts), width_s).cropped(0.01)
    except (OSError, LookupError, TypeError, ValueError, AttributeError, RuntimeError, ArithmeticError) as error:
        if isinstance(error, InvalidData):
            raise
        raise InvalidData(f"{path}: not a readable impulse response: it is damaged, or something else") from error


def _read(file: h5py.File) -> BenchConstants:
    about = json_object(f"{file.filename}: about", str(file.attrs["about"]))
    quantities = {
        name: Quantity(_finite(file.attrs[name]), float(file.attrs[f"{name}_error"]))
        for name in _QUANTITIES
        if name in file.attrs
    }
    response = arrivals = None
    if (stored := find_dataset(file, "response")) is not None:
        density = _array(file, "response", 1)
        response = ImpulseResponse(density, _finite(stored.attrs["step_s"]), _finite(stored.attrs["start_s"]))
    if find_dataset(file, "arrivals/x_m") is not None:
        x, y, residual = (_array(file, f"arrivals/{name}", 1) for name in ("x_m", "y_m", "residual_s"))
        position, covariance = _array(file, "arrivals/scanner_position_m", 1), _array(file, "arrivals/covariance", 2)
        delay_s, rms_s = (_finite(_array(file, f"arrivals/{name}", 0)) for name in ("delay_s", "rms_s"))
        if position.shape != (3,) or covariance.shape != (4, 4) or not len(x) == len(y) == len(residual):
            raise InvalidData(f"{file.filename}: arrivals have shapes that do not belong together")
        arrivals = Arrivals(position, delay_s, covariance, rms_s, x, y, residual)
    return BenchConstants(
        devices={str(role): str(name) for role, name in about["devices"].items()},
        measured_utc=str(about["measured_utc"]),
        sources=tuple(str(source) for source in about["sources"]),
        bin_width_s=_finite(file.attrs["bin_width_s"]),
        arrivals=arrivals,
        response=response,
        direct_shape=_optional(file, "direct_shape"),
        direct_end_bin=int(file.attrs["direct_end_bin"]),
        dark_per_bin_hz=_optional(file, "dark_per_bin_hz"),
        dark_time=_dark_time(file),
        afterpulse_decay_s=_finite(file.attrs["afterpulse_decay_s"]) if "afterpulse_decay_s" in file.attrs else None,
        geometry=geometry_of(about["geometry"]) if "geometry" in about else None,
        geometry_errors={str(name): float(value) for name, value in about.get("geometry_errors", {}).items()},
        bench=str(about.get("bench", "")),
        bench_facts={str(key): value for key, value in about.get("bench_facts", {}).items()},
        warnings=tuple(str(each) for each in about.get("warnings", ())),
        **quantities,
    )


def _dark_time(file: h5py.File) -> TimeAxis | None:
    stored = find_dataset(file, "dark_per_bin_hz")
    if stored is None or "bin_width_s" not in stored.attrs:
        return None
    width_s, start_s = (_finite(stored.attrs[name]) for name in ("bin_width_s", "start_s"))
    return TimeAxis(len(_array(file, "dark_per_bin_hz", 1)), width_s, start_s)


def geometry_of(fields: Mapping[str, object]) -> ScannerGeometry:
    """A geometry from its fields in a file. Raises `ValueError`, `TypeError` or `AttributeError` for others."""
    return ScannerGeometry(**{name: _finite(value) for name, value in fields.items()})


def _optional(file: h5py.File, name: str) -> Floats | None:
    return None if find_dataset(file, name) is None else _array(file, name, 1)


def _array(file: h5py.File, name: str, dimensions: int) -> Floats:
    item = find_dataset(file, name)
    if item is None or item.ndim != dimensions or item.size > LARGEST_ARRAY or item.dtype.kind not in "uif":
        raise InvalidData(f"{file.filename}: {name} is not a plausible array of {dimensions} dimensions")
    values = np.asarray(item[()], dtype=np.float64)
    if not np.isfinite(values).all():
        raise InvalidData(f"{file.filename}: {name} holds values that are not finite")
    return values


def _finite(value: object) -> float:
    number = float(value)  # type: ignore[arg-type]
    if not np.isfinite(number):
        raise ValueError(f"a number is {number}")
    return number
