"""A small scan on a simulated bench whose cables take no time."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from nlos.acquisition.planning.plan import ScanPlan
from nlos.acquisition.planning.scan_settings import ScanSettings
from nlos.configs.load import load
from nlos.drivers.bench import BenchSettings
from nlos.drivers.simulated.faults import Fault


@pytest.fixture(scope="session")
def bench_settings() -> Callable[..., BenchSettings]:
    """bench_settings(*faults, name="zero_latency"): a simulated bench that will commit these faults."""

    def make(*faults: Fault, name: str = "zero_latency", markers: bool = True) -> BenchSettings:
        settings = load("bench", name, BenchSettings).settings
        assert settings.simulation is not None
        simulation = settings.simulation.model_copy(update={"faults": faults})
        wired = {"markers": markers} if settings.counter.model == "tcspc488" else {}
        counter = settings.counter.model_copy(update=wired)
        return settings.model_copy(update={"simulation": simulation, "counter": counter})

    return make


@pytest.fixture(scope="session")
def small_plan() -> Callable[..., ScanPlan]:
    """small_plan(rows, cols, **overrides): a serpentine of 64-bin histograms."""

    def make(rows: int = 6, cols: int = 6, **overrides: Any) -> ScanPlan:
        settings = {
            "wall": {"width_m": 1.0, "height_m": 1.0, "rows": rows, "cols": cols},
            "pattern": "serpentine",
            "dwell_ms": 8,
            "histogram": {"bins": 64, "bin_width_ps": 256, "offset_ns": 10},
            **overrides,
        }
        return ScanSettings.model_validate(settings).plan()

    return make


@pytest.fixture
def run_path(tmp_path: Path) -> Path:
    return tmp_path / "run.h5"
