"""What a report says of the scan itself: how it was taken, at which rates, and what happened meanwhile."""

from dataclasses import dataclass
from html import escape
from typing import TYPE_CHECKING

import numpy as np

from nlos.acquisition.recording.ended_as_asked import AS_ASKED, status_word
from nlos.acquisition.recording.frames import ended_plan, frame_table
from nlos.acquisition.scanning.advice import reasons
from nlos.recon.own_style import own_style
from nlos.report.html import folded, picture, table

if TYPE_CHECKING:
    from nlos.acquisition.recording.recording import Recording

SHORT = 12


@dataclass(frozen=True)
class ScanPart:
    """Sections of the page, made while the recording is open, and figures for its summary."""

    sentence: str
    warnings: str
    rates: str
    about: str
    settings: str
    events: str


def scan_part(recording: "Recording") -> ScanPart:
    """Everything that the file says of its scan."""
    said = [*recording.header.warnings, *filter(None, [recording.condition().warning])]
    warnings = "".join(f'<p class="warning"><strong>Warning:</strong> {escape(text)}</p>' for text in said)
    return ScanPart(
        _sentence(recording), warnings, _scan(recording), _about(recording), _settings(recording), _events(recording)
    )


def _sentence(recording: "Recording") -> str:
    from nlos.recon.small_print import si

    records = recording.intact_records()
    plan = ended_plan(recording.plan, records)
    done, live_s = len(records), float(records["live_time_s"].sum())
    light = f"{si(float(records['total_count'].sum()))}photons"
    how = "every point was measured" if done == len(plan) else f"{done:,} of {len(plan):,} points were measured"
    if plan.budget is not None:
        how = f"{done:,} were chosen on the way, for {plan.budget.total_us / 1e6:g} s of bench time"
    if plan.frames > 1:
        how += f"; a film of {plan.frames} frames, {frame_table(plan, records).said()}; pictures here add them up"
    again = sum(event.kind == "resumed" for event in recording.events())
    if again:
        how += f"; resumed {again} time{'s' if again > 1 else ''}, and the time holds the pauses"
    status = status_word(recording)
    kept = {"complete": "", AS_ASKED: f", and the scan {AS_ASKED}"}.get(status, f", and the scan is {status}")
    return (
        f"{len(plan):,} {'candidates' if plan.budget else 'points'} on a wall of {plan.wall.width_m:g} x "
        f"{plan.wall.height_m:g} m in {recording.elapsed_s:.1f} s, {live_s:.1f} s of it counting: {light}; {how}{kept}."
    )


def _about(recording: "Recording") -> str:
    header, records = recording.header, recording.intact_records()
    plan = ended_plan(recording.plan, records)
    planned = f"{'at most ' if plan.budget else ''}{plan.most_samples}"
    live_s = float(records["live_time_s"].sum())
    rows = {
        "Started": header.started_utc or "not stored",
        **{name.capitalize(): text for name, text in header.notes.shown().items()},
        "Status": f"{status_word(recording)}, {len(records)} of {planned} points",
        **({} if plan.frames == 1 else {"Frames": frame_table(plan, records).said()}),
        "Wall": f"{plan.wall.width_m:g} x {plan.wall.height_m:g} m, grid of {plan.wall.rows} x {plan.wall.cols}",
        "Time axis": f"{plan.axis.bins} bins of {plan.axis.bin_width_s * 1e12:g} ps",
        "Light": f"{live_s:.2f} s of live time, {int(records['total_count'].sum()):,} photons",
        **{
            role.capitalize(): f"{who.vendor} {who.product}, serial {who.serial or 'not told'}, "
            f"firmware {who.firmware or 'not told'}"
            for role, who in header.devices.items()
        },
        "Software": ", ".join(f"{name} {version}" for name, version in header.software.items()),
        "Code": header.git_hash or "not from a checkout",
    }
    return table(rows)


def _settings(recording: "Recording") -> str:
    header = recording.header
    texts = [("The scan file", header.scan_text), ("The bench file", header.bench_text)]
    if not any(text for _, text in texts):
        return ""
    return "<h2>Settings</h2>" + "".join(folded(name, text) for name, text in texts if text)


@own_style()
def _scan(recording: "Recording") -> str:
    from matplotlib.figure import Figure

    plan, records = recording.plan, recording.intact_records()
    numbers = records["number"]
    figure = Figure(figsize=(9, 3.6), layout="constrained")
    left, right = figure.subplots(1, 2)
    rate = records["total_count"] / np.maximum(records["live_time_s"], 1e-12)
    dots = left.scatter(plan.positions.x_m[numbers], plan.positions.y_m[numbers], c=rate / 1e3, s=6, marker="s")
    left.set(title="Count rate at the wall", xlabel="x (m)", ylabel="y (m)", aspect="equal")
    figure.colorbar(dots, ax=left, label="thousand counts/s")
    total = np.zeros(plan.axis.bins)
    for _, counts, intact in recording.blocks():
        total += counts[intact].sum(axis=0, dtype=np.float64)
    right.semilogy((plan.axis.offset_s + np.arange(plan.axis.bins) * plan.axis.bin_width_s) * 1e9, total + 0.5)
    right.set(title="All histograms added up", xlabel="time after the laser pulse (ns)", ylabel="counts")
    caption, told = "count rate over the wall, and the sum of all histograms", ""
    if len(rate):
        top = numbers[int(np.argmax(rate))]
        x_m, y_m = plan.positions.x_m[top], plan.positions.y_m[top]
        told = f"{rate.min():,.0f} to {rate.max():,.0f} counts/s, most at x {x_m:.2f} m, y {y_m:.2f} m"
    return f"<h2>Exposure and rates</h2>{picture(figure, caption, told)}" + _chosen(recording)


@own_style()
def _chosen(recording: "Recording") -> str:
    """Of a plan of candidates: why its points were taken, where, and for how long."""
    from matplotlib.figure import Figure

    plan, records = recording.plan, recording.records
    if plan.budget is None or not len(records):
        return ""
    found = reasons(((event.kind, event.text) for event in recording.events()), len(records))
    number = np.minimum(records["number"], len(plan) - 1)
    figure = Figure(figsize=(9, 3.6), layout="constrained")
    left, right = figure.subplots(1, 2)
    for word in dict.fromkeys(each.word for each in found):
        rows = [row for each in found if each.word == word for row in range(each.first, each.first + each.count)]
        left.scatter(plan.positions.x_m[number[rows]], plan.positions.y_m[number[rows]], s=4, marker="s", label=word)
    left.set(title="Why", xlabel="x (m)", ylabel="y (m)", aspect="equal")
    left.legend(fontsize=7, loc="upper left", bbox_to_anchor=(0, -0.15))
    dwell_s = np.zeros((plan.wall.rows, plan.wall.cols))
    np.add.at(dwell_s, (plan.positions.row[number], plan.positions.col[number]), records["live_time_s"])
    edges = (-plan.wall.width_m / 2, plan.wall.width_m / 2, -plan.wall.height_m / 2, plan.wall.height_m / 2)
    shown = right.imshow(np.where(dwell_s > 0, dwell_s * 1e3, np.nan), extent=edges)
    right.set(title="Time on each point", xlabel="x (m)", ylabel="y (m)")
    figure.colorbar(shown, ax=right, label="ms")
    lines = "".join(
        f"<tr><td>{each.first + 1} to {each.first + each.count}</td><td>{each.dwell_s * 1e3:g} ms</td>"
        f"<td>{escape(each.why)}</td></tr>"
        for each in found
    )
    return (
        f"<h2>Why each point was taken</h2>{picture(figure, 'why points were taken, and how long each was measured')}"
        f"<table><tr><th scope=col>Samples</th><th scope=col>Dwell</th><th scope=col>Because</th></tr>{lines}</table>"
    )


def _events(recording: "Recording") -> str:
    lines = "".join(
        f"<tr><td>{event.bench_s:.3f} s</td><td>{escape(event.kind)}</td><td>{escape(event.text)}</td></tr>"
        for event in recording.events()
    )
    short = ' class="short"' if lines.count("<tr>") <= SHORT else ""  # a short table is printed on one page
    head = '<tr><th scope="col">Time</th><th scope="col">Event</th><th scope="col">What happened</th></tr>'
    return f"<h2>Events</h2><table{short}>{head}{lines}</table>" if lines else "<h2>Events</h2><p>None.</p>"
