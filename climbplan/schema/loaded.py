"""What every loaded spec carries besides its model: its text, and where each value was written."""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from climbplan.errors import SpecError
from climbplan.schema.document import Document, KeyPath
from climbplan.schema.source import SourceText
from climbplan.schema.yaml_source import write_yaml


@dataclass(frozen=True, kw_only=True)
class LoadedSpec:
    """The text a spec came from; the kinds add their models."""

    text: str  # YAML after overrides; the file's own text if there were none
    sha256: str  # of `text`
    name: str  # file stem, "stdin" for standard input
    source: str  # as in messages
    directory: Path  # that relative paths start from
    document: Document = field(repr=False, compare=False)  # where each value was written

    def locate(self, error: SpecError) -> SpecError:
        """Return an error that planning raised, with the lines of the keys it names."""
        return SpecError(error.source, [self.document.locate(m) for m in error.mistakes])


def describe_origin(document: Document, text: SourceText) -> dict[str, Any]:
    """Return the fields of `LoadedSpec` that say where a spec comes from, by name.

    Args:
        document: The parsed spec; its text is that after overrides.
        text: The source that it was read from.
    """
    return {
        "text": document.text,
        "sha256": hashlib.sha256(document.text.encode()).hexdigest(),
        "name": text.name,
        "source": text.shown,
        "directory": text.directory,
        "document": document,
    }


def resolve_option_paths(document: Document, paths: Sequence[KeyPath]) -> None:
    """Make paths absolute that command options set, from the current directory.

    Args:
        document: The parsed spec, changed in place; its text is written anew if a path changes.
        paths: Keys whose values are paths or lists of paths. Values from the file stay.
    """
    changed = False
    for path in paths:
        holder: Any = document.value
        for key in path[:-1]:
            holder = holder.get(key) if isinstance(holder, dict) else None
        value = holder.get(path[-1]) if isinstance(holder, dict) else None
        if isinstance(value, str) and value and _is_set_by_option(document, path):
            holder[path[-1]] = str(Path.cwd() / value)
            changed = True
        elif isinstance(value, list) and _is_set_by_option(document, path):
            several = [isinstance(entry, str) and entry != "" for entry in value]
            pairs = zip(value, several, strict=True)
            holder[path[-1]] = [str(Path.cwd() / v) if text else v for v, text in pairs]
            changed = True
    if changed:
        document.text = write_yaml(document.value)


def _is_set_by_option(document: Document, path: KeyPath) -> bool:
    """Return whether a command option set the value at `path`, rather than the file."""
    for length in range(len(path), 0, -1):
        if path[:length] in document.options:
            return True
        if path[:length] in document.lines:
            return False
    return False
