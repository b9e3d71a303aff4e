"""URDFs that were not made yet: what xacro would still expand, and the command that does it."""

from __future__ import annotations

import re
import shlex
from pathlib import Path

from climbplan.schema.robots.xml import Element, UrdfFault

_NAMESPACE = re.compile(r"https?://(www\.)?(wiki\.)?ros\.org/(wiki/)?xacro/?")
_TO_EXPAND = re.compile(r"\$[{(]")
_ENDINGS = (".xacro", ".urdf", ".xml")


def refuse_xacro(root: Element, path: Path) -> None:
    """Raise UrdfFault where an element or a `${...}` is left for xacro.

    A file that only names xacro's namespace, as what xacro writes does, has nothing left.
    """
    prefixes = {"xacro"} | {
        name.removeprefix("xmlns:")
        for element in root.walk()
        for name, value in element.attributes.items()
        if name.startswith("xmlns:") and _NAMESPACE.fullmatch(value.strip())
    }
    for element in root.walk():
        prefix, colon, _ = element.tag.partition(":")
        if colon and prefix in prefixes:
            raise _not_made(f"<{element.tag}>", element, path)
    # Parts of other programs (<gazebo>, <transmission>) may hold a `$(...)` of their own
    for part in (root, *(c for c in root.children if c.tag in ("link", "joint"))):
        for element in [root] if part is root else part.walk():
            for value in element.attributes.values():
                if _TO_EXPAND.search(value):
                    raise _not_made(repr(value[:40]), element, path)


def _not_made(what: str, element: Element, path: Path) -> UrdfFault:
    made = _free_name(path)
    command = f"xacro {shlex.quote(str(path))} > {shlex.quote(str(made))}"
    return UrdfFault(
        f"{what} is left for xacro to expand; make the URDF with `{command}` and name that",
        element.line,
    )


def _free_name(path: Path) -> Path:
    """Where to write the URDF to: never over the file itself nor over another one."""
    stem = path.name
    while stem.endswith(_ENDINGS) and Path(stem).stem:
        stem = Path(stem).stem
    names = [f"{stem}.urdf", f"{stem}_expanded.urdf"]
    names += [f"{stem}_expanded_{number}.urdf" for number in range(2, 100)]
    taken = path.name.lower()
    free = (path.with_name(name) for name in names if name.lower() != taken)
    return next((other for other in free if not other.exists()), path.with_name(names[-1]))
