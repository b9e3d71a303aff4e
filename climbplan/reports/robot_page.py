"""A page about a robot proposed from its URDF: pictures of postures, joints, masses, oddities."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from climbplan.reports.page_parts import Card, Table
from climbplan.reports.page_template import build_frame_fields, fill
from climbplan.reports.robot_picture import draw_robot_picture
from climbplan.reports.sheet import render_png
from climbplan.robots.facts import measure_robot
from climbplan.robots.model import Robot, dynamics_of
from climbplan.robots.task_robot import with_stance
from climbplan.robots.urdf.proposal.postures import LeggedPosture
from climbplan.robots.urdf.proposal.prepared_robot import RobotProposal
from climbplan.robots.visual_geometry import VisualGeometry

_JOINTS = ("leg", "joint", "bounds [deg]", "standing [deg]", "torque [N m]", "speed [rad/s]",
           "stiffness [N m/rad]")  # fmt: skip


class PlannedTask(NamedTuple):
    """A spec that uses the robot, as its page shows it."""

    badge: str  # "walks on ground"
    colour: str  # "good"; "part" of a plan that falls in too many worlds; "bad" without a plan
    sentence: str  # what became of it


def build_robot_page(
    proposal: RobotProposal,
    brace: LeggedPosture | None,
    outcomes: Sequence[PlannedTask],
    visual_geometry: VisualGeometry | None = None,
) -> str:
    """Return the page of a proposed robot.

    Args:
        proposal: The robot with what was assumed for it.
        brace: Posture between walls; None where the robot has none.
        outcomes: What became of each spec that uses the robot.
        visual_geometry: Visual geometry of the URDF for the pictures; None draws links as lines.
    """
    robot = proposal.robot
    facts = measure_robot(robot)
    images = {
        "standing on ground": render_png(
            draw_robot_picture(facts, "standing on ground", visual_geometry)
        )
    }
    if brace is not None:
        toes = {
            name: (float(x), float(y), float(z))
            for name, (x, y, z) in zip(robot.limb_names, brace.toes, strict=True)
        }
        braced = measure_robot(with_stance(robot, toes))
        title = f"between walls {brace.gap + 2 * robot.standoff:.3f} m apart"
        images[title] = render_png(draw_robot_picture(braced, title, visual_geometry))
    notes = [("IMPLAUSIBLE", text) for text in proposal.implausible]
    notes += [("ASSUMED", text) for text in proposal.assumptions]
    fields = build_frame_fields(
        robot.name,
        ("robot",),
        (),
        all(outcome.colour != "bad" for outcome in outcomes),
        _build_cards(proposal),
        images,
    )
    verdict = "Proposed from its URDF: look at what is assumed before it is believed."
    return fill(
        "robot.html",
        **fields,
        verdict=verdict,
        notes=notes,
        outcomes=tuple(outcomes),
        joints=Table.of(_JOINTS, _build_joint_rows(proposal)),
        links=Table.of(("carried by", "mass [kg]", "links"), _build_link_rows(proposal)),
    )


def _build_cards(proposal: RobotProposal) -> list[Card]:
    robot = proposal.robot
    inertia = dynamics_of(robot).rotor_inertia[robot.has_joint]
    cards = [
        Card("Mass", f"{robot.mass:.4g} kg", f"{len(proposal.tree.links)} links"),
        Card("Standing height", f"{-robot.stance_body[:, 2].mean():.3f} m", "body above its toes"),
        Card("Room of a toe", f"{robot.stance_radius:.3f} m", "ball about its stance, sampled"),
        Card("Reach", f"{robot.reach:.3f} m", "of the leg that reaches least"),
        Card("Stiffness", f"{proposal.motors.stiffness:g} N m/rad", "of most joints, proposed"),
        Card("Rotors", f"{np.median(inertia):.2g} kg m^2", "behind gears, median, for `simulate`"),
    ]
    if (sole := robot.sole) is not None:
        size = f"{1e3 * sole.length:g} x {1e3 * sole.width:g} mm"
        cards.append(Card("Feet", size, "soles, by collision geometry"))
    elif robot.foot is not None:
        cards.append(Card("Feet", f"{1e3 * robot.foot.radius:g} mm", "spheres round the toes"))
    return cards


def _build_joint_rows(proposal: RobotProposal) -> list[list[str]]:
    robot: Robot = proposal.robot
    rows = []
    for n, leg in enumerate(robot.limb_names):
        for j, joint in enumerate(robot.limbs.joint_names[n]):
            if not joint:
                continue
            low, high = robot.joint_lower[n, j], robot.joint_upper[n, j]
            if not robot.slides[n, j]:
                low, high = np.rad2deg(low), np.rad2deg(high)
            numbers = (
                robot.max_torque[n, j],
                robot.max_joint_speed[n, j],
                proposal.motors.joints[joint].stiffness,
            )
            rows.append(
                [leg, joint, f"{low:.0f} to {high:.0f}", f"{proposal.standing[joint]:.0f}"]
                + [f"{value:g}" for value in numbers]
            )
    return rows


def _build_link_rows(proposal: RobotProposal) -> list[list[str]]:
    """Return moving parts: their joint, their mass, and the links fixed together in them."""
    tree = proposal.tree
    by_child = tree.by_child
    links_by_part: dict[str, list[str]] = {}
    for name in tree.links:
        part_root = name
        while part_root in by_child and by_child[part_root].kind == "fixed":
            part_root = by_child[part_root].parent
        links_by_part.setdefault(part_root, []).append(name)
    rows = []
    for first, links in links_by_part.items():
        mass = sum(tree.links[name].mass for name in links)
        joint = by_child[first].name if first in by_child else "the body"
        link_names = ", ".join(links[:4]) + (
            f" and {len(links) - 4} more" if len(links) > 4 else ""
        )
        rows.append([joint, f"{mass:.4g}", link_names])
    return rows
