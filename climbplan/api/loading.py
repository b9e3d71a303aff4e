"""`climbplan.load`: a spec from a file, a text, plain data or a spec model, checked."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from pydantic import BaseModel

from climbplan.errors import UsageError
from climbplan.schema.loaded import LoadedSpec
from climbplan.schema.loading import load_source
from climbplan.schema.overrides import Override
from climbplan.schema.source import SourceText, read_source
from climbplan.schema.yaml_source import write_yaml

if TYPE_CHECKING:
    from climbplan.schema.loading import AnyLoaded

NAME = "spec"  # of specs that are no files

SpecSource = str | Path | Mapping[str, Any] | BaseModel


def load(
    source: SpecSource,
    set: Mapping[str, Any] | None = None,
    *,
    folder: str | Path | None = None,
) -> AnyLoaded:
    """Read, change and check a spec of any kind.

    source: a path, a YAML text of several lines, a mapping as YAML would have it, or a spec model
    such as `climbplan.ClimbSpec`, of which only what was stated counts as stated.
    set: values by dotted key, as `--set` has them: `{"task.rounds": 3}`.
    folder: that paths in a spec start from; by default the file's own, else the current one.

    Raises:
        SpecError: with every mistake, and the line of each where there is a text.
        UsageError: for a source of another type.
    """
    text = _text(source)
    if folder is not None:
        text = SourceText(text.shown, text.name, Path(folder).resolve(), text.text)
    return load_source(text, [_override(key, value) for key, value in (set or {}).items()])


def changed(loaded: LoadedSpec, set: Mapping[str, Any]) -> LoadedSpec:
    """A loaded spec with other values, checked anew; raises SpecError."""
    text = SourceText(loaded.source, loaded.name, loaded.directory, loaded.text)
    again = load_source(text, [_override(key, value) for key, value in set.items()])
    assert isinstance(again, LoadedSpec)  # of the same kind
    return again


def _text(source: SpecSource) -> SourceText:
    if isinstance(source, Path):
        return read_source(source)
    if isinstance(source, str):
        if "\n" in source:
            return SourceText("text", NAME, Path.cwd(), source)
        return read_source(source)
    if isinstance(source, BaseModel):
        data = source.model_dump(mode="json", exclude_unset=True, by_alias=True)
        return SourceText(type(source).__name__, NAME, Path.cwd(), write_yaml(data))
    if isinstance(source, Mapping):
        return SourceText("mapping", NAME, Path.cwd(), write_yaml(_plain(dict(source))))
    raise UsageError(
        f"a spec is a path, a YAML text, a mapping or a spec model, got {type(source).__name__}"
    )


def _override(key: str, value: Any) -> Override:
    if not isinstance(key, str) or not all(key.split(".")):
        raise UsageError(f"set: expected dotted keys such as 'task.rounds', got {key!r}")
    text = write_yaml(_plain(value)).strip().removesuffix("...").strip()
    return Override(key, text, f"set {key}")


def _plain(value: Any) -> Any:
    """Arrays, tuples and models as lists and mappings, which YAML has."""
    if isinstance(value, BaseModel):
        return value.model_dump(mode="json", exclude_unset=True, by_alias=True)
    if isinstance(value, np.ndarray | np.generic):
        return value.tolist()
    if isinstance(value, Path):
        return str(value)
    if isinstance(value, Mapping):
        return {key: _plain(entry) for key, entry in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(entry) for entry in value]
    return value
