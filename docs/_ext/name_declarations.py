"""Names that readers type into the search, as generated pages declare them in Markdown.

A page declares a name where it explains it, with a role such as `{spec:key}` and the text
`min_normal_force <climb.force.min_normal_force>`. `reference_names` reads these roles; this module
needs no Sphinx, so that pages can be written without it.
"""

from __future__ import annotations

import re

KINDS = {
    "key": "spec key",
    "check": "check",
    "solver": "solver",
    "scene": "shipped scene",
    "robot": "robot",
}
TITLED = ("scene", "robot")  # shown by a title instead of the name


def make_anchor(kind: str, name: str) -> str:
    """Return the anchor of a name on its page; the first part of a key names the page."""
    local_name = name.partition(".")[2] if kind == "key" else name
    return f"{kind}-" + re.sub(r"[^\w-]+", "-", local_name).strip("-")


def declare(kind: str, name: str, shown: str = "") -> str:
    """Return the Markdown that declares a name and shows it, or another text, as code."""
    return f"{{spec:{kind}}}`{shown or name} <{name}>`"
