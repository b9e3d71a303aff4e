"""JSON Schema of each kind of spec, for editors that complete and check YAML."""

from __future__ import annotations

from typing import Any

from climbplan.errors import UsageError
from climbplan.schema.fields import find_closest_name
from climbplan.schema.kinds import KINDS

DIALECT = "https://json-schema.org/draft/2020-12/schema"


def json_schema(kind: str) -> dict[str, Any]:
    """Return the JSON Schema (draft 2020-12) of one kind, with meaning and unit of each property.

    Args:
        kind: Kind of spec, such as "climb".

    Raises:
        UsageError: there is no such kind.
    """
    if kind not in KINDS:
        closest = find_closest_name(kind, list(KINDS))
        hint = f" (did you mean {closest!r}?)" if closest else ""
        raise UsageError(f"no spec kind {kind!r}, known are {', '.join(KINDS)}{hint}")
    body = KINDS[kind].model.model_json_schema()
    body["required"] = list(dict.fromkeys(["kind", *body.get("required", [])]))
    return {
        "$schema": DIALECT,
        "$id": f"urn:climbplan:spec:{kind}",
        "title": f"climbplan {kind} spec",
        **{key: value for key, value in body.items() if key != "title"},
    }


def build_all_schemas() -> dict[str, Any]:
    """Return one JSON Schema that accepts every kind and tells them apart by `kind`."""
    return {
        "$schema": DIALECT,
        "$id": "urn:climbplan:spec",
        "title": "climbplan spec",
        "oneOf": [{"$ref": f"urn:climbplan:spec:{kind}"} for kind in KINDS],
        "$defs": {kind: json_schema(kind) for kind in KINDS},
    }
