"""Format values as YAML."""

from __future__ import annotations

import json

from climbplan.arrays import Array


def format_scalar(value: str) -> str:
    """Return a YAML scalar that reads back as this text."""
    is_plain = value.replace("_", "a").replace("-", "a").isalnum() and value[:1].isalpha()
    reserved = {"y", "n", "yes", "no", "on", "off", "true", "false", "null"}
    return value if is_plain and value.lower() not in reserved else json.dumps(value)


def format_mapping(values: dict[str, float]) -> str:
    """Return numbers by name as a YAML flow mapping."""
    return "{" + ", ".join(f"{format_scalar(n)}: {v:g}" for n, v in values.items()) + "}"


def format_vector(values: Array, digits: int = 4) -> str:
    """Return lengths [m] as a YAML flow sequence, with `digits` decimals."""
    return "[" + ", ".join(f"{float(v):.{digits}f}" for v in values) + "]"
