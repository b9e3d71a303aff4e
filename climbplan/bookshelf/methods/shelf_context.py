"""What solved scenes were made for: the shelf, meaning and number of books that they serve."""

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


def context_of(shelf: Shelf, meaning: str, count: int, features: str) -> dict[str, Any]:
    """What a model of bookshelf scenes serves: shelf, meaning, number of stored books, features."""
    return {
        "problem": "bookshelf",
        "books": count,
        "meaning": meaning,
        "shelf": asdict(shelf),
        "features": features,
    }


def require_context(
    given: Mapping[str, Any], shelf: Shelf, meaning: str, count: int, where: object
) -> None:
    """Raises UsageError naming the first thing in which the context of a model or library differs.

    where: the file that the message begins with. The frame and tolerances of `published` count in
    that meaning only.
    """
    wanted = context_of(shelf, meaning, count, str(given.get("features")))
    if given.get("problem") != "bookshelf":
        raise UsageError(f"{where}: made for problem {given.get('problem')!r}, not for bookshelves")
    if given.get("features") not in ("gaps", "raw"):
        raise UsageError(f"{where}: features {given.get('features')!r} that there are not")
    for key in ("books", "meaning"):
        if given.get(key) != wanted[key]:
            raise UsageError(
                f"{where}: made for {key} {_shown(given.get(key))}, here it is {wanted[key]!r}"
            )
    theirs, ours = _flat(given.get("shelf")), _flat(wanted["shelf"])
    for key, expected in ours.items():
        if meaning == "contact" and key.startswith(_PUBLISHED):
            continue
        found = theirs.get(key)
        if not isinstance(found, float) or not math.isclose(found, expected, abs_tol=_SAME):
            unit = _UNITS.get(key, " m")
            given_as = f"{found:g}{unit}" if isinstance(found, float) else _shown(found)
            raise UsageError(
                f"{where}: made for a shelf whose {key} is {given_as}, here it is "
                f"{expected:g}{unit}"
            )


def _flat(shelf: object) -> dict[str, Any]:
    """A shelf's numbers, those of the published meaning among them."""
    if not isinstance(shelf, Mapping):
        return {}
    inner = shelf.get("published")
    published = inner if isinstance(inner, Mapping) else {}
    own = {str(key): value for key, value in shelf.items() if key != "published"}
    flat = own | {f"{_PUBLISHED}{key}": value for key, value in published.items()}
    return {key: _as_float(value) for key, value in flat.items()}


def _as_float(value: object) -> object:
    """Whole numbers as floats, if there is such a float: the file may hold any number of digits."""
    return float(value) if type(value) is int and abs(value) < 2**53 else value


def _shown(value: object) -> str:
    text = repr(value)
    return text if len(text) <= 40 else f"{text[:37]}..."
