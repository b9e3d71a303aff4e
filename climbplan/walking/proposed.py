"""A proposed robot's walk put to the test: its spec, planned before it is written."""

from __future__ import annotations

import tempfile
from dataclasses import dataclass
from pathlib import Path

from climbplan.errors import NoPlanFound, SpecError
from climbplan.robots.urdf.pinocchio_model import urdf_model
from climbplan.robots.urdf.proposal.document import robot_document
from climbplan.robots.urdf.proposal.settled import Proposal
from climbplan.robots.urdf.proposal.walk_document import STANCE, walk_document
from climbplan.robots.urdf.walking_body import walking_body
from climbplan.spec.walking.loading import load_mpc
from climbplan.walking.check.checker import check_trajectory, failures
from climbplan.walking.plan import WalkPlan
from climbplan.walking.planner import plan_walk
from climbplan.walking.swing_effort import swing_effort

_TIME_LIMIT = "solver.time_limit=3600"  # a cap: QPs decide what the search finds


@dataclass(frozen=True)
class ProposedWalk:
    """A spec, or why there is none; and what became of it."""

    what: str
    text: str  # empty where the robot cannot walk by `plan-mpc`
    plan: WalkPlan | None  # that is verified
    words: str  # "verified"; else the reason

    def __str__(self) -> str:
        return f"{self.what}: {self.words}"


def proposed_walk(found: Proposal, robot_file: str, turns: bool = False) -> ProposedWalk:
    """The spec of a walk by a proposed robot; robot_file: how it names the robot's file.

    turns: on the spot, instead of forward.
    """
    what = "turns on the spot" if turns else "walks at speed"
    try:
        robot = found.draft.robot(meshes=False)
        body = walking_body(robot)
    except SpecError as error:
        return ProposedWalk(what, "", None, f"no spec: {error.mistakes[0].message}")
    model = urdf_model(robot)

    def effort(speed: float, step: float, lift: float) -> float:
        return swing_effort(model, body.legs, speed, step, lift, STANCE)

    text = walk_document(body, robot_file, effort, turns)
    with tempfile.TemporaryDirectory() as folder:
        place = Path(folder)
        absolute = robot_document(found, str(found.draft.urdf), "")
        (place / robot_file).write_text(absolute, encoding="utf-8")
        (place / "walk.yaml").write_text(text, encoding="utf-8")
        try:
            plan = plan_walk(load_mpc(place / "walk.yaml", [_TIME_LIMIT]))
        except (NoPlanFound, SpecError) as error:
            return ProposedWalk(what, text, None, str(error).partition("\n")[0])
    broken = failures(check_trajectory(plan.task, plan.trajectory))
    return ProposedWalk(what, text, None if broken else plan, broken or "verified")
