"""From a spec file of any kind and overrides to its validated model, with all mistakes at once."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, cast

from climbplan.errors import SpecError
from climbplan.schema.document import Finding
from climbplan.schema.kinds import KINDS, find_kind
from climbplan.schema.overrides import Override, apply_overrides
from climbplan.schema.source import SourceText, read_source
from climbplan.schema.yaml_source import parse_yaml

if TYPE_CHECKING:
    from typing import TypeAlias

    from climbplan.schema.base import SpecModel
    from climbplan.schema.loaded import LoadedSpec
    from climbplan.schema.robots.source import AnyRobot

    AnyLoaded: TypeAlias = LoadedSpec | AnyRobot | SpecModel


def load_spec(source: str | Path, overrides: Sequence[str | Override] = ()) -> AnyLoaded:
    """Read, override and check a spec of any kind.

    Args:
        source: Path of the spec, or `-` for standard input.
        overrides: Changes in order, as text `dotted.key=value` or as `Override`.

    Raises:
        SpecError: with every mistake in it.
    """
    return load_source(read_source(source), overrides)


def load_source(text: SourceText, overrides: Sequence[str | Override] = ()) -> AnyLoaded:
    """Override and check a spec of any kind whose text was read already.

    Args:
        text: The text and where it comes from; paths in the spec start there.
        overrides: Changes in order, as text `dotted.key=value` or as `Override`.

    Raises:
        SpecError: with every mistake in it.
    """
    document = apply_overrides(parse_yaml(text.text, text.shown), overrides)
    kind = find_kind(document)
    if isinstance(kind, Finding):
        raise SpecError(text.shown, document.mistakes([kind, *document.findings]))
    return cast("AnyLoaded", KINDS[kind].read(document, text))
