"""URDFs of random legs for tests: joints that turn, slide, and mimic others, at random places."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from climbplan.robots.any_robot import build_robot
from climbplan.robots.model import Robot
from climbplan.schema.robots.source import load_any_robot
from climbplan.schema.robots.urdf.robot import UrdfRobot

# From the body: r turns, p slides, m turns and n slides as another joint of the leg does
LEGS = ("rpr", "pprrm", "rrnprrm", "mrrrp", "rprnrpr")


def random_robot(folder: Path, seed: int, legs: tuple[str, ...] = LEGS) -> tuple[UrdfRobot, Robot]:
    """A robot of such legs, with masses, read and built."""
    rng = np.random.default_rng(seed)
    parts = [_link("base", rng)]
    for leg, kinds in enumerate(legs):
        own = [j for j, kind in enumerate(kinds) if kind in "rp"]
        parent = "base"
        for j, kind in enumerate(kinds):
            name = f"l{leg}_{j}"
            mimic = ""
            if kind in "mn":
                leader = f"l{leg}_{rng.choice(own)}"
                ratio, offset = rng.uniform(-1.5, 1.5), rng.uniform(-0.3, 0.3)
                mimic = f'<mimic joint="{leader}" multiplier="{ratio}" offset="{offset}"/>'
            axis = " ".join(str(v) for v in rng.normal(size=3))
            turns = kind in "rm"
            parts.append(
                f'<joint name="{name}" type="{"revolute" if turns else "prismatic"}">'
                f'<parent link="{parent}"/><child link="{name}_link"/>{_origin(rng)}'
                f'<axis xyz="{axis}"/><limit lower="-5" upper="5" effort="80" velocity="3"/>'
                f"{mimic}</joint>{_link(f'{name}_link', rng)}"
            )
            parent = f"{name}_link"
        parts.append(
            f'<joint name="l{leg}_tip" type="fixed"><parent link="{parent}"/>'
            f'<child link="toe{leg}"/>{_origin(rng)}</joint><link name="toe{leg}"/>'
        )
    (folder / "random.urdf").write_text(f'<robot name="random">{"".join(parts)}</robot>')
    lines = [f"  L{leg}: {{toe: toe{leg}}}" for leg in range(len(legs))]
    head = "kind: robot\nurdf: random.urdf\nworkspace: {reach: 50, stance_radius: 0.1}\nlegs:\n"
    (folder / "random.yaml").write_text(head + "\n".join(lines) + "\n")
    spec = load_any_robot("random.yaml", folder)
    assert isinstance(spec, UrdfRobot)
    return spec, build_robot(spec)


def _origin(rng: np.random.Generator) -> str:
    place = " ".join(str(v) for v in rng.uniform(-0.3, 0.3, 3))
    return f'<origin xyz="{place}" rpy="{" ".join(str(v) for v in rng.uniform(-2, 2, 3))}"/>'


def _link(name: str, rng: np.random.Generator) -> str:
    inertia = 'ixx="0.02" ixy="0.001" ixz="0" iyy="0.03" iyz="0.002" izz="0.025"'
    return (
        f'<link name="{name}"><inertial>{_origin(rng)}<mass value="{rng.uniform(0.1, 2.0)}"/>'
        f"<inertia {inertia}/></inertial></link>"
    )
