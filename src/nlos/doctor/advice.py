"""What to do about an examination's findings, in the order in which it helps: what others wait for comes first."""

from collections.abc import Sequence

from nlos.doctor.findings import Finding

_ORDER = {
    name: rank
    for rank, names in enumerate(
        (
            ("levels",),  # before anything is plugged in
            ("software", "disk"),
            ("links", "replugged"),  # and whatever bears an instrument's name: what is missing, or does not answer
            ("shutter", "interlock", "trip", "watchdog", "cable"),
            ("sync", "repeats"),
            ("first light", "direct light"),  # the delay, which every time window rests on
            ("markers", "dark histogram", "linearity", "corners"),
            ("dark counts", "count rates"),
            ("aim", "beam", "settling"),
            ("scan", "reconstruction"),
        )
    )
    for name in names
}
_FIRST, _INSTRUMENT = 0, 2
"""Ranks of what may harm an instrument, and of a missing or failed one, by whatever name."""


def in_order(findings: Sequence[Finding]) -> list[str]:
    """Each remedy once, with what it is for: what may do harm, then of failures, then of warnings, causes before what
    follows from them."""
    wanted = [each for each in findings if each.remedy and each.verdict in ("FAIL", "WARN")]
    ranks = {each.what: _ORDER.get(each.what, _INSTRUMENT) for each in wanted}
    wanted.sort(key=lambda each: (ranks[each.what] > _FIRST, each.verdict == "WARN", ranks[each.what]))
    for_what: dict[str, list[str]] = {}
    for each in wanted:
        names = for_what.setdefault(each.remedy, [])
        if each.what not in names:
            names.append(each.what)
    return [f"{', '.join(names)}: {remedy}" for remedy, names in for_what.items()]
