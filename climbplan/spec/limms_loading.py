"""From a LIMMS spec and its module file to validated models, with all mistakes at once."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from importlib.resources import files
from pathlib import Path

from climbplan.errors import SpecError, SpecMistake
from climbplan.spec.document import Document, Finding
from climbplan.spec.fields import nearest
from climbplan.spec.kinds import find_kind, validate
from climbplan.spec.limms import LimmsSpec
from climbplan.spec.limms_module import ModuleSpec
from climbplan.spec.limms_placing import placing_findings
from climbplan.spec.loaded import LoadedSpec, origin_of
from climbplan.spec.overrides import Override, apply_overrides
from climbplan.spec.source import SourceText, read_source
from climbplan.spec.yaml_source import parse_yaml


@dataclass(frozen=True, kw_only=True)
class LoadedLimms(LoadedSpec):
    """A LIMMS spec, its module, and the text it came from."""

    spec: LimmsSpec
    module: ModuleSpec


def load_limms(source: str | Path, overrides: Sequence[str | Override] = ()) -> LoadedLimms:
    """Read, override and check a LIMMS spec; `source` is a path or `-` for standard input.

    Raises:
        SpecError: with every mistake in spec, overrides and module file.
    """
    text = read_source(source)
    return limms_of(apply_overrides(parse_yaml(text.text, text.shown), overrides), text)


def limms_of(document: Document, text: SourceText) -> LoadedLimms:
    """The LIMMS spec that a document is.

    Raises:
        SpecError: with every mistake in it and in the module file.
    """
    findings: list[Finding] = []
    kind = find_kind(document, wanted="limms")
    if isinstance(kind, Finding):
        findings.append(kind)
    spec, found = validate(document, LimmsSpec)
    findings += [f for f in found if f.path != ("kind",)]
    module, module_mistakes = _module(document, text.directory)
    if spec is not None and module is not None and not findings:
        findings += placing_findings(spec, module)
    mistakes = [*document.mistakes(findings), *module_mistakes]
    if spec is None or module is None or mistakes:
        raise SpecError(document.source, mistakes)
    return LoadedLimms(spec=spec, module=module, **origin_of(document, text))


def builtin_modules() -> list[str]:
    """Names of the modules that come with the package."""
    directory = files("climbplan").joinpath("robots", "modules")
    names = [entry.name for entry in directory.iterdir()]
    return sorted(name.removesuffix(".yaml") for name in names if name.endswith(".yaml"))


def module_of(document: Document) -> ModuleSpec:
    """The module that a document describes.

    Raises:
        SpecError: with every mistake in it.
    """
    findings: list[Finding] = []
    kind = find_kind(document, wanted="module")
    if isinstance(kind, Finding):
        findings.append(kind)
    module, found = validate(document, ModuleSpec)
    findings += [f for f in found if f.path != ("kind",)]
    if module is None or findings:
        raise SpecError(document.source, document.mistakes(findings))
    return module


def _module(document: Document, directory: Path) -> tuple[ModuleSpec | None, list[SpecMistake]]:
    reference = document.value.get("robot", "limms")
    if not isinstance(reference, str) or not reference:
        return None, []  # the model says what is wrong with it
    if Path(reference).suffix not in (".yaml", ".yml"):
        known = builtin_modules()
        if reference not in known:
            expected = (
                f"expected a built-in module ({', '.join(known)}) or the path of a module YAML "
                f"file, got {reference!r}"
            )
            finding = Finding(("robot",), expected, nearest(reference, known))
            return None, [document.mistake(finding)]
        path = files("climbplan").joinpath("robots", "modules", f"{reference}.yaml")
        return module_of(parse_yaml(path.read_text(encoding="utf-8"), f"module {reference}")), []
    try:
        source = read_source(directory / reference)
        return module_of(parse_yaml(source.text, source.shown)), []
    except SpecError as error:
        return None, [
            replace(m, source=m.source or error.source)
            if m.line
            else document.mistake(Finding(("robot",), f"{error.source}: {m.message}", m.suggestion))
            for m in error.mistakes
        ]
