"""From a spec file of any kind and overrides to its validated model, with all mistakes at once."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, TypeAlias

from climbplan.errors import SpecError
from climbplan.spec.document import Finding
from climbplan.spec.kinds import KINDS, find_kind
from climbplan.spec.overrides import Override, apply_overrides
from climbplan.spec.source import SourceText, read_source
from climbplan.spec.yaml_source import parse_yaml

if TYPE_CHECKING:
    from climbplan.spec.bookshelf.loading import LoadedShelf
    from climbplan.spec.climb.loading import LoadedClimb
    from climbplan.spec.climb.transition_loading import LoadedTransition
    from climbplan.spec.datasets.loading import LoadedDataset
    from climbplan.spec.fits.envelopes_loading import LoadedEnvelopes
    from climbplan.spec.fits.strategy_loading import LoadedStrategy
    from climbplan.spec.limms.loading import LoadedLimms
    from climbplan.spec.limms.module import ModuleSpec
    from climbplan.spec.program.loading import LoadedProgram
    from climbplan.spec.robots.source import AnyRobot
    from climbplan.spec.walking.loading import LoadedMpc

    AnyLoaded: TypeAlias = (
        LoadedClimb
        | LoadedDataset
        | LoadedEnvelopes
        | LoadedLimms
        | LoadedMpc
        | LoadedProgram
        | LoadedShelf
        | LoadedStrategy
        | LoadedTransition
        | ModuleSpec
        | AnyRobot
    )


def load_spec(source: str | Path, overrides: Sequence[str | Override] = ()) -> AnyLoaded:
    """Read, override and check a spec of any kind.

    Raises:
        SpecError: with every mistake in it.
    """
    return load_source(read_source(source), overrides)


def load_source(text: SourceText, overrides: Sequence[str | Override] = ()) -> AnyLoaded:
    """As `load_spec`, of a text that was read already."""
    document = apply_overrides(parse_yaml(text.text, text.shown), overrides)
    kind = find_kind(document)
    if isinstance(kind, Finding):
        raise SpecError(text.shown, document.mistakes([kind, *document.findings]))
    return KINDS[kind].read(document, text)
