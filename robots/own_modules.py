"""Modules from outside the project, named by the user as ``module:name``."""

import os
import sys
from importlib import import_module
from types import ModuleType

from robots.errors import ConfigError


def import_own(kind: str, reference: str, folder: str | None = None) -> tuple[ModuleType, str]:
    """Import the module of ``module:name``, from the working directory too.

    Args:
        kind: what is looked for, for messages.
        reference: ``module:name``; the module may be dotted.
        folder: where it is looked for before the working directory.

    Returns:
        The module, and the name, which is not looked up.

    Raises:
        ConfigError: the module cannot be imported.
    """
    module, _, name = reference.rpartition(":")
    if not all(part.isidentifier() for part in module.split(".")):
        raise ConfigError(kind, reference, "module:name with the dotted name of a module")
    # last: no folder of the user's own may hide one of the project's
    sys.path.extend(place for place in (folder, os.getcwd()) if place is not None and place not in sys.path)
    try:
        return import_module(module), name
    except (ImportError, SyntaxError) as error:
        raise ConfigError(kind, reference, f"module:name of a module that can be imported ({error})") from error
