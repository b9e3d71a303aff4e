"""Every key of a spec kind as a page, made from its JSON Schema."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from typing import Any

from markdown_table import table

Schema = Mapping[str, Any]

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
    """A page: the keys of the spec itself, then those of each section, in the order of use."""
    lines = [
        f"# `kind: {kind}`",
        "",
        _sentence(schema.get("description", "")),
        "",
        f"The same for editors, as JSON Schema: `climbplan schema {kind}`.",
        "",
    ]
    models = {"": schema, **{name: schema["$defs"][name] for name in _used(schema)}}
    for name, model in models.items():
        if name:
            lines += [f"## {name}", "", _sentence(model.get("description", "")), ""]
        if "properties" in model:
            lines.append(table(("key", "value", "default", "meaning"), _rows(model)))
        else:
            lines += [f"One of {_type(model)}.", ""]
    return "\n".join(lines)


def _rows(model: Schema) -> Iterator[tuple[str, str, str, str]]:
    required = model.get("required", [])
    for key, field in model["properties"].items():
        default = "**required**" if key in required else _default(field)
        yield f"`{key}`", _type(field), default, _sentence(field.get("description", ""))


def _default(field: Schema) -> str:
    if field.get("default") is None:
        return ""
    text = json.dumps(field["default"])
    return f"`{text}`" if len(text) < 60 else "as shipped"


def _sentence(text: str) -> str:
    """Descriptions as they stand; brackets that Markdown would take for links escaped."""
    return " ".join(text.split()).replace("[", "\\[").replace("<", "\\<")


def _type(field: Schema) -> str:
    """What may stand there, with bounds; sections link to their tables."""
    if "$ref" in field:
        name = field["$ref"].rsplit("/", 1)[-1]
        return f"[{name}](#{name.lower()})"
    if "const" in field:
        return f"`{field['const']}`"
    if "enum" in field:
        return ", ".join(f"`{value}`" for value in field["enum"])
    for several in ("anyOf", "oneOf", "allOf"):
        if several in field:
            return " or ".join(dict.fromkeys(_type(one) for one in field[several]))
    kind = field.get("type", "")
    bounds = ", ".join(
        f"{word} {field[name]:g}"
        for name, word in _BOUNDS.items()
        if isinstance(field.get(name), int | float)
    )
    if kind == "array":
        return _array(field)
    if kind == "object" and isinstance(field.get("additionalProperties"), Mapping):
        return f"mapping to {_type(field['additionalProperties'])}"
    word = {"": "anything", "null": "`null`"}.get(kind, kind)
    return f"{word} {bounds}".strip()


def _array(field: Schema) -> str:
    if "prefixItems" in field:
        kinds = list(dict.fromkeys(_type(one) for one in field["prefixItems"]))
        return f"{len(field['prefixItems'])} of {' or '.join(kinds)}"
    return f"list of {_type(field.get('items', {}))}"


def _used(schema: Schema) -> list[str]:
    """Sections in the order in which keys first name them."""
    found: dict[str, None] = {}

    def walk(value: Any) -> None:
        if isinstance(value, Mapping):
            name = str(value.get("$ref", "")).rsplit("/", 1)[-1]
            if name and name not in found:
                found[name] = None
                walk(schema["$defs"][name])
            for key, entry in value.items():
                if key != "$defs":
                    walk(entry)
        elif isinstance(value, list):
            for entry in value:
                walk(entry)

    walk(schema)
    return list(found)
