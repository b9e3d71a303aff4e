"""The kinds of spec that exist, the model of each, and which kind a document is."""

from __future__ import annotations

from typing import TypeVar

from pydantic import ValidationError

from climbplan.errors import SpecError
from climbplan.spec.base import SpecModel
from climbplan.spec.bookshelf.model import BookshelfSpec
from climbplan.spec.climb.model import ClimbSpec
from climbplan.spec.climb.transition import TransitionSpec
from climbplan.spec.datasets.model import DatasetSpec
from climbplan.spec.document import Document, Finding
from climbplan.spec.fields import nearest
from climbplan.spec.fits.envelopes import EnvelopesSpec
from climbplan.spec.fits.strategy import StrategySpec
from climbplan.spec.limms.model import LimmsSpec
from climbplan.spec.limms.module import ModuleSpec
from climbplan.spec.program.model import ProgramSpec
from climbplan.spec.robots.robot import RobotSpec
from climbplan.spec.walking.model import MpcSpec
from climbplan.spec.wording import findings_of, shown

KINDS: dict[str, type[SpecModel]] = {
    "climb": ClimbSpec,
    "transition": TransitionSpec,
    "mpc": MpcSpec,
    "bookshelf": BookshelfSpec,
    "envelopes": EnvelopesSpec,
    "program": ProgramSpec,
    "dataset": DatasetSpec,
    "strategy": StrategySpec,
    "limms": LimmsSpec,
    "robot": RobotSpec,
    "module": ModuleSpec,
}

Model = TypeVar("Model", bound=SpecModel)


def find_kind(document: Document, wanted: str | None = None) -> str | Finding:
    """The kind of a document, or what is wrong with its `kind`.

    Raises:
        SpecError: it is not a mapping at all, or a spec of another kind than `wanted`; what else
            it holds need not be looked at then.
    """
    known = ", ".join(f"`{kind}`" for kind in KINDS)
    example = f"kind: {wanted or 'climb'}"
    if not isinstance(document.value, dict):
        expected = f"expected keys and values, the first `{example}`, got {shown(document.value)}"
        raise SpecError(document.source, [document.mistake(Finding((), expected))])
    if "kind" not in document.value:
        return Finding(("kind",), f"missing, expected `{example}` (known kinds: {known})")
    kind = document.value["kind"]
    if not isinstance(kind, str) or kind not in KINDS:
        near = nearest(kind, list(KINDS)) if isinstance(kind, str) else None
        return Finding(("kind",), f"expected one of {known}, got {shown(kind)}", near)
    if wanted is not None and kind != wanted:
        message = f"expected a spec of kind `{wanted}`, got a `{kind}`"
        raise SpecError(document.source, [document.mistake(Finding(("kind",), message))])
    return kind


def validate(document: Document, model: type[Model]) -> tuple[Model | None, list[Finding]]:
    """The document as `model`, or every mistake in it (those of its YAML included)."""
    findings = list(document.findings)
    broken = [f.path for f in findings if f.option is None]
    result = None
    try:
        result = model.model_validate(document.value)
    except ValidationError as error:
        # A value that the YAML reader refused was left empty: not a second mistake.
        findings += [
            f
            for f in findings_of(error, model)
            if not any(f.path[: len(path)] == path for path in broken)
        ]
    return (None if findings else result), findings


def validate_kind(
    document: Document, kind: str, model: type[Model]
) -> tuple[Model | None, list[Finding]]:
    """As `validate`, of a document that has to be of a kind.

    Raises:
        SpecError: as `find_kind`.
    """
    found = find_kind(document, wanted=kind)
    wrong = [found] if isinstance(found, Finding) else []
    spec, findings = validate(document, model)
    return spec, [*wrong, *(finding for finding in findings if finding.path != ("kind",))]
