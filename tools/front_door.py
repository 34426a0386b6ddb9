"""The page of the front door: its names with the first line of their docstrings, by package. A hook of mkdocs."""

import ast
from collections.abc import Iterator
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parents[1]
PAGE = "api/safewbc.md"


def on_page_markdown(markdown: str, page: Any, **kwargs: Any) -> str:
    """Add the tables to the page; see mkdocs' event of this name."""
    return markdown + "\n".join(tables()) if page.file.src_path == PAGE else markdown


def tables() -> Iterator[str]:
    """Lines of Markdown: a table for each package."""
    package = ""
    for statement in _body(ROOT / "safewbc" / "__init__.pyi"):
        if not isinstance(statement, ast.ImportFrom) or statement.module is None:
            continue
        if (first := statement.module.split(".")[0]) != package:
            package = first
            yield f"\n## From `{package}`\n\n| name | what it is |\n|---|---|"
        said = _first_lines(ROOT / f"{statement.module.replace('.', '/')}.py")
        for alias in statement.names:
            target = f"{statement.module}.{alias.name}"
            yield f"| [`{alias.name}`][{target}] | {said[alias.name]} |"


def _first_lines(path: Path) -> dict[str, str]:
    """First line of the docstring of each class and function of a file."""
    kinds = (ast.ClassDef, ast.FunctionDef)
    return {s.name: (ast.get_docstring(s) or "").split("\n")[0] for s in _body(path) if isinstance(s, kinds)}


def _body(path: Path) -> list[ast.stmt]:
    return ast.parse(path.read_text(encoding="utf-8")).body
