"""Compile an MJCF file with MuJoCo, which resolves defaults, included files and masses of shapes.

MuJoCo is an optional part (`pip install 'climbplan[simulate]'`), imported only for such a file.
"""

from __future__ import annotations

import importlib
import re
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from climbplan.errors import MissingSolver
from climbplan.schema.robots.xml import Element, UrdfFault

_LINE = re.compile(r"line (\d+)")
_NEEDED = "an MJCF file needs MuJoCo, which is not installed: pip install 'climbplan[simulate]'"


@dataclass(frozen=True)
class Mjcf:
    """A compiled model, and what it was compiled from."""

    library: Any
    spec: Any
    model: Any
    robot: int  # the body below the world that carries the joints
    lines: dict[tuple[str, str], int]  # of elements, by tag and name

    def line(self, tag: str, name: str) -> int:
        """Return the line of an element, the first line for one without a name or included."""
        return self.lines.get((tag, name), 1)


def compile_mjcf(path: Path, root: Element) -> Mjcf:
    """Return the robot of an MJCF file, whose own elements are below `root`.

    Raises MissingSolver without MuJoCo, UrdfFault for what MuJoCo refuses, for several robots or
    none, and for chains that its equalities close.
    """
    try:
        library = importlib.import_module("mujoco")
    except ImportError as error:
        raise MissingSolver(_NEEDED) from error
    try:
        spec = library.MjSpec.from_file(str(path))
        model = spec.compile()
    except (ValueError, RuntimeError, library.FatalError) as error:
        reason = " ".join(str(error).split())
        raise UrdfFault(f"MuJoCo cannot read it: {reason}", _find_line(reason)) from error
    lines = {
        (element.tag, element.attributes["name"]): element.line
        for element in root.walk()
        if "name" in element.attributes
    }
    _refuse_closed(library, spec, root)
    return Mjcf(library, spec, model, _find_robot(library, model), lines)


def _find_robot(library: Any, model: Any) -> int:
    """Return the one body below the world with joints, beside a free one, in it or below."""
    free = library.mjtJoint.mjJNT_FREE
    roots = {
        int(model.body_rootid[model.jnt_bodyid[joint]])
        for joint in range(model.njnt)
        if model.jnt_type[joint] != free
    }
    if len(roots) == 1:
        return roots.pop()
    names = ", ".join(repr(model.body(body).name) for body in sorted(roots)) or "none"
    raise UrdfFault(f"expected one body below <worldbody> that carries joints, got {names}")


def _refuse_closed(library: Any, spec: Any, root: Element) -> None:
    kinds = {library.mjtEq.mjEQ_CONNECT: "connect", library.mjtEq.mjEQ_WELD: "weld"}
    for equality in spec.equalities:
        kind = kinds.get(equality.type)
        if kind is not None and equality.active:
            ends = " and ".join(repr(n) for n in (equality.name1, equality.name2) if n)
            lines = [e.line for e in root.walk() if e.tag == kind]
            message = f"closed chain: <{kind}> of {ends}; expected a tree"
            raise UrdfFault(message, lines[0] if len(lines) == 1 else None)


def _find_line(text: str) -> int | None:
    match = _LINE.search(text)
    return int(match[1]) if match else None
