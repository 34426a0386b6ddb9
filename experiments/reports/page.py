"""Pages from templates: each one file that needs nothing else to be read."""

import base64
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

from jinja2 import Environment, FileSystemLoader, StrictUndefined

from robots.errors import ConfigError

TEMPLATES = Path(__file__).with_name("templates")
"""Where the templates are; ``page.html.jinja`` is the frame of all pages, ``parts.html.jinja`` has their parts."""


@dataclass(frozen=True, slots=True)
class PlotPart:
    """A plot of a page: heading, what it shows, and the PNG; a plot without one is left out."""

    heading: str
    png: bytes | None
    caption: str


def write_page(path: Path, template: str, **values: Any) -> Path:
    """Write a page.

    Args:
        path: the HTML file.
        template: name of one that extends ``page.html.jinja``.
        **values: of the template; of every one ``title``, ``lead`` and ``note``, sentences under the title, may be
            empty.

    Returns:
        ``path``.

    Raises:
        ConfigError: the file cannot be written.
    """
    page = render(template, **values)
    try:
        path.write_text(page, encoding="utf-8")
    except OSError as error:
        raise ConfigError("report", str(path), f"a file that can be written ({error.strerror or error})") from error
    return path


def render(template: str, **values: Any) -> str:
    """The text that a template makes of ``values``, which are escaped.

    Raises:
        jinja2.UndefinedError: a value is missing.
    """
    return _environment().get_template(template).render(values)


@cache
def _environment() -> Environment:
    environment = Environment(
        loader=FileSystemLoader(TEMPLATES),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.filters["data_uri"] = data_uri
    return environment


def data_uri(content: bytes, kind: str) -> str:
    """An address that holds the content itself; ``kind``: its MIME type."""
    return f"data:{kind};base64,{base64.b64encode(content).decode()}"
