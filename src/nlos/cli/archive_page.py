"""index.html of an archive: every picture small, what is wrong with which, and why the others are missing."""

from html import escape
from typing import Any
from urllib.parse import quote

from nlos.cli.escaped import escaped

STYLE = (
    ":root{color-scheme:light;--back:#fff;--text:#16181d;--dim:#596068;--doubt:#9a5b00}"
    "@media screen and (prefers-color-scheme:dark){:root{color-scheme:dark;--back:#111;--text:#ddd;--dim:#999;"
    "--doubt:#e6a817}}body{font:15px system-ui;margin:2em;background:var(--back);color:var(--text)}"
    "main{display:flex;flex-wrap:wrap;gap:1em}figure{margin:0;width:220px;overflow-wrap:anywhere;break-inside:avoid}"
    "img{width:100%;background:#000}a{color:inherit}td,th{padding:.2em 1em .2em 0;vertical-align:top;text-align:left;"
    "overflow-wrap:anywhere}td:first-child{min-width:7em}small{color:var(--dim)}"
    ".partial img{outline:3px solid var(--doubt)}.partial b{color:var(--doubt)}"
)


def page(rows: list[dict[str, Any]]) -> str:
    """The gallery of an archive's rows; `folder` in each is relative to the page."""
    shown = [row for row in rows if row["outcome"] in ("done", "partial")]
    missing = [row for row in rows if row["outcome"] not in ("done", "partial")]
    partial = sum(row["outcome"] == "partial" for row in shown)
    title = f"{len(shown)} of {len(rows)} files" + (f", {partial} of them partial" if partial else "")
    reasons = "".join(f"<tr><td>{_said(row['file'])}<td>{_said(row['reason'])}" for row in missing)
    table = (
        f"<h2>Without a result</h2><table><tr><th scope=col>File<th scope=col>Why{reasons}</table>" if missing else ""
    )
    return (
        '<!doctype html><html lang="en"><meta charset="utf-8"><meta name="viewport" content="width=device-width">'
        f"<title>{len(shown)} reconstructions</title>"
        f"<style>{STYLE}</style><h1>{title}</h1>{table}<main>{''.join(map(_figure, shown))}</main></html>\n"
    )


def _said(text: str) -> str:
    """A name or a reason, whatever bytes a file name is of."""
    return escape(escaped(text))


def _figure(row: dict[str, Any]) -> str:
    name = _said(row["file"])
    where = escape(quote(row["folder"], errors="surrogateescape"))
    took = "" if row["seconds"] is None else f", {row['seconds']:.1f} s"
    partial = row["outcome"] == "partial"
    said = f"<br><b>partial: {_said(row['reason'])}</b>" if partial else ""
    return (
        f"<figure{' class=partial' if partial else ''}>"
        f'<a href="{where}/"><img loading="lazy" src="{where}/albedo.png" alt="front view of {name}">'
        f'<img loading="lazy" src="{where}/depth.png" alt="depth of {name}"></a>'
        f"<figcaption>{name}<br><small>{escape(row['method'])}{took}</small>{said}</figcaption>"
        "</figure>"
    )
