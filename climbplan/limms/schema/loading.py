"""Loading of a LIMMS spec and its module file into validated models, with all mistakes at once."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from importlib.resources import files
from pathlib import Path
from typing import Any

from climbplan.errors import SpecError, SpecMistake
from climbplan.limms.schema.model import LimmsSpec
from climbplan.limms.schema.module import ModuleSpec
from climbplan.limms.schema.placing import find_placing_faults
from climbplan.schema.document import Document, Finding
from climbplan.schema.fields import find_closest_name
from climbplan.schema.kinds import validate, validate_kind
from climbplan.schema.loaded import LoadedSpec, describe_origin
from climbplan.schema.overrides import Override, apply_overrides
from climbplan.schema.source import SourceText, read_source
from climbplan.schema.yaml_source import parse_yaml


@dataclass(frozen=True, kw_only=True)
class LoadedLimms(LoadedSpec):
    """A LIMMS spec, its module, and the text it came from."""

    spec: LimmsSpec
    module: ModuleSpec
    module_text: str = ""  # text of a module file; empty for a built-in module


def load_limms(source: str | Path, overrides: Sequence[str | Override] = ()) -> LoadedLimms:
    """Read, override and check a LIMMS spec; `source` is a path or `-` for standard input.

    Raises:
        SpecError: with every mistake in spec, overrides and module file.
    """
    text = read_source(source)
    return limms_of(apply_overrides(parse_yaml(text.text, text.shown), overrides), text)


def limms_of(document: Document, text: SourceText) -> LoadedLimms:
    """Return the LIMMS spec of a document.

    Raises:
        SpecError: With every mistake in it and in the module file.
    """
    spec, findings = validate_kind(document, "limms", LimmsSpec)
    module, module_text, module_mistakes = _load_module(document, text.directory)
    if spec is not None and module is not None and not findings:
        findings += find_placing_faults(spec, module)
    mistakes = [*document.mistakes(findings), *module_mistakes]
    if spec is None or module is None or mistakes:
        raise SpecError(document.source, mistakes)
    return LoadedLimms(
        spec=spec, module=module, module_text=module_text, **describe_origin(document, text)
    )


@dataclass(frozen=True)
class StoredLimms:
    """A LIMMS spec stored in a plan."""

    loaded: LoadedLimms
    reason: str  # why the module is taken from the plan, empty if it is not


def stored_limms(text: str, module_text: str, module: Mapping[str, Any]) -> StoredLimms:
    """Return the spec of a plan with its module, built in or from the text in the plan.

    Args:
        text: The text of the spec.
        module_text: The text of the module file, empty without one.
        module: The module stored in the plan, used where neither source exists.

    Raises:
        SpecError: With every mistake in the texts.
    """
    document = parse_yaml(text, "spec")
    spec, findings = validate(document, LimmsSpec)
    if spec is None or findings:
        raise SpecError(document.source, document.mistakes(findings))
    reason = ""
    if _is_path(spec.robot):
        if module_text:
            stored_module = module_of(parse_yaml(module_text, f"module {spec.robot}"))
        else:
            stored_module = ModuleSpec.model_validate(module)
            reason = f"the plan does not carry {spec.robot}"
    elif spec.robot in list_builtin_modules():
        stored_module = load_builtin_module(spec.robot)
    else:
        stored_module = ModuleSpec.model_validate(module)
        reason = f"{spec.robot!r} is no built-in module"
    source = SourceText("spec", "spec", Path(), text)
    return StoredLimms(
        LoadedLimms(spec=spec, module=stored_module, **describe_origin(document, source)), reason
    )


def list_builtin_modules() -> list[str]:
    """Return the names of the modules in the package."""
    directory = files("climbplan").joinpath("robots", "modules")
    names = [entry.name for entry in directory.iterdir()]
    return sorted(name.removesuffix(".yaml") for name in names if name.endswith(".yaml"))


def module_of_text(document: Document, text: SourceText) -> ModuleSpec:
    """Return the module of a document, with the arguments that all readers of a kind take."""
    return module_of(document)


def module_of(document: Document) -> ModuleSpec:
    """Return the module that a document describes.

    Raises:
        SpecError: With every mistake in it.
    """
    module, findings = validate_kind(document, "module", ModuleSpec)
    if module is None or findings:
        raise SpecError(document.source, document.mistakes(findings))
    return module


def load_builtin_module(name: str) -> ModuleSpec:
    """Load a module of the package."""
    path = files("climbplan").joinpath("robots", "modules", f"{name}.yaml")
    return module_of(parse_yaml(path.read_text(encoding="utf-8"), f"module {name}"))


def _load_module(
    document: Document, directory: Path
) -> tuple[ModuleSpec | None, str, list[SpecMistake]]:
    """Return the module, the text of its file (empty if built in), and the mistakes in it."""
    reference = document.value.get("robot", "limms")
    if not isinstance(reference, str) or not reference:
        return None, "", []  # the model says what is wrong with it
    if not _is_path(reference):
        builtin = list_builtin_modules()
        if reference not in builtin:
            expected = (
                f"expected a built-in module ({', '.join(builtin)}) or the path of a module YAML "
                f"file, got {reference!r}"
            )
            finding = Finding(("robot",), expected, find_closest_name(reference, builtin))
            return None, "", [document.mistake(finding)]
        return load_builtin_module(reference), "", []
    try:
        source = read_source(directory / reference)
        return module_of(parse_yaml(source.text, source.shown)), source.text, []
    except SpecError as error:
        mistakes = [
            replace(m, source=m.source or error.source)
            if m.line
            else document.mistake(Finding(("robot",), f"{error.source}: {m.message}", m.suggestion))
            for m in error.mistakes
        ]
        return None, "", mistakes


def _is_path(reference: str) -> bool:
    return Path(reference).suffix in (".yaml", ".yml")
