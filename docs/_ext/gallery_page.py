"""The gallery: every shipped spec of a kind that is planned, with picture and command."""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path

COMMANDS = {
    "climb": "plan-climb",
    "transition": "plan-transition",
    "mpc": "plan-mpc",
    "limms": "plan-limms",
    "bookshelf": "solve-bookshelf",
}
HEADINGS = {
    "climb": "Climbing",
    "transition": "Transitions and missions",
    "mpc": "Walking",
    "limms": "Modules",
    "bookshelf": "Bookshelf",
}


@dataclass(frozen=True)
class Scene:
    """A shipped spec as the gallery shows it."""

    name: str
    kind: str
    about: str  # its title comment, up to the first empty line

    @property
    def command(self) -> str:
        """What plans it."""
        return f"climbplan {COMMANDS[self.kind]} specs/{self.name}.yaml"


def scenes(specs: Path) -> list[Scene]:
    """All specs of kinds with a plan, by kind and name."""
    found = []
    for path in sorted(specs.glob("*.yaml")):
        text = path.read_text(encoding="utf-8")
        kind = re.search(r"^kind: *(\w+)", text, re.MULTILINE)
        if kind is not None and kind[1] in COMMANDS:
            found.append(Scene(path.stem, kind[1], _about(text)))
    return sorted(found, key=lambda scene: list(COMMANDS).index(scene.kind))


def gallery_page(specs: Path, pictures: Path) -> str:
    """The page; a scene without a picture raises FileNotFoundError."""
    lines = [
        "# Gallery",
        "",
        "Every shipped spec that is planned, with its title comment and a figure of its report.",
        "`python docs/make_gallery.py` makes the pictures. The [list of scenes](guides/specs.md)",
        "says how each plan ends in simulation.",
        "",
    ]
    kind = ""
    for scene in scenes(specs):
        if scene.kind != kind:
            kind = scene.kind
            lines += [f"## {HEADINGS[kind]}", ""]
        picture = pictures / f"{scene.name}.png"
        if not picture.exists():
            raise FileNotFoundError(f"{picture}: `python docs/make_gallery.py {scene.name}`")
        lines += [f"### {scene.name}", "", scene.about, ""]
        lines += ["```sh", scene.command, "```", ""]
        lines += [f"![{scene.name}](../gallery/{picture.name})", ""]
    return "\n".join(lines)


def _about(text: str) -> str:
    """The first paragraph of a spec's leading comment."""
    lines = []
    for line in text.splitlines():
        words = line.removeprefix("#").strip()
        if not line.startswith("#") or not words:
            break
        lines.append(words)
    return " ".join(lines)
