"""XML as elements that know their lines, and their attributes as numbers.

Nothing is run, no entity is expanded and no other file is opened.
"""

from __future__ import annotations

import math
import xml.parsers.expat
from dataclasses import dataclass, field

from climbplan.errors import ClimbplanError

_DEEPEST = 200


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
        """The first child of a name."""
        return next((c for c in self.children if c.tag == tag), None)

    def all(self, tag: str) -> list[Element]:
        """All children of a name."""
        return [c for c in self.children if c.tag == tag]


def parsed(content: bytes) -> Element:
    """The root element; raises UrdfFault for what is not XML."""
    parser = xml.parsers.expat.ParserCreate()
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
        parser.Parse(content, True)
    except xml.parsers.expat.ExpatError as error:
        reason = xml.parsers.expat.ErrorString(error.code)
        raise UrdfFault(f"not XML: {reason}", error.lineno) from error
    return roots[0]


def text_of(element: Element, name: str) -> str:
    """An attribute that has to be there."""
    value = element.attributes.get(name, "")
    if not value:
        raise UrdfFault(f"<{element.tag}> without `{name}`", element.line)
    return value


def number_of(element: Element | None, name: str) -> float | None:
    """A finite number, None where the element or attribute is missing."""
    if element is None or name not in element.attributes:
        return None
    text = element.attributes[name]
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise UrdfFault(
            f"`{name}` of <{element.tag}>: expected a number, got {text[:40]!r}", element.line
        )
    return value


def vector_of(element: Element, name: str) -> tuple[float, float, float] | None:
    """Three finite numbers, None where the attribute is missing."""
    if name not in element.attributes:
        return None
    text = element.attributes[name]
    try:
        x, y, z = (float(part) for part in text.split())
    except ValueError:
        x = y = z = math.nan
    if not (math.isfinite(x) and math.isfinite(y) and math.isfinite(z)):
        raise UrdfFault(
            f"`{name}` of <{element.tag}>: expected three numbers, got {text[:40]!r}", element.line
        )
    return x, y, z
