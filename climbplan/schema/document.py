"""A parsed spec whose every value knows where it was written."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field, replace
from typing import Any

from climbplan.errors import SpecMistake

KeyPath = tuple[str | int, ...]


def format_key_path(path: KeyPath) -> str:
    """Return a key path in the form that `--set` takes: `terrain.regions.0.friction`."""
    text = ".".join(str(segment) for segment in path)
    text = text if text.isprintable() else ascii(text)[1:-1]
    return text if len(text) <= 120 else text[:117] + "..."


@dataclass(frozen=True)
class Finding:
    """Something wrong at a key path, before it is known where that path was written."""

    path: KeyPath
    message: str
    suggestion: str | None = None
    option: str | None = None  # the command option at fault, where no value came of it


@dataclass
class Document:
    """Plain YAML data (mappings, lists, text, numbers) with the origin of each value."""

    source: str  # as shown in messages
    text: str
    value: Any
    lines: dict[KeyPath, int] = field(default_factory=dict)  # 1-based
    options: dict[KeyPath, str] = field(default_factory=dict)  # set by this command option
    findings: list[Finding] = field(default_factory=list)  # mistakes of the YAML itself
    renamed: list[tuple[str, KeyPath]] = field(default_factory=list)  # old key, path of the new
    renamed_values: list[tuple[KeyPath, str, str]] = field(default_factory=list)  # old, new value

    def mistake(self, finding: Finding) -> SpecMistake:
        """Return the finding with the line or the option that its value came from."""
        option, line = finding.option, None
        for length in range(len(finding.path), -1, -1):
            prefix = finding.path[:length]
            option = option or self.options.get(prefix)
            line = None if option else self.lines.get(prefix)
            if option or line:
                break
        source = option or self.source
        return SpecMistake(
            format_key_path(finding.path), finding.message, line, finding.suggestion, source
        )

    def locate(self, mistake: SpecMistake) -> SpecMistake:
        """Return a mistake found later, by its dotted key alone, with its line or option."""
        if mistake.line or mistake.source or not mistake.key:
            return mistake
        paths_by_key = {format_key_path(path): path for path in (*self.lines, *self.options)}
        key = mistake.key
        while key and key not in paths_by_key:
            key = key.rpartition(".")[0]
        located = self.mistake(
            Finding(paths_by_key.get(key, ()), mistake.message, mistake.suggestion)
        )
        return replace(located, key=mistake.key)

    def mistakes(self, findings: Iterable[Finding]) -> list[SpecMistake]:
        """Return all findings with their places, in the order of the file."""
        mistakes = [self.mistake(finding) for finding in findings]
        return sorted(mistakes, key=lambda m: (m.line is None, m.line or 0))
