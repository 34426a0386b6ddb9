r"""Docstrings of the API reference: their Sphinx roles and equations, as the Markdown and MathML of the site.

Our docstrings say ``:class:`robots.kinematics.Kinematics``` and ``.. math::``, which editors show well; mkdocstrings
reads Markdown. Equations become MathML, which browsers draw without a script.
"""

import re
from typing import Any

import griffe
from latex2mathml.converter import convert

OURS = ("robots", "wbc", "safety", "controllers", "sims", "experiments", "safewbc")

ROLE = re.compile(r":(class|meth|func|attr|mod|data):`~?([\w.]+)`")
INLINE = re.compile(r":math:`([^`]+)`")
DISPLAY = re.compile(r"^\.\. math::[ \t]*(.*(?:\n(?:[ \t]*\n)*[ \t]+.*)*)", re.MULTILINE)
UNITS = re.compile(r"\](\s?)\[")
"""Two units side by side, which Markdown would read as a link."""

CODE = re.compile(r"``([^`]+)``")


class SphinxMarkup(griffe.Extension):
    """Translates the docstring of every object once it is loaded."""

    def on_object(self, *, obj: griffe.Object, **kwargs: Any) -> None:
        """See :meth:`griffe.Extension.on_object`."""
        if obj.docstring is not None:
            obj.docstring.value = to_markdown(obj.docstring.value)


def to_markdown(text: str) -> str:
    """Markdown of a docstring with Sphinx roles and equations."""
    text = DISPLAY.sub(lambda m: f"<div>{convert(' '.join(m[1].split()), display='block')}</div>", text)
    text = UNITS.sub(r"]\1\[", INLINE.sub(lambda m: convert(m[1]), text))
    return CODE.sub(r"`\1`", ROLE.sub(_reference, text))


def _reference(role: re.Match[str]) -> str:
    """A link where the role names its target in full, else code; attributes are told at their class."""
    kind, name = role.groups()
    target = name.rpartition(".")[0] if kind == "attr" else name
    return f"[`{name}`][{target}]" if name.split(".")[0] in OURS else f"`{name}`"
