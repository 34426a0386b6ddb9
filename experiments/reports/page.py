"""The HTML page that reports are made of: style, sections, pictures; one file that needs nothing else to be read."""

import base64
import html
from collections.abc import Sequence
from pathlib import Path

from robots.errors import ConfigError

STYLE = """
:root { --ink: #26303a; --soft: #66727f; --line: #e1e6eb; --good: #1d7f4e; --bad: #c0262d; --back: #f5f7f9; }
* { box-sizing: border-box; }
body { margin: 0; background: var(--back); color: var(--ink); font: 15px/1.5 system-ui, "Segoe UI", sans-serif; }
main { max-width: 1080px; margin: 0 auto; padding: 32px 20px 64px; }
h1 { font-size: 27px; margin: 0 0 4px; }
h2 { font-size: 18px; margin: 0 0 6px; }
section { background: #fff; border: 1px solid var(--line); border-radius: 10px; padding: 18px 22px; margin-top: 18px; }
p.soft, figcaption, td.unit { color: var(--soft); }
p { margin: 4px 0 10px; }
.scroll { overflow-x: auto; }
table { border-collapse: collapse; width: 100%; }
th, td { text-align: right; padding: 5px 12px; border-bottom: 1px solid var(--line); }
td { font-variant-numeric: tabular-nums; }
th:first-child, td:first-child { text-align: left; padding-left: 0; }
td.unit { text-align: left; padding-left: 0; width: 1%; white-space: nowrap; }
tr:last-child td { border-bottom: 0; }
.good { color: var(--good); } .bad { color: var(--bad); font-weight: 600; }
ul.verdict { list-style: none; padding: 0; margin: 2px 0 12px; } ul.verdict:last-child { margin-bottom: 0; }
.frames { display: flex; gap: 10px; flex-wrap: wrap; margin-bottom: 12px; }
figure { margin: 0; } .frames figure { flex: 1 1 200px; max-width: 250px; }
img, video { max-width: 100%; height: auto; display: block; border-radius: 6px; }
figcaption { font-size: 13px; margin-top: 3px; }
pre { background: var(--back); padding: 12px; border-radius: 6px; overflow-x: auto; font-size: 12.5px; }
summary { cursor: pointer; }
@media print { body { background: #fff; } section { break-inside: avoid; } }
"""


def write_page(path: Path, title: str, parts: Sequence[str], style: str = "") -> Path:
    """Write a page of HTML parts, empty ones left out; ``style`` adds to the common one.

    Returns:
        ``path``.

    Raises:
        ConfigError: the file cannot be written.
    """
    page = (
        '<!doctype html>\n<html lang="en"><head><meta charset="utf-8">'
        '<meta name="viewport" content="width=device-width, initial-scale=1">'
        f"<title>{html.escape(title)}</title><style>{STYLE}{style}</style></head>\n<body><main>\n"
        + "\n".join(part for part in parts if part)
        + "\n</main></body></html>\n"
    )
    try:
        path.write_text(page, encoding="utf-8")
    except OSError as error:
        raise ConfigError("report", str(path), f"a file that can be written ({error.strerror or error})") from error
    return path


def section(heading: str, body: str) -> str:
    """A section of HTML ``body`` under a heading."""
    return f"<section><h2>{html.escape(heading)}</h2>{body}</section>"


def image(png: bytes, alt: str) -> str:
    """A picture within the page."""
    return f'<img alt="{html.escape(alt, quote=True)}" src="data:image/png;base64,{base64.b64encode(png).decode()}">'


def plot_section(heading: str, png: bytes | None, caption: str) -> str:
    """A section with a plot and what it shows; empty where there is no plot."""
    if png is None:
        return ""
    return section(heading, f'<p class="soft">{html.escape(caption)}</p>{image(png, heading)}')
