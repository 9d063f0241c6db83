"""`nlos.open_bench` and `nlos.scan`: the command line's benches and scans, from Python."""

from collections.abc import Generator, Iterator
from contextlib import closing, contextmanager
from pathlib import Path

from nlos.acquisition.errors import PlanRefused
from nlos.acquisition.planning.plan import ScanPlan
from nlos.acquisition.planning.preflight import check_disk
from nlos.acquisition.planning.scan_settings import ScanSettings
from nlos.acquisition.recording.provenance import Header
from nlos.acquisition.recording.recording import Status
from nlos.acquisition.recording.writer import RecordingWriter
from nlos.acquisition.sample import Sample
from nlos.acquisition.scanning.alarms import Alarms, AlarmSettings
from nlos.acquisition.scanning.engine import scan as run
from nlos.configs.load import load
from nlos.drivers import bench as table
from nlos.drivers.bench import Bench, BenchSettings
from nlos.drivers.trip_latch import TripLatch


@contextmanager
def open_bench(bench: str | Path = "simulated") -> Iterator[Bench]:
    """The bench of a YAML file, or of that name in `configs/bench`: mirror, counter and shutter, opened together.

    The light is shut first and the mirror parked on every way out. `bench.simulated` says whether there is any light at
    all. Raises `ConfigError` for what the file says and `DeviceError` for what is not there.
    """
    settings = load("bench", str(bench), BenchSettings).settings
    with table.open_bench(settings, latch=TripLatch.of_bench(settings)) as opened:
        yield opened


def scan(
    scan: str | Path | ScanPlan,
    bench: Bench,
    *,
    output: str | Path | None = None,
    no_shutter: bool = False,
) -> Generator[Sample, None, None]:
    """Acquires: yields every sample as it is taken. `scan`: a YAML file, a name in `configs/scan`, or a `ScanPlan`.

    Everything is checked at once, before anything moves (`LimitError`, `PlanRefused`); the light is on only between the
    first and the last sample that are asked for. `output`: also writes the recording, each sample before it is yielded.
    A bench without a shutter needs `no_shutter=True`. Raises `DeviceError` with the shutter closed.
    """
    if bench.settings.shutter.model == "none" and not no_shutter:
        raise PlanRefused(
            "this bench has no shutter, so nothing here can shut off the light. Say no_shutter=True if something else "
            "does."
        )
    if isinstance(scan, ScanPlan):
        plan, alarms, header = scan, AlarmSettings(), Header()
    else:
        wanted = load("scan", str(scan), ScanSettings)
        plan, alarms = wanted.settings.plan(), wanted.settings.alarms
        header = Header(scan_text=wanted.text, scan_json=wanted.settings.model_dump_json())
    folder = Path.cwd() if output is None else Path(output).absolute().parent
    watch = Alarms(alarms, bench.settings.laser.repetition_hz, folder)
    watch.wait_for_rates(bench)
    samples = run(plan, bench, alarms=watch)
    if output is None:
        return samples
    return _recorded(samples, plan, bench, header, Path(output))


def _recorded(
    samples: Generator[Sample, None, None], plan: ScanPlan, bench: Bench, header: Header, path: Path
) -> Generator[Sample, None, None]:
    """The same samples, each in the recording before it is handed on. Raises `StorageError` where that exists."""
    check_disk(plan, path)
    who = {"mirror": bench.mirror.identity, "counter": bench.counter.identity}
    texts = {"bench_json": bench.settings.model_dump_json(), "devices": who, "warnings": tuple(bench.warnings)}
    writer = RecordingWriter.create(path, plan, Header(**{**vars(header), **texts}).stamped())

    def write() -> Generator[Sample, None, None]:
        status = Status.INTERRUPTED
        try:
            with closing(samples):
                for sample in samples:
                    writer.write(sample)
                    yield sample
            status = Status.COMPLETE
        except Exception:
            status = Status.FAILED
            raise
        finally:
            writer.finish(status)

    return write()
