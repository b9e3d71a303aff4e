"""Robots that plan as they are: those that are shipped, and URDFs of a public package.

What public robots do is read from the record of `python -m benchmarks zoo`, nothing is typed.
"""

from __future__ import annotations

import json
import re
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from cards import Card, write_cards
from gallery_page import COURSES
from name_declarations import declare

PACKAGE = "example-robot-data"
# What each column of the record is, in words for a card
ABILITIES = {
    "ground": "steps on flat ground",
    "stairs": "goes up two stairs",
    "chimney": "climbs between walls",
    "wall": "gets from the ground to walls",
    "forward": "walks",
    "turn": "turns",
}


@dataclass(frozen=True)
class ShippedRobot:
    """A robot of the repository, by a scene that shows it."""

    name: str
    title: str
    about: str
    scene: str  # whose plan the picture is of
    command: str
    fraction: float = 0.5  # of the plan's time, when the picture is taken
    film: str = ""  # scene of the gallery that the film shows


SHIPPED = (
    ShippedRobot(
        "silvia",
        "SiLVIA",
        "Hexapod of three joints a leg: climbs between walls, in tubes, on stairs and scans, and"
        " gets from the ground to walls.",
        "climb_steps",
        "climbplan plan-climb specs/climb_tube.yaml",
        film="climb_tube",
    ),
    ShippedRobot(
        "scaler",
        "SCALER",
        "Quadruped of five-bar legs with spine grippers: climbs one wall and along a ceiling.",
        "climb_single_wall",
        "climbplan plan-climb specs/climb_ceiling.yaml",
        film="climb_ceiling",
    ),
    ShippedRobot(
        "scaler-walking",
        "SCALER, walking",
        "The same as one rigid body: walks at 1.8 m/s, turns, takes stairs and stepping stones,"
        " recovers from pushes in closed loop.",
        "mpc_stairs",
        "climbplan plan-mpc specs/mpc_stairs.yaml",
        film="mpc_stairs",
    ),
    ShippedRobot(
        "walker",
        "Walker",
        "Quadruped from a URDF, four joints a leg: climbs between walls.",
        "climb_walker",
        "climbplan plan-climb specs/climb_walker.yaml",
    ),
    ShippedRobot(
        "telescope",
        "Telescope",
        "Quadruped whose last joints slide: climbs between walls and walks.",
        "climb_telescope",
        "climbplan plan-climb specs/climb_telescope.yaml",
    ),
    ShippedRobot(
        "hexapod",
        "Hexapod",
        "From a URDF, three joints a leg: walks on tripods within its torque limits.",
        "mpc_hexapod",
        "climbplan plan-mpc specs/mpc_hexapod.yaml",
    ),
    ShippedRobot(
        "biped",
        "Biped",
        "Two legs of six joints on flat feet: steps over ground and up stairs.",
        "climb_biped_stairs",
        "climbplan plan-climb specs/climb_biped_stairs.yaml",
    ),
    ShippedRobot(
        "limms",
        "LIMMS",
        "Modules with a latch at both ends: become arms and legs of boxes, carry, walk, throw.",
        "limms_walk",
        "climbplan plan-limms specs/limms_walk.yaml",
        fraction=0.85,
        film="limms_throw",
    ),
)


@dataclass(frozen=True)
class PublicRobot:
    """What a record says of a robot of the public package."""

    title: str
    part: str  # of its path in the package
    mass: float  # [kg]
    legs: int
    ends: Mapping[str, str]  # of each planned column: how it ends in simulation

    @property
    def name(self) -> str:
        """Return its name in file names and anchors."""
        return re.sub(r"\W+", "-", self.title.lower())

    @property
    def about(self) -> str:
        """Return mass, legs and what it does, in words."""
        done = [words for column, words in ABILITIES.items() if column in self.ends]
        return f"{self.mass:.1f} kg, {self.legs} limbs: {', '.join(done)}."

    @property
    def commands(self) -> tuple[str, str]:
        """Return the commands that propose it and plan with it."""
        short = re.sub(r"\W+", "_", self.title.lower())
        column = "chimney" if "chimney" in self.ends else "ground"
        return (
            f"climbplan new robot {short} --package {PACKAGE}:{self.part}",
            f"climbplan plan-climb {short}/*_{column}.yaml",
        )


def read_public_robots(record: Path) -> list[PublicRobot]:
    """Return the robots of a record of `zoo` that have a verified plan, in its order."""
    from benchmarks.zoo.robots import ROBOTS

    rows = json.loads(record.read_text(encoding="utf-8"))["results"]["rows"]
    robots = []
    for zoo in ROBOTS:
        mine = [row for row in rows if row["robot"] == zoo.name]
        ends = {row["column"]: row["simulated"] for row in mine if row["planned"]}
        if ends and not zoo.ours:
            first = mine[0]
            robots.append(PublicRobot(zoo.name, zoo.part, first["mass"], first["legs"], ends))
    return robots


def robots_page(docs: Path) -> str:
    """Return the page of all robots; a robot without a picture raises FileNotFoundError."""
    record = docs / "benchmarks" / "zoo.json"
    described: dict[str, Any] = json.loads(record.read_text(encoding="utf-8"))
    lines = [
        "# Robots that plan as they are",
        "",
        "Each picture is a frame of a verified plan, each film a plan of the",
        "[gallery](gallery.md) or of stairs in the [benchmark of courses](benchmarks.md).",
        "For a robot that is not here, start from its URDF or MJCF file",
        "([tutorial](../tutorials/your_robot.md), [details](guides/robots.md)).",
        "",
        "## Shipped",
        "",
    ]
    lines.append(write_cards(_shipped_card(robot, docs) for robot in SHIPPED))
    lines += [
        "## From a public package",
        "",
        f"`pip install {PACKAGE}` brings their URDFs. Legs, toes, postures and stiffness are",
        "proposed from the URDF; nothing is typed by hand. What they do is what",
        f"`python -m benchmarks zoo` planned and verified on {described['date'][:10]}; the",
        "[benchmark page](benchmarks.md#zoo) says how each plan ends in simulation, why others",
        "were refused, and what was not run.",
        "",
    ]
    lines.append(write_cards(_public_card(robot, docs) for robot in read_public_robots(record)))
    return "\n".join(lines)


def robot_grid(docs: Path) -> str:
    """Return the grid of the landing page: small cards that lead to the page of robots."""
    cards = [
        Card(
            title=f"[{robot.title}](#{_label(robot)})",
            text=robot.about,
            picture=f"robots/{robot.name}.webp",
            alternative=robot.title,
            link=f"#{_label(robot)}",
        )
        for robot in (*SHIPPED, *read_public_robots(docs / "benchmarks" / "zoo.json"))
    ]
    return write_cards(cards, "small")


def _label(robot: ShippedRobot | PublicRobot) -> str:
    return f"card-{robot.name}"


def _shipped_card(robot: ShippedRobot, docs: Path) -> Card:
    return Card(
        title=declare("robot", robot.name, robot.title),
        text=robot.about,
        picture=_find_picture(docs, robot.name),
        alternative=robot.title,
        command=robot.command,
        label=_label(robot),
        film=_find_film(docs, robot.film),
    )


def _public_card(robot: PublicRobot, docs: Path) -> Card:
    return Card(
        title=declare("robot", robot.name, robot.title),
        text=robot.about,
        picture=_find_picture(docs, robot.name),
        alternative=robot.title,
        command="\n".join(robot.commands),
        label=_label(robot),
        film=_find_film(
            docs, next((name for name, c in COURSES.items() if c[0] == robot.title), "")
        ),
    )


def _find_picture(docs: Path, name: str) -> str:
    path = docs / "robots" / f"{name}.webp"
    if not path.exists():
        raise FileNotFoundError(f"{path}: `python docs/make_robot_pictures.py {name}`")
    return f"../robots/{path.name}"


def _find_film(docs: Path, name: str) -> str:
    """Return the film of a scene or course; "" without a name."""
    path = docs / "gallery" / "films" / f"{name}_film.webp"
    if name and not path.exists():
        raise FileNotFoundError(f"{path}: `python docs/make_gallery.py {name}`")
    return f"../gallery/films/{path.name}" if name else ""
