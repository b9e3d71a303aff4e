"""Every key of a spec kind as a page, made from its JSON Schema."""

from __future__ import annotations

import json
import re
from collections.abc import Iterator, Mapping
from typing import Any

from markdown_table import wrapped_table
from name_declarations import declare

Schema = Mapping[str, Any]
Places = Mapping[str, list[str]]  # of each section, by its name in the schema

_BOUNDS = {
    "minimum": "at least",
    "ge": "at least",
    "exclusiveMinimum": "above",
    "gt": "above",
    "maximum": "at most",
    "le": "at most",
    "exclusiveMaximum": "below",
    "lt": "below",
}


def keys_page(kind: str, schema: Schema) -> str:
    """A page: the keys of the spec itself, then those of each section, under its dotted key."""
    lines = [
        f"# `kind: {kind}`",
        "",
        _sentence(schema.get("description", "")),
        "",
        f"The same for editors, as JSON Schema: `climbplan schema {kind}`.",
        "",
    ]
    places = _places(schema)
    lines += _section(schema, places, kind)
    for name, (first, *others) in places.items():
        model = schema["$defs"][name]
        lines += [f"## {_heading(first)}", "", _sentence(model.get("description", "")), ""]
        if others:
            lines += ["The same at " + ", ".join(f"`{place}`" for place in others) + ".", ""]
        lines += _section(model, places, f"{kind}.{first}")
    return "\n".join(lines)


def _section(model: Schema, places: Places, prefix: str) -> list[str]:
    if "properties" in model:
        rows = _rows(model, places, prefix)
        return [wrapped_table("stacked keys", ("key", "value", "default", "meaning"), rows)]
    return [f"One of {_type(model, places)}.", ""]


def _heading(place: str) -> str:
    return place.replace("[", "\\[").replace("<", "\\<").replace("_", "\\_")


def _anchor(place: str) -> str:
    """What MyST makes of a heading."""
    return re.sub(r"[^\w-]", "", place.lower().replace(" ", "-"))


def _rows(model: Schema, places: Places, prefix: str) -> Iterator[tuple[str, str, str, str]]:
    required = model.get("required", [])
    for key, field in model["properties"].items():
        default = "**required**" if key in required else _default(field)
        name = declare("key", f"{prefix}.{key}", key)
        yield name, _type(field, places), default, _sentence(field.get("description", ""))


def _default(field: Schema) -> str:
    if field.get("default") is None:
        return ""
    if isinstance(field["default"], Mapping) and field["default"]:
        return "as listed"
    return f"`{json.dumps(field['default'])}`"


def _sentence(text: str) -> str:
    """Descriptions as they stand; brackets that Markdown would take for links escaped."""
    return " ".join(text.split()).replace("[", "\\[").replace("<", "\\<")


def _type(field: Schema, places: Places) -> str:
    """What may stand there, with bounds; sections link to their tables."""
    if "$ref" in field:
        place = places[_name(field)][0]
        return f"[{_heading(place)}](#{_anchor(place)})"
    if "const" in field:
        return f"`{field['const']}`"
    if "enum" in field:
        return ", ".join(f"`{value}`" for value in field["enum"])
    for several in ("anyOf", "oneOf", "allOf"):
        if several in field:
            return " or ".join(dict.fromkeys(_type(one, places) for one in field[several]))
    kind = field.get("type", "")
    if kind == "array":
        return _array(field, places)
    if kind == "object" and isinstance(field.get("additionalProperties"), Mapping):
        return f"mapping to {_type(field['additionalProperties'], places)}"
    bounds = ", ".join(
        f"{word} {_number(field[name])}"
        for name, word in _BOUNDS.items()
        if isinstance(field.get(name), int | float)
    )
    word = {"": "anything", "null": "`null`"}.get(kind, kind)
    return f"{word} {bounds}".strip()


def _number(value: float) -> str:
    return str(int(value)) if value == int(value) else f"{value:g}"


def _array(field: Schema, places: Places) -> str:
    if "prefixItems" in field:
        kinds = list(dict.fromkeys(_type(one, places) for one in field["prefixItems"]))
        return f"{len(field['prefixItems'])} of {' or '.join(kinds)}"
    return f"list of {_type(field.get('items', {}), places)}"


def _name(field: Schema) -> str:
    return str(field["$ref"]).rsplit("/", 1)[-1]


def _places(schema: Schema) -> Places:
    """Dotted keys of every section, in the order of use; `[]` stands for an entry of a list."""
    found: dict[str, list[str]] = {}

    def walk(field: Any, place: str) -> None:
        if isinstance(field, list):
            for entry in field:
                walk(entry, place)
        if not isinstance(field, Mapping):
            return
        if "$ref" in field:
            name = _name(field)
            known = name in found
            if place not in found.setdefault(name, []):
                found[name].append(place)
            if not known:
                walk(schema["$defs"][name], place)
        for key, entry in field.get("properties", {}).items():
            walk(entry, f"{place}.{key}" if place else key)
        for several in ("anyOf", "oneOf", "allOf"):
            walk(field.get(several), place)
        walk(field.get("items"), f"{place}[]")
        walk(field.get("prefixItems"), f"{place}[]")
        walk(field.get("additionalProperties"), f"{place}.NAME")

    walk(schema, "")
    firsts = [places[0] for places in found.values()]
    for name, places in found.items():
        if firsts.count(places[0]) > 1:  # one of several by `kind`
            places[0] = f"{places[0]} ({name})"
    return found
