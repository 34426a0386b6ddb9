"""Whether the six packages that get imported are ours: their names are common words, and others use them too.

Uses the standard library alone and imports none of the six, so that it works where one of them is hidden.
"""

import importlib.util
from collections.abc import Iterator
from importlib.metadata import PackageNotFoundError, distribution
from pathlib import Path

PACKAGES = ("robots", "wbc", "safety", "controllers", "sims", "experiments")
"""Import names of the six packages behind the front door."""

HOME = Path(__file__).resolve().parents[1]
"""The folder in which this installation of ours stands."""


def installation_problem(home: Path = HOME) -> str | None:
    """What keeps the six packages from being ours, one line for each fault; ``None`` where nothing does.

    Args:
        home: folder in which they should stand.
    """
    return "\n".join([*_hidden(home), *_mixed(home)]) or None


def _hidden(home: Path) -> Iterator[str]:
    """Packages that are found elsewhere, or not at all."""
    for name in PACKAGES:
        place = _place(name)
        if place is None:
            yield f"package {name!r} is not in {home}: {_renew(home)}"
        elif not place.is_relative_to(home / name):
            if _foreign_files(name, place.parent.parent):
                yield f"PyPI's project {name!r} hides ours in {home}: run `python -m pip uninstall {name}`"
            else:
                module = place.parent if place.stem == "__init__" else place
                yield (
                    f"{module} hides our package {name!r} in {home}: rename it, or start where it is neither in the "
                    "current folder nor on PYTHONPATH"
                )


def _mixed(home: Path) -> Iterator[str]:
    """Projects of others that have put files into our folders: a pip install of both has one folder for the two."""
    for name in PACKAGES:
        if _foreign_files(name, home):
            yield (
                f"PyPI's project {name!r} has written its files into ours in {home / name}: run `python -m pip "
                f"uninstall {name}`, then {_renew(home)}, since that takes shared files away as well"
            )


def _place(name: str) -> Path | None:
    """File that ``import name`` would run, or the folder of a package without ``__init__``."""
    spec = importlib.util.find_spec(name)
    if spec is None:
        return None
    if spec.origin is None:
        return Path(next(iter(spec.submodule_search_locations or ()))).resolve()
    return Path(spec.origin).resolve()


def _foreign_files(name: str, folder: Path) -> bool:
    """Whether an installed project ``name`` has a package of that name in ``folder``."""
    try:
        project = distribution(name)
    except PackageNotFoundError:
        return False
    files = (project.locate_file(file) for file in project.files or () if file.parts[0] == name)
    return any(Path(str(file)).resolve().is_relative_to(folder / name) for file in files)


def _renew(home: Path) -> str:
    """How to get our files back: a checkout and a pip install want different commands."""
    if (home / "pyproject.toml").is_file():
        return f"restore it (`git -C {home} status`) and run `make setup` there"
    return "run `python -m pip install --force-reinstall --no-deps safewbc`"
