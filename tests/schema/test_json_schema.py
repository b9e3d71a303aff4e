"""JSON Schemas: complete, and in agreement with the models."""

from __future__ import annotations

import json
from collections.abc import Iterator
from typing import Any

import pytest

from climbplan.errors import UsageError
from climbplan.schema.json_schema import DIALECT, build_all_schemas, json_schema
from climbplan.schema.kinds import KINDS


def properties(schema: Any, path: str = "") -> Iterator[tuple[str, dict[str, Any]]]:
    if isinstance(schema, dict):
        for name, body in schema.get("properties", {}).items():
            yield f"{path}.{name}", body
        for key, below in schema.items():
            yield from properties(below, f"{path}.{key}")


@pytest.mark.parametrize("kind", KINDS)
def test_every_property_is_described(kind: str) -> None:
    schema = json_schema(kind)
    assert schema["$schema"] == DIALECT
    assert schema["$id"].endswith(kind)
    assert kind in schema["title"]
    assert "kind" in schema["required"]
    assert schema["additionalProperties"] is False
    found = dict(properties(schema))
    assert len(found) > 10
    missing = []
    for path, body in found.items():
        model = schema.get("$defs", {}).get(body.get("$ref", "").removeprefix("#/$defs/"), {})
        if not body.get("description") and not model.get("description"):
            missing.append(path)
    assert missing == []


@pytest.mark.parametrize("kind", KINDS)
def test_references_resolve(kind: str) -> None:
    schema = json_schema(kind)
    text = json.dumps(schema)
    names = {part.split('"')[0] for part in text.split("#/$defs/")[1:]}
    assert names <= set(schema.get("$defs", {}))


def test_units_and_bounds_are_there() -> None:
    defs = json_schema("climb")["$defs"]
    gap = defs["WallsSpec"]["properties"]["gap"]
    assert gap["unit"] == "m"
    assert gap["description"].endswith("[m]")
    assert gap["exclusiveMinimum"] == 0
    com = defs["StartSpec"]["properties"]["com"]
    assert (com["minItems"], com["maxItems"]) == (3, 3)
    methods = defs["SolverSpec"]["properties"]["method"]["enum"]
    assert methods[:5] == ["auto", "micp", "nlp", "coupled", "coupled-modes"]
    assert methods[5:] == [
        "coupled-mccormick",
        "coupled-nlp",
        "coupled-minlp-scip",
        "sl1-relaxation",
        "contact-search",
    ]


def test_one_schema_for_all() -> None:
    schema = build_all_schemas()
    referred = {entry["$ref"] for entry in schema["oneOf"]}
    assert referred == {body["$id"] for body in schema["$defs"].values()}


def test_unknown_kind() -> None:
    with pytest.raises(UsageError, match="did you mean 'climb'"):
        json_schema("climbs")
