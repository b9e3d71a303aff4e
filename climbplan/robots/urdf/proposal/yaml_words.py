"""Values as YAML has them."""

from __future__ import annotations

import json

from climbplan.arrays import Array


def scalar(value: str) -> str:
    """A scalar of YAML that reads back as this text."""
    plain = value.replace("_", "a").replace("-", "a").isalnum() and value[:1].isalpha()
    words = {"y", "n", "yes", "no", "on", "off", "true", "false", "null"}
    return value if plain and value.lower() not in words else json.dumps(value)


def mapping(values: dict[str, float]) -> str:
    """Numbers by name."""
    return "{" + ", ".join(f"{scalar(n)}: {v:g}" for n, v in values.items()) + "}"


def vector(values: Array, digits: int = 4) -> str:
    """Lengths [m], to a tenth of a millimetre if nothing else is asked for."""
    return "[" + ", ".join(f"{float(v):.{digits}f}" for v in values) + "]"
