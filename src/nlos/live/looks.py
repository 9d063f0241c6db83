"""Pictures of a scan under way, made in its own process between two samples: for benches whose clock waits for them."""

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

from nlos.acquisition.recording.recording import Recording
from nlos.chain import calibrate_scan, constants_for
from nlos.live.so_far import gathering_for, scan_of
from nlos.recipe import Recipe
from nlos.recon.errors import NO_PICTURE
from nlos.recon.live import LivePicture, LiveReconstruction
from nlos.response import with_response
from nlos.said_once import SaidOnce

if TYPE_CHECKING:
    from nlos.acquisition.planning.plan import ScanPlan
    from nlos.acquisition.sample import Sample
    from nlos.loaded import LoadedScan


class Looks:
    """Fed with every sample; makes the picture of those so far when asked."""

    def __init__(
        self, plan: "ScanPlan", nothing_yet: "LoadedScan", recipe: Recipe, report: Callable[[str, str], None]
    ) -> None:
        """`nothing_yet`: the scan as it is loaded, without samples."""
        self._nothing_yet, self._recipe, self._report = nothing_yet, recipe, report
        self._gathering = gathering_for(plan)
        self._live = LiveReconstruction(recipe.method, recipe.settings)
        self._tell = SaidOnce()

    def __len__(self) -> int:
        return len(self._gathering)

    def add(self, sample: "Sample") -> None:
        """One more sample."""
        self._gathering.add(sample)

    def picture(self, kind: str) -> LivePicture | None:
        """Of the samples so far; None where there is none yet, which is reported as an event of this kind."""
        try:
            scan = scan_of(self._nothing_yet, self._gathering)
            constants = constants_for(scan, self._recipe.constants, self._tell)
            transient = with_response(calibrate_scan(scan, constants=constants, tell=self._tell), self._recipe.response)
            return self._live.update(transient, len(self), scan.falloff)
        except NO_PICTURE as error:
            self._report(kind, f"no picture of {len(self)} points yet: {error}")
            return None


def catch_up(add: "Callable[[Sample], None]", run: Path) -> None:
    """Adds what a recording that is resumed holds, before it is opened for writing."""
    with Recording.open(run) as recording:
        for sample in recording.samples():
            add(sample)
