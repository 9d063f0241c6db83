"""What is said to a PicoQuant instrument before it measures: inputs, binning and offset, exactly or not at all."""

from dataclasses import dataclass

from nlos.drivers.errors import LimitError
from nlos.drivers.tcspc.counter import HistogramAxis
from nlos.drivers.tcspc.picoquant.families import Family, PicoquantSettings
from nlos.drivers.tcspc.picoquant.library import VendorLibrary

_BINS_OF_CODE_0 = 1024


@dataclass(frozen=True)
class AxisCodes:
    """A time axis in the instrument's own terms. `length`: bins that it records; `first`: the first one wanted."""

    binning: int
    offset: int
    length_code: int
    length: int
    first: int


def axis_codes(device: str, family: Family, base_s: float, axis: HistogramAxis, t3: bool) -> AxisCodes:
    """Raises `LimitError` where the instrument cannot take `axis` exactly. In T3 mode the offset is cut off later."""
    if axis.bins < 1 or axis.offset_s < 0:
        raise LimitError(
            device, f"{axis.bins} bins from {axis.offset_s * 1e9:g} ns; at least 1 bin from 0 ns on is needed."
        )
    ratio = axis.bin_width_s / base_s
    binning = max(0, round(ratio).bit_length() - 1) if ratio >= 0.5 else 0
    if abs(ratio - (1 << binning)) > 1e-6 * ratio or binning >= family.most_binning_codes:
        raise LimitError(
            device,
            f"bin width {axis.bin_width_s * 1e12:g} ps is not {base_s * 1e12:g} ps times a power of two.",
            "Choose another histogram.bin_width_ps.",
        )
    if t3:
        first = round(axis.offset_s / axis.bin_width_s)
        most = 1 << family.layout.delay_bits
        if abs(axis.offset_s / axis.bin_width_s - first) > 1e-3 or first + axis.bins > most:
            raise LimitError(
                device,
                f"{axis.bins} bins from {axis.offset_s * 1e9:g} ns are not whole bins among the {most} of T3 mode.",
                "Widen the bins, or choose an offset that is a multiple of the bin width.",
            )
        return AxisCodes(binning, 0, 0, 0, first)
    offset = round(axis.offset_s / family.offset_unit_s)
    if abs(axis.offset_s / family.offset_unit_s - offset) > 1e-3 or not 0 <= offset <= family.largest_offset:
        raise LimitError(
            device,
            f"offset {axis.offset_s * 1e9:g} ns is not a whole number of {family.offset_unit_s * 1e9:g} ns from 0 to "
            f"{family.largest_offset}.",
            "Choose another histogram.offset_ns.",
        )
    code, length = 0, family.fixed_bins or 0
    if family.fixed_bins is None:
        code = max(family.shortest_length_code, (axis.bins - 1).bit_length() - 10)
        length = _BINS_OF_CODE_0 << code
    if axis.bins > length or code > 6:
        raise LimitError(device, f"{axis.bins} bins; it has 65536.", "Choose fewer histogram.bins.")
    return AxisCodes(binning, offset, code, length, 0)


def check_sync_rate(device: str, family: Family, divider: int, sync_hz: float) -> None:
    """Raises `LimitError` where the laser and the sync divider do not go together."""
    if sync_hz > 0 and (misfit := family.sync_misfit(divider, sync_hz)):  # no laser yet: `arm` says so
        raise LimitError(device, *misfit)


def set_up_inputs(library: VendorLibrary, settings: PicoquantSettings) -> None:
    """Dividers, levels, offsets, and calibration where the instrument has one."""
    family, sync, detector = library.family, settings.sync, settings.detector
    sync_mv, detector_mv = sync.level_of(family), detector.level_of(family)
    if settings.sync_divider not in family.sync_dividers:
        raise LimitError(
            library.device,
            f"sync divider {settings.sync_divider}; it has {', '.join(map(str, family.sync_dividers))}.",
            "Correct sync_divider in the bench file.",
        )
    if family.constant_fraction:
        library.call("Calibrate")
    library.call("SetSyncDiv", settings.sync_divider)
    if family.prefix == "PH":
        # Its two inputs are 0, the sync, and 1, the detector.
        library.call("SetInputCFD", 0, sync_mv, sync.zero_cross_mv)
        library.call("SetInputCFD", 1, detector_mv, detector.zero_cross_mv)
        library.call("SetSyncOffset", sync.offset_ps)
        return
    if family.constant_fraction:
        library.call("SetSyncCFD", sync_mv, sync.zero_cross_mv)
        library.call("SetInputCFD", settings.channel, detector_mv, detector.zero_cross_mv)
    else:
        library.call("SetSyncEdgeTrg", sync_mv, sync.edge == "rising")
        library.call("SetInputEdgeTrg", settings.channel, detector_mv, detector.edge == "rising")
    library.call("SetSyncChannelOffset", sync.offset_ps)
    library.call("SetInputChannelOffset", settings.channel, detector.offset_ps)
    library.call("SetInputChannelEnable", settings.channel, 1)


def set_up_markers(library: VendorLibrary, settings: PicoquantSettings) -> None:
    """Rising edges on markers 1 to 3, the mirror controller's outputs; marker 4 is off."""
    holdoff_ns = settings.marker_holdoff_ns
    if holdoff_ns > library.family.longest_marker_holdoff_ns:
        raise LimitError(
            library.device,
            f"marker hold-off {holdoff_ns} ns; at most {library.family.longest_marker_holdoff_ns} ns.",
            "Correct marker_holdoff_ns in the bench file.",
        )
    library.call("SetMarkerEdges", 1, 1, 1, 1)
    library.call("SetMarkerEnable", 1, 1, 1, 0)
    library.call("SetMarkerHoldoffTime", holdoff_ns)
