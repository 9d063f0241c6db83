"""The examination as a page to print or mail: verdicts, serial numbers and curves in a file that loads nothing."""

from collections.abc import Mapping, Sequence
from datetime import UTC, datetime
from html import escape
from pathlib import Path
from typing import TYPE_CHECKING

from nlos.acquisition.recording.provenance import software_versions
from nlos.cli.escaped import escaped
from nlos.doctor.advice import in_order
from nlos.doctor.chart import drawn
from nlos.doctor.findings import Finding
from nlos.drivers.identity import DeviceIdentity
from nlos.whole_file import whole_file

if TYPE_CHECKING:
    from nlos.configs.load import Loaded
    from nlos.drivers.bench_settings import BenchSettings

_STYLE = """
:root { color-scheme: light; --ink: #1b1f24; --paper: #ffffff; --rule: #d0d7de; --faint: #59636e;
  --pass: #1a7f37; --warn: #8a5a00; --fail: #c4232f; --curve: #0a58ca; --block: #f6f8fa }
@media screen and (prefers-color-scheme: dark) { :root { color-scheme: dark; --ink: #e6edf3; --paper: #0f1318;
  --rule: #353c45; --faint: #9aa4af; --pass: #4ac26b; --warn: #e0a93b; --fail: #ff7b72; --curve: #79b8ff;
  --block: #191f26 } }
body { font: 16px/1.5 system-ui, sans-serif; max-width: 60rem; margin: 2rem auto; padding: 0 1rem; color: var(--ink);
  background: var(--paper) }
h1 { font-size: 1.6rem; margin-bottom: .2rem; overflow-wrap: anywhere } h2 { font-size: 1.2rem; margin-top: 2.2rem }
p.when { margin-top: 0; color: var(--faint) }
table { border-collapse: collapse; width: 100%; font-size: .92rem }
td, th { text-align: left; vertical-align: top; padding: .35rem .9rem .35rem 0; border-bottom: 1px solid var(--rule) }
th { font-weight: 600; white-space: nowrap } td:last-child { overflow-wrap: anywhere } td.what { white-space: nowrap }
td small { display: block; color: var(--faint); font-size: .88rem }
.PASS, .WARN, .FAIL, .SKIP { font-weight: 600; font-variant-numeric: tabular-nums; white-space: nowrap }
.PASS { color: var(--pass) } .WARN { color: var(--warn) } .FAIL { color: var(--fail) } .SKIP { color: var(--faint) }
.whole { font-size: 1.1rem } .curves { display: grid; grid-template-columns: repeat(auto-fit, minmax(22rem, 1fr));
  gap: 1.2rem } figure { margin: 0 } figcaption { font-size: .9rem; color: var(--faint) }
svg { width: 100%; height: auto } svg text { fill: var(--faint); font: 11px system-ui, sans-serif }
svg .grid { stroke: var(--rule); stroke-width: .5 } svg .limit { stroke: var(--faint); stroke-dasharray: 4 3 }
svg .curve { fill: none; stroke: var(--curve); stroke-width: 1.4; stroke-linejoin: round }
pre { background: var(--block); padding: .8rem; overflow: auto; font-size: .85rem } summary { cursor: pointer }
@media (max-width: 30rem) { td.what, th { white-space: normal } td, th { padding-right: .4rem; font-size: .8rem }
  .curves { grid-template-columns: 1fr } }
"""


def write_page(
    target: Path,
    table: "Loaded[BenchSettings]",
    findings: Sequence[Finding],
    met: Mapping[str, DeviceIdentity],
    with_light: bool,
    *,
    new: bool = False,
) -> None:
    """Writes the page to `target`, whole or not at all; a `new` one as `whole_file` does."""
    settings = table.settings
    counted = {
        verdict: sum(each.verdict == verdict for each in findings) for verdict in ("PASS", "WARN", "FAIL", "SKIP")
    }
    whole = "FAIL" if counted["FAIL"] else "WARN" if counted["WARN"] else "PASS"
    kind = "simulated bench" if settings.simulated else "bench"
    light = "with light" if with_light else "in the dark"
    if settings.shutter_on == "nothing":
        light = "the laser as it was, without a shutter"
    when = f"{datetime.now(UTC):%Y-%m-%d %H:%M} UTC, {light}"
    instruments = "".join(
        f"<tr><td class=what>{escape(role)}</td><td>{escape(f'{who.vendor} {who.product}')}</td>"
        f"<td>{escape(who.serial or 'not told')}</td><td>{escape(who.firmware or 'not told')}</td></tr>"
        for role, who in met.items()
    )
    rows = "".join(
        f"<tr><td class={each.verdict}>{each.verdict}</td><td class=what>{escape(each.what)}</td>"
        f"<td>{escape(each.said)}{f'<small>{escape(each.remedy)}</small>' if each.remedy else ''}</td></tr>"
        for each in findings
    )
    curves = "".join(drawn(each.chart) for each in findings if each.chart is not None)
    advice = in_order(findings)
    steps = f"<h2>What to do, in this order</h2><ol>{''.join(f'<li>{escape(each)}</li>' for each in advice)}</ol>"
    title = f"Examination of {kind} {settings.name}"
    laser = settings.laser
    facts = {
        "Laser": f"{laser.name or 'not named'}, {laser.repetition_hz / 1e6:g} MHz",
        "Wall": f"{settings.geometry.wall_distance_m:g} m away",
        "Bench file": str(table.path),
        "Software": ", ".join(f"{name} {version}" for name, version in software_versions().items()),
    }
    about = "".join(
        f"<tr><th scope=row>{escape(name)}</th><td>{escape(said)}</td></tr>" for name, said in facts.items()
    )
    page = (
        '<!doctype html><html lang="en"><head><meta charset="utf-8"><meta name="viewport" content="width=device-width">'
        f"<title>{escape(title)}</title><style>{_STYLE}</style></head><body><h1>{escape(title)}</h1>"
        f"<p class=when>{when}</p><p class=whole><span class={whole}>{whole}</span> "
        f"({', '.join(f'{count} {verdict}' for verdict, count in counted.items())})</p>"
        "<h2>Instruments</h2><table><tr><th scope=col>Part</th><th scope=col>Instrument</th>"
        "<th scope=col>Serial number</th><th scope=col>Firmware</th></tr>"
        f"{instruments or '<tr><td colspan=4>none answered</td></tr>'}</table>"
        f"{steps if advice else ''}<h2>Findings</h2><table><tr><th scope=col>Verdict</th>"
        f"<th scope=col>Examined</th><th scope=col>Found</th></tr>{rows}</table>"
        f"{f'<h2>Curves</h2><div class=curves>{curves}</div>' if curves else ''}"
        f"<h2>Bench</h2><table>{about}</table><details><summary>The bench file</summary>"
        f"<pre>{escape(table.text)}</pre></details></body></html>"
    )
    with whole_file(target, new=new) as partial:
        partial.write_text(escaped(page), encoding="utf-8")
