"""The context of solved scenes: the shelf, meaning and number of books that they serve.

Published methods and values are those of X. Lin (UCLA 2022).
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import asdict
from typing import Any

from climbplan.bookshelf.scene.shelf_scene import Shelf
from climbplan.errors import UsageError

_SAME = 1e-9  # [m, rad] shelves that differ by less are the same
_PUBLISHED = "published "
_UNITS = {"lean_margin": " rad", "published sine": ""}  # all others are lengths


def build_context(shelf: Shelf, meaning: str, count: int, features: str) -> dict[str, Any]:
    """Build the context of a model: shelf, meaning, number of stored books and features."""
    return {
        "problem": "bookshelf",
        "books": count,
        "meaning": meaning,
        "shelf": asdict(shelf),
        "features": features,
    }


def require_context(
    context: Mapping[str, Any], shelf: Shelf, meaning: str, count: int, where: object
) -> None:
    """Require that a model or library was made for this shelf, meaning and number of books.

    The frame and tolerances of `published` count in that meaning only.

    Args:
        context: of the model or library, from its file.
        shelf: the shelf to be served.
        meaning: the meaning to be served.
        count: number of stored books.
        where: the file with which the message begins.

    Raises:
        UsageError: naming the first difference.
    """
    expected_context = build_context(shelf, meaning, count, str(context.get("features")))
    if context.get("problem") != "bookshelf":
        raise UsageError(
            f"{where}: made for problem {context.get('problem')!r}, not for bookshelves"
        )
    if context.get("features") not in ("gaps", "raw"):
        features = context.get("features")
        raise UsageError(f"{where}: expected features 'gaps' or 'raw', got {features!r}")
    for key, label in (("books", "books"), ("meaning", "formulation")):
        if context.get(key) != expected_context[key]:
            raise UsageError(
                f"{where}: made for {label} {_truncate_repr(context.get(key))}, "
                f"here it is {expected_context[key]!r}"
            )
    shelf_values, expected_values = (
        _flatten_shelf(context.get("shelf")),
        _flatten_shelf(expected_context["shelf"]),
    )
    for key, expected in expected_values.items():
        if meaning == "contact" and key.startswith(_PUBLISHED):
            continue
        value = shelf_values.get(key)
        if not isinstance(value, float) or not math.isclose(value, expected, abs_tol=_SAME):
            unit = _UNITS.get(key, " m")
            given_as = f"{value:g}{unit}" if isinstance(value, float) else _truncate_repr(value)
            raise UsageError(
                f"{where}: made for a shelf whose {key} is {given_as}, here it is "
                f"{expected:g}{unit}"
            )


def _flatten_shelf(shelf: object) -> dict[str, Any]:
    """Flatten the quantities of a shelf, those of the published meaning included."""
    if not isinstance(shelf, Mapping):
        return {}
    inner = shelf.get("published")
    published = inner if isinstance(inner, Mapping) else {}
    shelf_numbers = {str(key): value for key, value in shelf.items() if key != "published"}
    flat = shelf_numbers | {f"{_PUBLISHED}{key}": value for key, value in published.items()}
    return {key: _convert_to_float(value) for key, value in flat.items()}


def _convert_to_float(value: object) -> object:
    """Convert whole numbers that a float represents exactly; a file may hold any number."""
    return float(value) if type(value) is int and abs(value) < 2**53 else value


def _truncate_repr(value: object) -> str:
    text = repr(value)
    return text if len(text) <= 40 else f"{text[:37]}..."
