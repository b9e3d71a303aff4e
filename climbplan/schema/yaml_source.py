"""YAML to plain data, with a line number for every value and every mistake found.

A safe loader composes nodes; the data is built from them here, so that no tag can run code,
no key is silently dropped, and aliases cannot blow up. Scalars follow YAML 1.2 (`1e-3` is a
number, `010` is ten, `1:30` and `2024-01-01` are text), which is what people expect to read.
"""

from __future__ import annotations

import copy
import re
import sys
from functools import lru_cache
from typing import Any

import yaml

from climbplan.errors import SpecError, SpecMistake
from climbplan.schema.document import Document, Finding, KeyPath
from climbplan.schema.renamed_keys import rename_keys, rename_methods

MOST_VALUES = 200_000  # after aliases and merges are expanded
DEEPEST = 64  # levels of nesting
LONGEST = 5_000_000  # characters
MOST_DIGITS = 400  # beyond, not even the number of digits is worth finding out
MOST_MISTAKES = 1000  # of the YAML itself, after which nobody reads on

_TAG = "tag:yaml.org,2002:"
_FLOAT = (
    r"[-+]?(?:\.[0-9]+|[0-9]+(?:\.[0-9]*)?)(?:[eE][-+]?[0-9]+)?"
    r"|[-+]?\.(?:inf|Inf|INF)|\.(?:nan|NaN|NAN)"
)
_SCALARS = (  # tag, first characters, pattern; the first that matches wins
    ("null", "~nN\0", r"~|null|Null|NULL|"),
    ("bool", "tTfF", r"true|True|TRUE|false|False|FALSE"),
    ("int", "-+0123456789", r"[-+]?[0-9]+|0o[0-7]+|0x[0-9a-fA-F]+"),
    ("float", "-+.0123456789", _FLOAT),
)
_PLAIN = {name: re.compile(pattern) for name, _, pattern in _SCALARS}
_CONTROL = re.compile(r"[^\t\n\x20-\x7e\x80-\ud7ff\ue000-\U0010ffff]")


def _build_resolvers() -> dict[str, list[tuple[str, re.Pattern[str]]]]:
    """Return the tables of `_SCALARS` in the form that PyYAML looks them up: by first character."""
    table: dict[str, list[tuple[str, re.Pattern[str]]]] = {}
    for name, first_characters, pattern in _SCALARS:
        for first in first_characters:
            rule = (_TAG + name, re.compile(rf"(?:{pattern})\Z"))
            table.setdefault(first.replace("\0", ""), []).append(rule)
    return table


class _TooMuch(yaml.YAMLError):
    def __init__(self, message: str, mark: yaml.Mark) -> None:
        self.message = message
        self.mark = mark


class _Composer(yaml.SafeLoader):
    """Composes nodes only, to a bounded size and depth."""

    yaml_implicit_resolvers = _build_resolvers()

    def __init__(self, text: str) -> None:
        super().__init__(text)
        self.depth = 0
        self.composed = 0

    def compose_node(self, parent: yaml.Node | None, index: Any) -> yaml.Node | None:
        self.depth += 1
        self.composed += 1
        if self.depth > DEEPEST or self.composed > MOST_VALUES:
            mark: yaml.Mark = self.peek_event().start_mark  # type: ignore[no-untyped-call]
            raise _report_depth(mark) if self.depth > DEEPEST else _report_count(mark)
        try:
            return super().compose_node(parent, index)
        finally:
            self.depth -= 1


class _YamlDumper(yaml.SafeDumper):
    """Writes what `_Composer` reads back unchanged."""

    yaml_implicit_resolvers = _build_resolvers()

    def ignore_aliases(self, data: Any) -> bool:
        return True


def parse_yaml(text: str, source: str) -> Document:
    """Parse one YAML document, and give old keys and methods their new names.

    Args:
        text: YAML text.
        source: File or option that it is from, as messages show it.

    Returns:
        The document. Mistakes that leave the rest readable (tags, double keys) are its `findings`;
        their values are None.

    Raises:
        SpecError: the text is not YAML, or too large or too deep.
    """
    if len(text) > LONGEST:
        message = f"too large: {len(text) / 1e6:.1f} million characters, expected {LONGEST / 1e6:g}"
        raise SpecError(source, [SpecMistake("", f"{message} at most")])
    return copy.deepcopy(_parse_known_text(text, source))


@lru_cache(maxsize=4)
def _parse_known_text(text: str, source: str) -> Document:
    """Parse YAML that is not too large; a plan's spec is parsed by many, and may hold a scan."""
    document = Document(source, text, None)
    line = None
    try:
        composer = _Composer(text)
        try:
            node = composer.get_single_node()
        finally:
            line = composer.line + 1
        if node is not None:
            document.lines[()] = node.start_mark.line + 1
            document.value = _Builder(document).value(node, ())
    except (yaml.YAMLError, ValueError, OverflowError) as error:
        # The last two escape from the scanner on escapes such as "\Uffffffff".
        raise SpecError(source, [_describe_syntax_mistake(error, text, line)]) from None
    rename_keys(document)
    rename_methods(document)
    return document


def write_yaml(value: Any) -> str:
    """Return YAML text that `parse_yaml` reads back as `value`; keys keep their order."""
    text: str = yaml.dump(
        value,
        Dumper=_YamlDumper,
        sort_keys=False,
        default_flow_style=None,
        allow_unicode=True,
        width=96,
    )
    return text


class _Builder:
    """Builds plain data from nodes and notes lines and mistakes in the document."""

    def __init__(self, document: Document) -> None:
        self.document = document
        self.count = 0

    def value(self, node: yaml.Node, path: KeyPath) -> Any:
        self._visit(node, len(path))
        kind = node.tag.removeprefix(_TAG)
        if isinstance(node, yaml.MappingNode) and kind == "map":
            return self._mapping(node, path)
        if isinstance(node, yaml.SequenceNode) and kind == "seq":
            items = []
            for i, item in enumerate(node.value):
                self._record_line((*path, i), item)
                items.append(self.value(item, (*path, i)))
            return items
        if isinstance(node, yaml.ScalarNode):
            return self._scalar(node, kind, path)
        self._find(path, f"the YAML tag {_format_tag(node)} is not allowed in a spec")
        return None

    def _visit(self, node: yaml.Node, depth: int, values: int = 1) -> None:
        self.count += values
        if self.count > MOST_VALUES:
            raise _report_count(node.start_mark)
        if depth > DEEPEST:
            raise _report_depth(node.start_mark)

    def _mapping(self, node: yaml.MappingNode, path: KeyPath) -> dict[str, Any]:
        result: dict[str, Any] = {}
        for key, (key_node, value_node) in self._entries(node, path, len(path)).items():
            self._record_line((*path, key), key_node)
            result[key] = self.value(value_node, (*path, key))
        return result

    def _entries(
        self, node: yaml.MappingNode, path: KeyPath, depth: int
    ) -> dict[str, tuple[yaml.Node, yaml.Node]]:
        """Return the entries of a mapping; `<<: *base` adds those it does not state itself."""
        self._visit(node, depth)
        entries: dict[str, tuple[yaml.Node, yaml.Node]] = {}
        bases: list[yaml.Node] = []
        for key_node, value_node in node.value:
            if not isinstance(key_node, yaml.ScalarNode):
                self._find(path, "a key must be plain text, not a list or mapping")
                continue
            key = key_node.value
            if key == "<<" and key_node.style is None:
                merged = isinstance(value_node, yaml.SequenceNode)
                bases += value_node.value if merged else [value_node]
            elif key in entries:
                first = entries[key][0].start_mark.line + 1
                again = key_node.start_mark.line + 1
                self._find((*path, key), f"appears twice, on lines {first} and {again}")
            else:
                entries[key] = (key_node, value_node)
        for base in bases:
            if isinstance(base, yaml.MappingNode):
                merged_entries = self._entries(base, path, depth + 1)
                # Each merge copies: a few lines could ask for billions of copies
                self._visit(base, depth, len(merged_entries))
                for key, entry in merged_entries.items():
                    entries.setdefault(key, entry)
            else:
                self._find(path, "`<<` expects an alias of a mapping, such as `<<: *base`")
        return entries

    def _scalar(self, node: yaml.ScalarNode, kind: str, path: KeyPath) -> Any:
        text: str = node.value
        if _CONTROL.search(text):
            self._find(path, "contains a control character")
            return None
        if kind in ("int", "float") and len(text) > MOST_DIGITS:
            self._find(path, f"a number of {len(text)} digits")
            return None
        try:
            match kind:
                case "str":
                    return text
                case "null":
                    _require(kind, text)
                    return None
                case "bool":
                    return {"true": True, "false": False}[text.lower()]
                case "int":
                    _require(kind, text)  # Python takes 1_000 and digits of other scripts
                    value = int(text, _detect_base(text))
                    if abs(value) <= sys.float_info.max:
                        return value
                    self._find(path, f"a number of {len(text)} digits, beyond what a double holds")
                    return None
                case "float":
                    _require("int" if _PLAIN["int"].fullmatch(text) else kind, text)
                    return float(text.lower().replace(".inf", "inf").replace(".nan", "nan"))
        except (ValueError, KeyError):
            self._find(path, f"{text[:40]!r} does not fit its YAML tag {_format_tag(node)}")
            return None
        self._find(path, f"the YAML tag {_format_tag(node)} is not allowed in a spec")
        return None

    def _record_line(self, path: KeyPath, node: yaml.Node) -> None:
        self.document.lines[path] = node.start_mark.line + 1

    def _find(self, path: KeyPath, message: str) -> None:
        if len(self.document.findings) < MOST_MISTAKES:
            self.document.findings.append(Finding(path, message))


def _require(kind: str, text: str) -> None:
    """Raise ValueError for a number of another form, which a tag such as `!!int` can name one."""
    if not _PLAIN[kind].fullmatch(text):
        raise ValueError(text)


def _detect_base(text: str) -> int:
    return {"0o": 8, "0x": 16}.get(text[:2], 10)


def _format_tag(node: yaml.Node) -> str:
    tag: str = node.tag
    return tag.replace(_TAG, "!!")[:80]


def _report_depth(mark: yaml.Mark) -> _TooMuch:
    return _TooMuch(f"nested deeper than {DEEPEST} levels", mark)


def _report_count(mark: yaml.Mark) -> _TooMuch:
    return _TooMuch(f"more than {MOST_VALUES} values once aliases are expanded", mark)


_HINTS = (
    ("found character '\\t'", "a tab in the indentation; use spaces"),
    ("mapping values are not allowed", "a ':' where none can stand; check the indentation"),
    ("could not find expected ':'", "a line without ':'; check the indentation"),
    ("expected <block end>", "the indentation does not match the lines above"),
    ("but found another document", "a second document starts; a spec is one document"),
    ("found undefined alias", "an alias without its anchor"),
    ("expected ',' or ']'", "a list is not closed by ']'"),
    ("expected ',' or '}'", "a mapping is not closed by '}'"),
    ("found unexpected end of stream", "a quote is not closed"),
)


def _describe_syntax_mistake(error: Exception, text: str, line: int | None) -> SpecMistake:
    if isinstance(error, _TooMuch):
        return SpecMistake("", error.message, error.mark.line + 1)
    if isinstance(error, yaml.MarkedYAMLError):
        mark = error.problem_mark or error.context_mark
        problem = error.problem or "unreadable"
        meaning = next((m for start, m in _HINTS if problem.startswith(start)), problem)
        return SpecMistake("", f"not valid YAML: {meaning}", mark.line + 1 if mark else None)
    if isinstance(error, yaml.reader.ReaderError):
        line = text.count("\n", 0, error.position) + 1
        return SpecMistake("", "not valid YAML: a control character", line)
    return SpecMistake("", "not valid YAML: an escape or a number out of range", line)
