"""Texts as people write them: "mm^2" in files and code is "mm²" on pages and in figures."""

from __future__ import annotations

import re

_RAISED = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")
_CODE = re.compile(r"`([^`]*)`")
_EXPONENT = re.compile(r"(?<=[A-Za-z])\^(-?\d+)")


def format_units(text: object) -> str:
    """Return text with raised whole exponents ("N/mm^2", "k^-1"), and words of code in quotation
    marks.
    """
    quoted = _CODE.sub("“\\1”", str(text))
    return _EXPONENT.sub(lambda found: found[1].translate(_RAISED), quoted)
