"""Robots that walk over drawn grounds, as specs state them: stance, gait, steps."""

from __future__ import annotations

import tempfile
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from climbplan.arrays import Array
from climbplan.datasets.schema.motions import MODEL_ENDINGS, ROBOT_ENDINGS, MotionRobotSpec
from climbplan.errors import UsageError
from climbplan.robots.any_robot import build_robot
from climbplan.robots.model import Robot
from climbplan.schema.robots.source import find_robot_files, load_any_robot

_FRONT = 0.2  # [m] along y of the foremost toes at the start
_SHIFTS = {True: 0.6, False: 0.2}  # of toes' level distance, if the body has to lean for a lift
_MAX_LEANING = 4  # limbs, with which the body leans for each lift


@dataclass(frozen=True)
class GroundRobot:
    """A robot on ground; plain values, so that any process can make its specs."""

    name: str
    file: str  # built-in name, or full path of a robot file; empty: `text` is that file
    text: str  # of a proposed robot
    height: float  # [m] of the body over its footholds
    start: float  # [m] of the body along y
    task: dict[str, Any]  # keys of the task: stance or gait
    step: float  # [m] of the body, at most
    shift: float  # [m] of the body over the standing limbs, at most
    speed: float  # [m/s]

    def build_spec(
        self, robot: str, terrain: dict[str, Any], route: Array, time_limit: float
    ) -> dict[str, Any]:
        """Return the spec of a walk over a ground.

        Args:
            robot: File or name of the robot.
            terrain: The section on the terrain.
            route: (2, 2) level and height of the ground at start and goal, along y from the origin
                [m].
            time_limit: Of the planner [s].
        """
        (start, low), (end, high) = route.tolist()
        return {
            "kind": "climb",
            "robot": robot,
            "terrain": terrain,
            "task": {
                "rounds": "auto",
                "start": {"com": [0.0, round(start, 4), round(low + self.height, 4)]},
                "goal": {
                    "com": [0.0, round(end, 4), round(high + self.height, 4)],
                    "tolerance": 0.05,
                },
                **self.task,
            },
            "posture": {
                "rotation_limit_deg": 25,
                "steps": {
                    "com_max": round(self.step, 4),
                    "toe_max": round(4 * self.step, 4),
                    "com_shift_max": round(self.shift, 4),
                },
            },
            "force": {"safety_friction": 1.2},
            "trajectory": {"speed": self.speed},
            "solver": {"time_limit": time_limit},
        }


def prepare_walkers(robots: Sequence[MotionRobotSpec], directory: Path) -> tuple[GroundRobot, ...]:
    """Return the robots of a spec; those of a URDF or MJCF are proposed, which takes seconds.

    Args:
        robots: As the spec names them.
        directory: That paths start from.

    Raises:
        SpecError: A robot's file has mistakes.
        UsageError: Nothing can be proposed, or the robot does not suit the grounds.
    """
    return tuple(_prepare_walker(spec, directory) for spec in robots)


def list_walker_files(robots: Sequence[MotionRobotSpec], directory: Path) -> list[Path]:
    """Return the files that robots are made from; raises SpecError for one that is unreadable."""
    files: list[Path] = []
    for spec in robots:
        ending = Path(spec.file).suffix.lower()
        if ending in MODEL_ENDINGS:
            files.append(directory / spec.file)
        elif ending in ROBOT_ENDINGS:
            files += find_robot_files(spec.file, directory)
    return files


def _prepare_walker(spec: MotionRobotSpec, directory: Path) -> GroundRobot:
    ending = Path(spec.file).suffix.lower()
    if ending in MODEL_ENDINGS:
        text = _propose_text((directory / spec.file).absolute())
        with tempfile.TemporaryDirectory() as folder:
            path = Path(folder, "robot.yaml")
            path.write_text(text, encoding="utf-8")
            robot = build_robot(load_any_robot(path))
        return _build_walker(spec, robot, "", text)
    file = str((directory / spec.file).absolute()) if ending in ROBOT_ENDINGS else spec.file
    return _build_walker(spec, build_robot(load_any_robot(spec.file, directory)), file, "")


def _propose_text(path: Path) -> str:
    from climbplan.robots.urdf.proposal.propose_robot import propose_robot
    from climbplan.robots.urdf.proposal.robot_document import format_robot_document

    proposal = propose_robot(path)
    return format_robot_document(proposal, str(proposal.draft.urdf), "")


def _build_walker(spec: MotionRobotSpec, robot: Robot, file: str, text: str) -> GroundRobot:
    if robot.sole is not None:
        raise UsageError(
            f"{spec.file}: stands on flat feet, which walk over flat ground only; expected a scene "
            "`family: spec` with the ground spec of `climbplan new robot`"
        )
    toes = robot.stance_body
    if spec.stance is not None:
        if set(spec.stance) != set(robot.limb_names):
            raise UsageError(
                f"{spec.file}: `stance` names {', '.join(spec.stance)}, expected "
                f"{', '.join(robot.limb_names)}"
            )
        toes = np.array([spec.stance[name] for name in robot.limb_names])
    foot_radius = 0.0 if robot.foot is None else robot.foot.radius
    height = spec.height or -float(toes[:, 2].mean()) + foot_radius
    leans = len(toes) <= _MAX_LEANING
    task: dict[str, Any] = {}
    if spec.stance is not None:
        task["stance"] = {name: list(toe) for name, toe in spec.stance.items()}
    if leans:
        task["gait"] = _order_limbs(robot, toes)
    return GroundRobot(
        name=robot.name,
        file=file,
        text=text,
        height=height,
        start=min(0.0, _FRONT - float(toes[:, 1].max())),
        task=task,
        step=spec.step * height,
        shift=_SHIFTS[leans] * float(np.linalg.norm(toes[:, :2], axis=1).max()),
        speed=spec.speed,
    )


def _order_limbs(robot: Robot, toes: Array) -> list[str]:
    """Return limbs one by one: the hind one before the front one, on the left, then the right."""
    rear, front = toes[:, 1].min(), toes[:, 1].max()
    order = sorted(
        range(len(toes)), key=lambda i: (toes[i, 0] > 0, toes[i, 1] > (rear + front) / 2)
    )
    return [robot.limb_names[i] for i in order]
