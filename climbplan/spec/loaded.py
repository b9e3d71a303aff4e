"""What every loaded spec carries besides its model: its text, and where each value was written."""

from __future__ import annotations

import hashlib
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from climbplan.errors import SpecError
from climbplan.spec.document import Document
from climbplan.spec.source import SourceText


@dataclass(frozen=True, kw_only=True)
class LoadedSpec:
    """The text a spec came from; the kinds add their models."""

    text: str  # YAML after overrides; the file's own text if there were none
    sha256: str  # of `text`
    name: str  # file stem, "stdin" for standard input
    source: str  # as in messages
    directory: Path  # that relative paths start from
    document: Document = field(repr=False, compare=False)  # where each value was written

    def placed(self, error: SpecError) -> SpecError:
        """An error that planning raised, with the lines of the keys it names."""
        return SpecError(error.source, [self.document.placed(m) for m in error.mistakes])


def origin_of(document: Document, text: SourceText) -> dict[str, Any]:
    """The fields of `LoadedSpec`, by name."""
    return {
        "text": document.text,
        "sha256": hashlib.sha256(document.text.encode()).hexdigest(),
        "name": text.name,
        "source": text.shown,
        "directory": text.directory,
        "document": document,
    }
