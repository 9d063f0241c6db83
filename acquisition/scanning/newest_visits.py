"""The newest visit to every point of a film, as samples come: what there is to see now."""

from nlos.acquisition.planning.exposure import unbiased_s
from nlos.acquisition.sample import Sample
from nlos.acquisition.scanning.gathering import Gathering


class NewestVisits(Gathering):
    """A `Gathering` in which a point that is visited again replaces what it held: of a film, one whole scan that ends
    with the newest sample. `len` counts all samples that came."""

    def add(self, sample: Sample) -> bool:
        """Takes one sample of the plan; False where that visit was in already."""
        point, histogram = sample.point, sample.histogram
        if self._have[point.number]:
            return False
        self._have[point.number] = True
        place = point.row, point.col
        self._counts[place] = histogram.counts
        self._live_s[0, point.row, point.col] = unbiased_s(histogram, self.plan.stop)
        self.sync_count[place], self.total_count[place] = histogram.sync_count, histogram.total_count
        return True
