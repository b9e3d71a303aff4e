"""From a spec of kind `program` and overrides to its model."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from climbplan.errors import SpecError
from climbplan.schema.document import Document
from climbplan.schema.kinds import validate_kind
from climbplan.schema.loaded import LoadedSpec, origin_of, root_paths
from climbplan.schema.overrides import Override, apply_overrides
from climbplan.schema.program.model import ProgramSpec
from climbplan.schema.source import SourceText, read_source
from climbplan.schema.yaml_source import parse_yaml


@dataclass(frozen=True, kw_only=True)
class LoadedProgram(LoadedSpec):
    """A program spec and the text it came from."""

    spec: ProgramSpec

    @property
    def library(self) -> Path | None:
        """The plan file that candidates come from; set by an option, it starts where you are."""
        given = self.spec.solver.library
        if given is None:
            return None
        here = ("solver", "library") in self.document.options
        return Path(given) if here else self.directory / given

    @property
    def model(self) -> Path | None:
        """The trained strategy; set by an option, it starts where you are."""
        given = self.spec.solver.model
        return None if given is None else self.directory / given.file


def load_program(source: str | Path, overrides: Sequence[str | Override] = ()) -> LoadedProgram:
    """Read, override and check a program spec; `source` is a path or `-` for standard input.

    Raises:
        SpecError: with every mistake in spec and overrides.
    """
    text = read_source(source)
    return program_of(apply_overrides(parse_yaml(text.text, text.shown), overrides), text)


def program_of(document: Document, text: SourceText) -> LoadedProgram:
    """The program spec that a document describes.

    Raises:
        SpecError: with every mistake in it.
    """
    root_paths(document, [("solver", "model", "file")])
    spec, findings = validate_kind(document, "program", ProgramSpec)
    if spec is None or findings:
        raise SpecError(document.source, document.mistakes(findings))
    return LoadedProgram(spec=spec, **origin_of(document, text))
