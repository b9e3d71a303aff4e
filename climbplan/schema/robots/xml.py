"""XML as elements that know their lines, and their attributes as numbers.

Nothing is run, no entity is expanded and no other file is opened.
"""

from __future__ import annotations

import math
import re
import xml.parsers.expat
from collections.abc import Iterator
from dataclasses import dataclass, field

from climbplan.errors import ClimbplanError

_DEEPEST = 200
_SPACE = " \t\r\n"  # of XML; Python's own `strip` takes many more
# xs:double of XML Schema, without INF and NaN. Python's `float` also takes 1_0 and digits of other
# scripts, Pinocchio's reader takes no space behind a number.
_NUMBER = re.compile(r"[-+]?(?:[0-9]+(?:\.[0-9]*)?|\.[0-9]+)(?:[eE][-+]?[0-9]+)?")


class UrdfFault(ClimbplanError):
    """A text that is no URDF; `line` is where, None for the whole."""

    def __init__(self, message: str, line: int | None = None) -> None:
        self.message = message
        self.line = line
        super().__init__(message)


class UrdfFaults(ClimbplanError):
    """All that is wrong in a URDF."""

    def __init__(self, faults: list[UrdfFault]) -> None:
        self.faults = faults
        super().__init__("\n".join(fault.message for fault in faults))


@dataclass
class Element:
    """One element."""

    tag: str
    attributes: dict[str, str]
    line: int
    children: list[Element] = field(default_factory=list)

    def first(self, tag: str) -> Element | None:
        """Return the first child of a name."""
        return next((c for c in self.children if c.tag == tag), None)

    def all(self, tag: str) -> list[Element]:
        """Return all children of a name."""
        return [c for c in self.children if c.tag == tag]

    def walk(self) -> Iterator[Element]:
        """Yield the element itself and all below it, in the order of the text."""
        yield self
        for child in self.children:
            yield from child.walk()


def parse_xml(text: str) -> Element:
    """Return the root element; raises UrdfFault for what is not XML."""
    parser = xml.parsers.expat.ParserCreate("utf-8")  # whatever the text declares: it is decoded
    stack: list[Element] = []
    roots: list[Element] = []

    def start(tag: str, attributes: dict[str, str]) -> None:
        element = Element(tag, attributes, parser.CurrentLineNumber)
        if len(stack) >= _DEEPEST:
            raise UrdfFault(f"elements nested more than {_DEEPEST} deep", element.line)
        (stack[-1].children if stack else roots).append(element)
        stack.append(element)

    def end(tag: str) -> None:
        stack.pop()

    def entity(*_: object) -> None:
        raise UrdfFault("declares XML entities, which a URDF has no need of")

    parser.StartElementHandler = start
    parser.EndElementHandler = end
    parser.EntityDeclHandler = entity
    try:
        parser.Parse(text.encode(), True)
    except xml.parsers.expat.ExpatError as error:
        reason = xml.parsers.expat.ErrorString(error.code)
        raise UrdfFault(f"not XML: {reason}", error.lineno) from error
    return roots[0]


def read_text_attribute(element: Element, name: str) -> str:
    """Return an attribute that has to be there."""
    value = element.attributes.get(name, "")
    if not value:
        raise UrdfFault(f"<{element.tag}> without `{name}`", element.line)
    return value


def read_number_attribute(element: Element | None, name: str) -> float | None:
    """Return a finite number, None where the element or attribute is missing."""
    if element is None or name not in element.attributes:
        return None
    return _parse_numbers(element, name, 1, "a number")[0]


def read_vector_attribute(element: Element, name: str) -> tuple[float, float, float] | None:
    """Return three finite numbers, None where the attribute is missing."""
    if name not in element.attributes:
        return None
    x, y, z = _parse_numbers(element, name, 3, "three numbers")
    return x, y, z


def _parse_numbers(element: Element, name: str, count: int, expected: str) -> list[float]:
    """Return the numbers of an attribute as XML Schema reads them, white space ignored."""
    text = element.attributes[name]
    tokens = [token for token in re.split(f"[{_SPACE}]+", text.strip(_SPACE)) if token]
    values = [float(token) if _NUMBER.fullmatch(token) else math.nan for token in tokens]
    if len(values) != count or not all(math.isfinite(value) for value in values):
        raise UrdfFault(
            f"`{name}` of <{element.tag}>: expected {expected}, got {text[:40]!r}", element.line
        )
    return values
