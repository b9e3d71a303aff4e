"""From a spec of kind `program` and overrides to its model."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from climbplan.errors import SpecError
from climbplan.schema.document import Document
from climbplan.schema.kinds import validate_kind
from climbplan.schema.loaded import LoadedSpec, describe_origin, resolve_option_paths
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
        reference = self.spec.solver.library
        if reference is None:
            return None
        is_set_by_option = ("solver", "library") in self.document.options
        return Path(reference) if is_set_by_option else self.directory / reference

    @property
    def model(self) -> Path | None:
        """The trained strategy; set by an option, it starts where you are."""
        reference = self.spec.solver.model
        return None if reference is None else self.directory / reference.file


def load_program(source: str | Path, overrides: Sequence[str | Override] = ()) -> LoadedProgram:
    """Read, override and check a program spec.

    Args:
        source: Path of the spec, or `-` for standard input.
        overrides: Changes in order, as text `dotted.key=value` or as `Override`.

    Raises:
        SpecError: with every mistake in spec and overrides.
    """
    text = read_source(source)
    return build_program(apply_overrides(parse_yaml(text.text, text.shown), overrides), text)


def build_program(document: Document, text: SourceText) -> LoadedProgram:
    """Return the program spec that a document describes.

    Args:
        document: A parsed spec with its overrides applied.
        text: Where the document comes from; paths in it start there.

    Raises:
        SpecError: with every mistake in it.
    """
    resolve_option_paths(document, [("solver", "model", "file")])
    spec, findings = validate_kind(document, "program", ProgramSpec)
    if spec is None or findings:
        raise SpecError(document.source, document.mistakes(findings))
    return LoadedProgram(spec=spec, **describe_origin(document, text))
