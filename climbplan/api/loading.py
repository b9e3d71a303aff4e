"""`climbplan.load_spec`: read and check a spec from a file, a text, plain data or a model."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from pydantic import BaseModel

from climbplan.deprecation import renamed_parameters
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


@renamed_parameters(set="overrides")
def load_spec(
    source: SpecSource,
    overrides: Mapping[str, Any] | None = None,
    *,
    folder: str | Path | None = None,
) -> AnyLoaded:
    """Read a spec of any kind, override values and check it.

    Args:
        source: a path, a YAML text of several lines, a mapping with the keys of a YAML file, or a
            spec model such as `climbplan.ClimbSpec`, of which only the fields that were set count.
        overrides: values by dotted key, as with `--set`: `{"task.rounds": 3}`.
        folder: the directory that relative paths in the spec start from; None means the directory
            of the spec file, or the current one for other sources.

    Raises:
        SpecError: the spec has mistakes; all of them are listed, with lines where there is a text.
        UsageError: the source has another type.
    """
    text = read_spec_source(source)
    if folder is not None:
        text = SourceText(text.shown, text.name, Path(folder).resolve(), text.text)
    return load_source(text, build_overrides(overrides))


def override_spec(loaded: LoadedSpec, overrides: Mapping[str, Any]) -> LoadedSpec:
    """Return a loaded spec with values replaced and checked again; raises SpecError."""
    text = SourceText(loaded.source, loaded.name, loaded.directory, loaded.text)
    again = load_source(text, build_overrides(overrides))
    assert isinstance(again, LoadedSpec)  # of the same kind
    return again


def read_spec_source(source: SpecSource) -> SourceText:
    """Return the YAML text of a spec given in any form; raises SpecError and UsageError."""
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
        return SourceText("mapping", NAME, Path.cwd(), write_yaml(_to_yaml_types(dict(source))))
    raise UsageError(
        f"expected a path, a YAML text, a mapping or a spec model, got {type(source).__name__}"
    )


def build_overrides(values: Mapping[str, Any] | None) -> list[str | Override]:
    """Return overrides by dotted key as those of `--set`; None gives none. Raises UsageError."""
    return [_override(key, value) for key, value in (values or {}).items()]


def _override(key: str, value: Any) -> Override:
    if not isinstance(key, str) or not all(key.split(".")):
        raise UsageError(f"overrides: expected dotted keys such as 'task.rounds', got {key!r}")
    text = write_yaml(_to_yaml_types(value)).strip().removesuffix("...").strip()
    return Override(key, text, f"override {key}")


def _to_yaml_types(value: Any) -> Any:
    """Convert arrays, tuples and models to lists and mappings, which YAML has."""
    if isinstance(value, BaseModel):
        return value.model_dump(mode="json", exclude_unset=True, by_alias=True)
    if isinstance(value, np.ndarray | np.generic):
        return value.tolist()
    if isinstance(value, Path):
        return str(value)
    if isinstance(value, Mapping):
        return {key: _to_yaml_types(entry) for key, entry in value.items()}
    if isinstance(value, list | tuple):
        return [_to_yaml_types(entry) for entry in value]
    return value
