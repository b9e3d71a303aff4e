"""Loading of a bookshelf spec file with overrides; all mistakes are reported at once.

A path in the file is relative to the file's directory. A path of a command option is relative to
the current directory; the spec's text has it in full and means the same anywhere.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from climbplan.bookshelf.schema.model import BookshelfSpec
from climbplan.errors import SpecError
from climbplan.schema.document import Document, KeyPath
from climbplan.schema.kinds import validate_kind
from climbplan.schema.loaded import LoadedSpec, describe_origin, resolve_option_paths
from climbplan.schema.overrides import Override, apply_overrides
from climbplan.schema.source import SourceText, read_source
from climbplan.schema.yaml_source import parse_yaml

_PATHS: tuple[KeyPath, ...] = (
    ("scenes", "file"),
    ("solver", "library", "file"),
    ("solver", "model", "file"),
)


@dataclass(frozen=True, kw_only=True)
class LoadedShelf(LoadedSpec):
    """A bookshelf spec and the text it came from; files it names are not opened yet."""

    spec: BookshelfSpec


def load_shelf(source: str | Path, overrides: Sequence[str | Override] = ()) -> LoadedShelf:
    """Read, override and check a bookshelf spec; `source` is a path or `-` for standard input.

    Raises:
        SpecError: with every mistake in spec and overrides.
    """
    text = read_source(source)
    document = apply_overrides(parse_yaml(text.text, text.shown), overrides)
    return shelf_of_document(document, text)


def shelf_of_document(document: Document, text: SourceText) -> LoadedShelf:
    """Validate a document as a bookshelf spec.

    Raises:
        SpecError: with every mistake in it.
    """
    resolve_option_paths(document, _PATHS)
    spec, findings = validate_kind(document, "bookshelf", BookshelfSpec)
    if spec is None or findings:
        raise SpecError(document.source, document.mistakes(findings))
    return LoadedShelf(spec=spec, **describe_origin(document, text))
