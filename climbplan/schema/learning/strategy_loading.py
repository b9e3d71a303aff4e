"""From a strategy spec file and overrides to a validated model, with all mistakes at once."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from climbplan.errors import SpecError
from climbplan.schema.document import Document
from climbplan.schema.kinds import validate_kind
from climbplan.schema.learning.strategy import StrategySpec
from climbplan.schema.loaded import LoadedSpec, describe_origin, resolve_option_paths
from climbplan.schema.overrides import Override, apply_overrides
from climbplan.schema.source import SourceText, read_source
from climbplan.schema.yaml_source import parse_yaml


@dataclass(frozen=True, kw_only=True)
class LoadedStrategy(LoadedSpec):
    """A strategy spec and the text it came from; files it names are not opened yet."""

    spec: StrategySpec

    @property
    def files(self) -> tuple[Path, ...]:
        """The solved problems; a path that an option sets starts where you are."""
        return tuple(self.directory / name for name in self.spec.data.files)


def load_strategy(source: str | Path, overrides: Sequence[str | Override] = ()) -> LoadedStrategy:
    """Read, override and check a strategy spec.

    Args:
        source: Path of the spec, or `-` for standard input.
        overrides: Changes in order, as text `dotted.key=value` or as `Override`.

    Raises:
        SpecError: with every mistake in spec and overrides.
    """
    text = read_source(source)
    return build_strategy(apply_overrides(parse_yaml(text.text, text.shown), overrides), text)


def build_strategy(document: Document, text: SourceText) -> LoadedStrategy:
    """Return the strategy spec that a document describes.

    Raises:
        SpecError: with every mistake in it.
    """
    resolve_option_paths(document, [("data", "files")])
    spec, findings = validate_kind(document, "strategy", StrategySpec)
    if spec is None or findings:
        raise SpecError(document.source, document.mistakes(findings))
    return LoadedStrategy(spec=spec, **describe_origin(document, text))
