"""The gallery: every shipped spec of a kind that is planned, with picture and command."""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path

from cards import Card, join_links, write_cards, write_film
from name_declarations import declare

COMMANDS = {
    "climb": "plan-climb",
    "transition": "plan-transition",
    "mpc": "plan-mpc",
    "limms": "plan-limms",
    "bookshelf": "solve-bookshelf",
}


@dataclass(frozen=True)
class Family:
    """Scenes of one section."""

    heading: str
    about: str
    guide: str  # page of the family, beside `guides/`
    film: str = ""  # scene that the film at the head of the section shows


FAMILIES = {
    "climb": Family(
        "Climbing",
        "Legs brace between walls, in tubes and on stairs.",
        "climb",
        "climb_tube",
    ),
    "grip": Family(
        "Climbing by gripping",
        "Grippers carry the robot up one wall and along a ceiling.",
        "climb_forces_grips",
        "climb_ceiling",
    ),
    "transition": Family(
        "Transitions and missions",
        "From the ground to the walls: the contact sequence is part of the plan.",
        "climb",
        "mission_ground_to_top",
    ),
    "mpc": Family(
        "Walking",
        "Footsteps, gait, body motion and contact forces are chosen together.",
        "walking",
        "mpc_stairs",
    ),
    "limms": Family(
        "Modules",
        "Modules with a latch at both ends become arms and legs of boxes.",
        "limms",
        "limms_throw",
    ),
    "bookshelf": Family(
        "Bookshelf", "One more book, with the least motion of the others.", "bookshelf"
    ),
}
MAIN_FILM = "climb_tube"  # of the landing page
FILMS = (MAIN_FILM, *(family.film for family in FAMILIES.values() if family.film))
# Films of the landing page beside it, of courses in the benchmark: robot, kind and seed
COURSES = {"stairs": ("ANYmal C", "stairs", 0), "rubble": ("silvia", "rubble", 0)}
_CITATION = re.compile(r" ?\([^()]*(?:X\. Lin|chapter)[^()]*\)|, eqs\. \([\d.]+\) to \([\d.]+\)")
_SENTENCE_END = re.compile(r"(?<![A-Z])\. (?=[A-Z])")


@dataclass(frozen=True)
class Scene:
    """A shipped spec as the gallery shows it."""

    name: str
    kind: str
    family: str
    title: str
    about: str  # the first sentence of its leading comment, without citations

    @property
    def command(self) -> str:
        """Return the command that plans it."""
        return f"climbplan {COMMANDS[self.kind]} specs/{self.name}.yaml"


def scenes(specs: Path) -> list[Scene]:
    """Return all specs of kinds with a plan, by family and name."""
    found = []
    for path in sorted(specs.glob("*.yaml")):
        text = path.read_text(encoding="utf-8")
        kind = _read_key(text, "kind")
        if kind in COMMANDS:
            is_grip = kind == "climb" and _read_key(text, "robot") == "scaler"
            family = "grip" if is_grip else kind
            title = _read_key(text, "title")
            found.append(Scene(path.stem, kind, family, title, _first_sentence(text)))
    return sorted(found, key=lambda scene: list(FAMILIES).index(scene.family))


def gallery_page(specs: Path, pictures: Path) -> str:
    """Return the page; a scene without a picture raises FileNotFoundError."""
    lines = [
        "# Gallery",
        "",
        "Every shipped spec that is planned, with a frame of its plan; `figure` is that of its",
        "report. Films show what is planned, not a simulation, short motions slower. The",
        "[list of scenes](guides/specs.md) says how each plan ends in simulation.",
        "",
    ]
    listed = scenes(specs)
    for key, family in FAMILIES.items():
        lines += [f"## {family.heading}", ""]
        lines += [f"{family.about} [Methods, keys and limits](guides/{family.guide}.md).", ""]
        if family.film:
            lines += [_film(family.film, listed, pictures), ""]
        members = [scene for scene in listed if scene.family == key]
        lines.append(write_cards(_card(scene, pictures) for scene in members))
    return "\n".join(lines)


def _film(name: str, listed: list[Scene], pictures: Path) -> str:
    (title,) = [scene.title for scene in listed if scene.name == name]
    for kind in ("film", "still"):
        _require(pictures / "films" / f"{name}_{kind}.webp", name)
    folder = "../gallery/films"
    return write_film(f"{folder}/{name}_film.webp", f"{folder}/{name}_still.webp", title)


def _card(scene: Scene, pictures: Path) -> Card:
    """Return a scene's card; FileNotFoundError without pictures."""
    figure = _require(pictures / f"{scene.name}.png", scene.name)
    thumbnail = pictures / "thumbnails" / f"{scene.name}.webp"
    picture = thumbnail if thumbnail.exists() else figure
    folder = "../gallery" if picture is figure else "../gallery/thumbnails"
    return Card(
        title=declare("scene", scene.name, scene.title),
        text=scene.about,
        picture=f"{folder}/{picture.name}",
        alternative=scene.title,
        command=scene.command,
        links=join_links(
            (
                f"{{download}}`spec <../../specs/{scene.name}.yaml>`",
                f"{{download}}`figure <../gallery/{figure.name}>`",
            )
        ),
        is_figure=picture is figure,
    )


def _require(path: Path, name: str) -> Path:
    if not path.exists():
        raise FileNotFoundError(f"{path}: `python docs/make_gallery.py {name}`")
    return path


def _read_key(text: str, key: str) -> str:
    """Return the value of a top-level key that is one word or line; empty without it."""
    match = re.search(rf"^{key}: *([^#\n]*)", text, re.MULTILINE)
    return match[1].strip() if match else ""


def _first_sentence(text: str) -> str:
    """Return the first sentence of a spec's leading comment, without its citations."""
    words = []
    for line in text.splitlines():
        word = line.removeprefix("#").strip()
        if not line.startswith("#") or not word:
            break
        words.append(word)
    about = _CITATION.sub("", " ".join(words))
    return _SENTENCE_END.split(about)[0].rstrip(".:") + "."
