"""Searches made with another budget than they have in use."""

from typing import Any

import pytest


def limit(patched: pytest.MonkeyPatch, search: type[Any], **budget: int) -> None:
    """Every ``search`` that is made from now on has this budget, whatever it is made with."""
    make = search.__init__

    def limited(self: object, *sizes: int, **_: int) -> None:
        make(self, *sizes, **budget)

    patched.setattr(search, "__init__", limited)
