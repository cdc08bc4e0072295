"""A report as one HTML file, without scripts or external files; light and dark, for a screen of any width."""

from __future__ import annotations

import base64
import dataclasses
import html
import math
import re
from collections.abc import Sequence
from io import BytesIO
from pathlib import Path

from jaxtyping import UInt8
from numpy import ndarray
from PIL import Image

from depthmocap.core.output import write_file
from depthmocap.errors import InputError
from depthmocap.text import harmless

Cell = str | int | float | None

_SIGNATURES = ((b"\x89PNG", "image/png"), (b"GIF8", "image/gif"), (b"\xff\xd8", "image/jpeg"), (b"RIFF", "image/webp"))

_STYLE = """
:root { color-scheme: light dark; --page: #fbfbf9; --ink: #1d2125; --soft: #646c75; --line: #e2e3df; --accent: #b3402e;
  --stripe: #f3f3ef; }
@media (prefers-color-scheme: dark) {
  :root { --page: #14171a; --ink: #e4e6e8; --soft: #98a1aa; --line: #2b3036; --accent: #f08a72; --stripe: #1a1e22; }
  figure img.chart { filter: invert(1) hue-rotate(180deg); mix-blend-mode: screen; }
}
* { box-sizing: border-box; }
html { -webkit-text-size-adjust: 100%; }
body { margin: 0; background: var(--page); color: var(--ink);
  font: 17px/1.6 system-ui, -apple-system, "Segoe UI", Roboto, "Helvetica Neue", sans-serif; }
main { max-width: 54rem; margin: 0 auto; padding: 3.5rem 1.25rem 5rem; }
h1 { font-size: 2.1rem; line-height: 1.2; letter-spacing: -0.02em; font-weight: 650; margin: 0 0 0.5rem;
  text-wrap: balance; }
h2 { font-size: 1.3rem; line-height: 1.3; letter-spacing: -0.01em; font-weight: 650; margin: 0 0 0.75rem; }
section { margin-top: 2.75rem; padding-top: 1.75rem; border-top: 1px solid var(--line); }
header::before { content: ""; display: block; width: 2.75rem; height: 4px; border-radius: 2px;
  background: var(--accent); margin-bottom: 1.25rem; }
p { margin: 0 0 0.9rem; max-width: 42rem; text-wrap: pretty; overflow-wrap: break-word; white-space: pre-line; }
code { font: 0.875em ui-monospace, "SF Mono", Menlo, Consolas, monospace; background: var(--stripe);
  padding: 0.1em 0.3em; border-radius: 4px; }
nav { color: var(--soft); font-size: 0.9rem; display: flex; flex-wrap: wrap; gap: 0.1rem 1.1rem; margin-top: 0.9rem; }
a { color: var(--accent); text-decoration: none; }
a:hover { text-decoration: underline; }
.table { overflow-x: auto; margin: 1.4rem 0; }
table { border-collapse: collapse; font-size: 0.9rem; line-height: 1.4; font-variant-numeric: tabular-nums; }
caption, figcaption { color: var(--soft); font-size: 0.875rem; line-height: 1.5; text-align: left; }
caption { padding-bottom: 0.5rem; }
th, td { padding: 0.4rem 1.1rem 0.4rem 0.6rem; text-align: left; vertical-align: top; white-space: nowrap; }
td.long { white-space: normal; min-width: 14rem; overflow-wrap: anywhere; }
th { font-weight: 600; border-bottom: 1.5px solid var(--ink); vertical-align: bottom; }
td { border-bottom: 1px solid var(--line); }
tbody tr:nth-child(even) { background: var(--stripe); }
.number { text-align: right; padding-left: 1.1rem; padding-right: 0.6rem; }
figure { margin: 1.6rem 0; }
figure img { display: block; max-width: 100%; height: auto; border-radius: 8px; }
img.chart { mix-blend-mode: multiply; }
figcaption { margin-top: 0.6rem; max-width: 42rem; }
@media (max-width: 36rem) {
  body { font-size: 16px; }
  main { padding-top: 2rem; }
  h1 { font-size: 1.6rem; }
  th { white-space: normal; }
  figure { overflow-x: auto; }
  img.chart { max-width: none; width: auto; height: 17rem; }
  .table { margin-left: -1.25rem; margin-right: -1.25rem; padding: 0 1.25rem; }
}
@media print { section { break-inside: avoid; } }
"""


@dataclasses.dataclass(frozen=True)
class ReportTable:
    """Rows of text and numbers. Floats are shown with ``decimals`` digits, None and NaN as a dash."""

    header: Sequence[str]
    rows: Sequence[Sequence[Cell]]
    caption: str = ""
    decimals: int = 2


@dataclasses.dataclass(frozen=True, eq=False)
class ReportFigure:
    """An RGB array, or the bytes of a PNG, WebP, GIF or JPEG file. A ``chart`` has a white background, which the dark
    theme inverts."""

    image: UInt8[ndarray, "h w 3"] | bytes
    caption: str = ""
    chart: bool = False


@dataclasses.dataclass(frozen=True, eq=False)
class ReportSection:
    """Shown in this order: heading, paragraphs, tables, figures. All text is escaped; in paragraphs, text between
    backticks is shown as code."""

    heading: str
    paragraphs: Sequence[str] = ()
    tables: Sequence[ReportTable] = ()
    figures: Sequence[ReportFigure] = ()


def _escape(text: str) -> str:
    """Plain text as HTML, with its line breaks."""
    return html.escape("\n".join(map(harmless, text.split("\n"))))


def _prose(text: str) -> str:
    return re.sub(r"`([^`]+)`", r"<code>\1</code>", _escape(text))


def _is_number(cell: Cell) -> bool:
    return isinstance(cell, int | float) and not isinstance(cell, bool)


def _cell_text(cell: Cell, decimals: int) -> str:
    if cell is None or (isinstance(cell, float) and math.isnan(cell)):
        return "–"
    if isinstance(cell, float):
        return f"{cell:,.{decimals}f}".replace("-", "−")
    if isinstance(cell, int) and not isinstance(cell, bool):
        return f"{cell:,}".replace("-", "−")
    return str(cell)


def _table(table: ReportTable) -> str:
    for row in table.rows:
        if len(row) != len(table.header):
            raise InputError(f"a table row has {len(row)} cells where the header has {len(table.header)}: {row}")
    numeric = [
        any(map(_is_number, column)) and all(cell is None or _is_number(cell) for cell in column)
        for column in zip(*table.rows, strict=True)
    ] or [False] * len(table.header)
    caption = f"<caption>{_escape(table.caption)}</caption>" if table.caption else ""

    def cells(tag: str, texts: Sequence[str]) -> str:
        parts = []
        for text, number in zip(texts, numeric, strict=True):
            style = ' class="number"' if number else ' class="long"' if tag == "td" and len(text) > 40 else ""
            parts.append(f"<{tag}{style}>{_escape(text)}</{tag}>")
        return f"<tr>{''.join(parts)}</tr>"

    body = "\n".join(cells("td", [_cell_text(cell, table.decimals) for cell in row]) for row in table.rows)
    return (
        f'<div class="table"><table>{caption}<thead>{cells("th", table.header)}</thead>\n'
        f"<tbody>{body}</tbody></table></div>"
    )


def _figure(figure: ReportFigure) -> str:
    if isinstance(figure.image, bytes):
        data = figure.image
    else:
        buffer = BytesIO()
        Image.fromarray(figure.image).save(buffer, "PNG", optimize=True)
        data = buffer.getvalue()
    kind = next((mime for signature, mime in _SIGNATURES if data.startswith(signature)), None)
    if kind is None:
        raise InputError("a report's picture must be the bytes of a PNG, WebP, GIF or JPEG file")
    with Image.open(BytesIO(data)) as opened:
        width, height = opened.size
    source = f"data:{kind};base64,{base64.b64encode(data).decode()}"
    style = ' class="chart"' if figure.chart else ""
    # Charts are drawn at twice the size at which they are shown, for sharp screens.
    scale = 2 if figure.chart else 1
    caption = _escape(figure.caption)
    return (
        f'<figure><img{style} src="{source}" alt="{caption}" width="{width // scale}" height="{height // scale}">'
        + (f"<figcaption>{caption}</figcaption>" if caption else "")
        + "</figure>"
    )


def write_report(path: Path, title: str, sections: Sequence[ReportSection]) -> None:
    """Write the report.

    Raises:
        InputError: when a table row's length differs from its header's, a picture has another format, or the file
            cannot be written.
    """
    parts = []
    for i, section in enumerate(sections):
        parts.append(f'<section id="s{i + 1}">\n<h2>{_escape(section.heading)}</h2>')
        parts += [f"<p>{_prose(paragraph)}</p>" for paragraph in section.paragraphs]
        parts += [_table(table) for table in section.tables]
        parts += [_figure(figure) for figure in section.figures]
        parts.append("</section>")
    links = [f'<a href="#s{i + 1}">{_escape(section.heading)}</a>' for i, section in enumerate(sections)]
    nav = f"<nav>{' '.join(links)}</nav>" if len(links) > 2 else ""
    document = f"""<!DOCTYPE html>
<html lang="en">
<head>
<meta charset="utf-8">
<meta name="viewport" content="width=device-width, initial-scale=1">
<title>{_escape(title)}</title>
<style>{_STYLE}</style>
</head>
<body>
<main>
<header><h1>{_escape(title)}</h1>{nav}</header>
{chr(10).join(parts)}
</main>
</body>
</html>
"""
    write_file(path, document)
