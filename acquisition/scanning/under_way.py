"""What every part of a scan under way is told: who may pause it, what may end it, and when its time began."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

from nlos.acquisition.scanning.advice import Adviser
from nlos.acquisition.scanning.alarms import Alarms
from nlos.acquisition.scanning.control import ScanControl
from nlos.acquisition.scanning.lag import Lag


@dataclass(frozen=True)
class UnderWay:
    """`start_s`: the bench's clock when the scan's own was 0. `decide` is asked after every sample whether the scan may
    end early, `adviser` before every batch of candidates which come next. `decided`: after how many of the samples that
    an earlier recording holds `decide` had said yes. `lag`: of continuous lines, where it is known."""

    control: ScanControl
    start_s: float = 0.0
    alarms: Alarms | None = None
    decide: Callable[[], bool] | None = None
    adviser: Adviser | None = None
    decided: Sequence[int] = ()
    lag: Lag | None = None
