"""The kinds of spec that exist, the model of each, and which kind a document is."""

from __future__ import annotations

from dataclasses import dataclass
from pkgutil import resolve_name
from typing import TYPE_CHECKING, TypeVar, cast

from pydantic import ValidationError

from climbplan.errors import SpecError
from climbplan.schema.base import SpecModel
from climbplan.schema.document import Document, Finding
from climbplan.schema.fields import find_closest_name
from climbplan.schema.wording import collect_findings, format_value

if TYPE_CHECKING:
    from climbplan.schema.source import SourceText


@dataclass(frozen=True)
class SpecKind:
    """The model and the reader of one kind of spec, by name: they are imported when first used."""

    model_name: str  # MODULE:CLASS
    reader_name: str  # MODULE:FUNCTION, called with a document and its source text

    @property
    def model(self) -> type[SpecModel]:
        """The pydantic model."""
        return cast("type[SpecModel]", resolve_name(self.model_name))

    def read(self, document: Document, text: SourceText) -> object:
        """Return the validated spec.

        Raises:
            SpecError: with every mistake in it.
        """
        read: object = resolve_name(self.reader_name)(document, text)
        return read


def _build_kind(package: str, model: str, reader: str) -> SpecKind:
    return SpecKind(f"climbplan.{package}.{model}", f"climbplan.{package}.{reader}")


_CLIMB, _WALKING = "climb.schema", "walking.schema"
_SHELF, _LIMMS = "bookshelf.schema", "limms.schema"
KINDS = {
    "climb": _build_kind(_CLIMB, "model:ClimbSpec", "loading:build_climb"),
    "transition": _build_kind(
        _CLIMB, "transition:TransitionSpec", "transition_loading:build_transition"
    ),
    "mpc": _build_kind(_WALKING, "model:MpcSpec", "loading:validate_mpc"),
    "bookshelf": _build_kind(_SHELF, "model:BookshelfSpec", "loading:shelf_of_document"),
    "envelopes": _build_kind(
        _CLIMB, "envelopes:EnvelopesSpec", "envelopes_loading:build_envelopes"
    ),
    "program": _build_kind("schema.program", "model:ProgramSpec", "loading:build_program"),
    "dataset": _build_kind("datasets.schema", "model:DatasetSpec", "loading:build_dataset_spec"),
    "strategy": _build_kind(
        "schema.learning", "strategy:StrategySpec", "strategy_loading:build_strategy"
    ),
    "limms": _build_kind(_LIMMS, "model:LimmsSpec", "loading:limms_of"),
    "robot": _build_kind("schema.robots", "robot:RobotSpec", "source:build_robot_from_text"),
    "module": _build_kind(_LIMMS, "module:ModuleSpec", "loading:module_of_text"),
}

Model = TypeVar("Model", bound=SpecModel)


def find_kind(document: Document, expected_kind: str | None = None) -> str | Finding:
    """Return the kind of a document, or what is wrong with its `kind`.

    Args:
        document: A parsed spec.
        expected_kind: The kind that is required; None accepts every kind.

    Raises:
        SpecError: it is not a mapping at all, or a spec of another kind than `expected_kind`; the
            rest of it need not be checked then.
    """
    kind_names = ", ".join(f"`{kind}`" for kind in KINDS)
    example = f"kind: {expected_kind or 'climb'}"
    if not isinstance(document.value, dict):
        expected = (
            f"expected keys and values, the first `{example}`, got {format_value(document.value)}"
        )
        raise SpecError(document.source, [document.mistake(Finding((), expected))])
    if "kind" not in document.value:
        return Finding(("kind",), f"missing, expected `{example}` (known kinds: {kind_names})")
    kind = document.value["kind"]
    if not isinstance(kind, str) or kind not in KINDS:
        closest = find_closest_name(kind, list(KINDS)) if isinstance(kind, str) else None
        return Finding(
            ("kind",), f"expected one of {kind_names}, got {format_value(kind)}", closest
        )
    if expected_kind is not None and kind != expected_kind:
        message = (
            f"expected a spec of kind `{expected_kind}`, got a `{kind}`; `climbplan new "
            f"{expected_kind}` writes an example"
        )
        raise SpecError(document.source, [document.mistake(Finding(("kind",), message))])
    return kind


def validate(document: Document, model: type[Model]) -> tuple[Model | None, list[Finding]]:
    """Validate a document as `model`.

    Args:
        document: A parsed spec.
        model: Model of its kind.

    Returns:
        The model, None if anything is wrong; and every mistake, those of the YAML included.
    """
    findings = list(document.findings)
    broken = [f.path for f in findings if f.option is None]
    result = None
    try:
        result = model.model_validate(document.value)
    except ValidationError as error:
        # A value that the YAML reader refused was left empty: not a second mistake.
        findings += [
            f
            for f in collect_findings(error, model)
            if not any(f.path[: len(path)] == path for path in broken)
        ]
    return (None if findings else result), findings


def validate_kind(
    document: Document, kind: str, model: type[Model]
) -> tuple[Model | None, list[Finding]]:
    """Validate a document as `model`, and require its kind.

    Args:
        document: A parsed spec.
        kind: The kind that it has to have.
        model: Model of that kind.

    Returns:
        The model, None if anything is wrong; and every mistake, those of the YAML included.

    Raises:
        SpecError: the document is not a mapping, or a spec of another kind.
    """
    kind_or_finding = find_kind(document, expected_kind=kind)
    kind_findings = [kind_or_finding] if isinstance(kind_or_finding, Finding) else []
    spec, findings = validate(document, model)
    return spec, [*kind_findings, *(finding for finding in findings if finding.path != ("kind",))]
