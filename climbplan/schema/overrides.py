"""Values set on the command line: `--set dotted.key=value` and the options that stand for one."""

from __future__ import annotations

import copy
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Literal, Self

from climbplan.errors import SpecError, SpecMistake
from climbplan.schema.document import Document, Finding, KeyPath, format_key_path
from climbplan.schema.renamed_keys import (
    rename_methods,
    renamed_override,
    warn_of_renamed,
)
from climbplan.schema.wording import format_value
from climbplan.schema.yaml_source import DEEPEST, parse_yaml, write_yaml


@dataclass(frozen=True)
class Override:
    """One value that replaces what the file says."""

    key: str  # dotted, list indices as numbers
    value: str  # YAML
    option: str  # as in messages: "--set task.rounds=3", "--seed 4"
    bound: Literal["least", "most"] | None = None  # a number beyond it in the file stays
    data: Any = None  # plain data that is taken as it is, instead of YAML; None: there is none

    @classmethod
    def of(cls, key: str, data: Any, option: str) -> Self:
        """Return an override by a value that the program found, which is not parsed as YAML.

        Args:
            key: Dotted key, list indices as numbers.
            data: Plain data (mappings, lists, text, numbers).
            option: The change as messages show it, such as "--seed 4".
        """
        return cls(key, "", option, data=data)

    @classmethod
    def parse(cls, text: str) -> Self:
        """Parse an argument of `--set`, such as `task.rounds=3`.

        Raises:
            SpecError: there is no `=`, or a part of the key is empty.
        """
        option = f"--set {text if len(text) <= 60 else text[:57] + '...'}"
        key, equals, value = text.partition("=")
        if not equals:
            raise _build_error(option, "expected dotted.key=value, such as task.rounds=6")
        if not all(key.strip().split(".")):
            raise _build_error(option, "expected a key such as task.rounds before the `=`")
        if key.count(".") >= DEEPEST:
            raise _build_error(option, f"a key has at most {DEEPEST} parts")
        return cls(key.strip(), value, option)


def apply_overrides(document: Document, overrides: Sequence[str | Override]) -> Document:
    """Return a document with the overrides applied in order and its text written anew.

    Missing mappings on the way are created; which keys are allowed is left to the model.

    Args:
        document: A parsed spec, which stays as it is.
        overrides: Text `dotted.key=value` or `Override`. One that is malformed, or leads through a
            value that has no keys, becomes a finding.

    Returns:
        The changed document; without overrides the same document, text untouched.
    """
    if not overrides:
        warn_of_renamed(document)
        return document
    result = copy.deepcopy(document)
    for override in overrides:
        try:
            _apply(result, Override.parse(override) if isinstance(override, str) else override)
        except SpecError as error:
            result.findings += [
                Finding((), m.message, m.suggestion, option=error.source) for m in error.mistakes
            ]
    result.text = write_yaml(result.value)
    warn_of_renamed(result)
    return result


def _apply(document: Document, override: Override) -> None:
    if override.data is None:
        parsed = parse_yaml(override.value, override.option)
    else:
        parsed = Document(override.option, "", copy.deepcopy(override.data))
    key = renamed_override(document, override.key)
    segments = key.split(".")
    holder: Any = document.value
    path: KeyPath = ()
    if key != override.key:
        document.renamed.append((override.key, tuple(segments)))
    for i, segment in enumerate(segments):
        slot = _resolve_segment(holder, path, segment, override)
        path = (*path, slot)
        if i == len(segments) - 1:
            if isinstance(holder, dict) and _satisfies_bound(
                holder.get(slot), parsed.value, override.bound
            ):
                return
            _forget(document, path)
            holder[slot] = parsed.value
            document.options[path] = override.option
            rename_methods(document)
        else:
            if isinstance(holder, dict) and holder.get(str(slot)) is None:
                holder[slot] = {}
                document.options[path] = override.option
            holder = holder[slot]
    document.findings += [
        Finding((*path, *f.path), f.message, f.suggestion) for f in parsed.findings
    ]


def _resolve_segment(holder: Any, path: KeyPath, segment: str, override: Override) -> str | int:
    """Return the key or index in `holder` that `segment` stands for."""
    if isinstance(holder, dict):
        return segment
    if isinstance(holder, list):
        if segment.isdecimal() and int(segment[:9]) < len(holder):
            return int(segment)
        entries = f"0 to {len(holder) - 1}" if holder else "none, it is empty"
        raise _build_error(
            override.option,
            f"{segment!r} is not an entry of the list `{format_key_path(path)}` ({entries})",
        )
    place = (
        f"`{format_key_path(path)}` is {format_value(holder)}"
        if path
        else f"the spec is {format_value(holder)}"
    )
    raise _build_error(override.option, f"{place}, it has no key {segment!r}")


def _satisfies_bound(file_value: Any, limit: Any, bound: Literal["least", "most"] | None) -> bool:
    """Return whether the file's own value already goes further than an override that is a bound."""
    if bound is None or isinstance(file_value, bool) or not isinstance(file_value, int | float):
        return False
    return bool(file_value >= limit if bound == "least" else file_value <= limit)


def _forget(document: Document, path: KeyPath) -> None:
    """Drop what the file said at `path` and below: lines, earlier options, mistakes."""
    depth = len(path)
    document.lines = {p: n for p, n in document.lines.items() if p[:depth] != path}
    document.options = {p: o for p, o in document.options.items() if p[:depth] != path}
    document.findings = [f for f in document.findings if f.path[:depth] != path]
    document.renamed_values = [r for r in document.renamed_values if r[0][:depth] != path]


def _build_error(option: str, message: str) -> SpecError:
    return SpecError(option, [SpecMistake("", message)])
