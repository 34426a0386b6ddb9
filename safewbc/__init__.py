"""The front door: ``import safewbc as sw``, and what most scripts need is there.

Each name is imported from its module when it is first asked for, so that ``import safewbc`` alone costs next to
nothing; the list of names is ``__init__.pyi``. What is not there is imported from the six packages themselves:
``robots``, ``wbc``, ``safety``, ``controllers``, ``sims``, ``experiments``.
"""

import ast
from importlib import import_module
from pathlib import Path
from typing import Any


def _read_list(path: Path) -> dict[str, str]:
    """Module of each name that a stub imports."""
    statements = ast.parse(path.read_text(encoding="utf-8")).body
    imports = [s for s in statements if isinstance(s, ast.ImportFrom)]
    return {alias.name: str(s.module) for s in imports for alias in s.names}


_HOMES = _read_list(Path(__file__).with_suffix(".pyi"))

__all__ = sorted(_HOMES)  # noqa: PLE0605 - a list all the same


def __getattr__(name: str) -> Any:
    """Import what ``name`` stands for.

    Raises:
        AttributeError: it is none of ``__all__``.
        ImportError: a package of others hides ours.
    """
    if name not in _HOMES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}, only {', '.join(__all__)}")
    try:
        value = getattr(import_module(_HOMES[name]), name)
    except ImportError as error:
        from safewbc.installation import installation_problem

        if problem := installation_problem():
            raise ImportError(problem, name=error.name) from error
        raise
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return __all__
