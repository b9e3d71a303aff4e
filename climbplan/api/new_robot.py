"""Files for a robot from its URDF alone: the robot, and specs that plan as they are."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from climbplan.climb.looks import plan_looks
from climbplan.climb.proposed import file_name, planned_proposal
from climbplan.reports.robot_page import robot_page
from climbplan.robots.urdf.proposal.document import paths, robot_document
from climbplan.robots.urdf.proposal.proposing import propose, read_tree
from climbplan.walking.proposed import walk_proposed

_TRIANGLES = 800  # of one shape in the pictures of a page


@dataclass(frozen=True)
class NewRobot:
    """Files by name, and what there is to say of them."""

    name: str
    files: dict[str, str]
    notes: tuple[str, ...]


def names_of_files(urdf: Path) -> list[str]:
    """Files that `new_robot` may write, known before anything is planned.

    Raises SpecError for what is wrong in the URDF.
    """
    name = file_name(read_tree(urdf).name)
    ends = (
        ".yaml",
        "_ground.yaml",
        "_chimney.yaml",
        "_wall.yaml",
        "_walk.yaml",
        "_walking.yaml",
        ".html",
    )
    return [f"{name}{end}" for end in ends]


def new_robot(
    urdf: Path, directory: Path, report: Callable[[str], None] = lambda words: None
) -> NewRobot:
    """Propose a robot from a URDF, and plan with it; paths in the files are for `directory`.

    A spec that does not lead to a plan is written all the same, and told. Raises SpecError for what
    is wrong in the URDF and UsageError where no robot can be proposed.
    """
    report("proposing legs, toes and postures")
    found = propose(urdf)
    made = planned_proposal(found, directory, report)
    found = made.found
    report("planning a walk at speed")
    robot_file, walk_file = f"{made.name}.yaml", f"{made.name}_walk.yaml"
    walking_file = f"{made.name}_walking.yaml"
    walk = walk_proposed(found, robot_file, walking_file)
    outcomes = (made.walk, made.climb, made.wall, walk)
    notes = [f"implausible: {text}" for text in found.odd]
    notes += [f"assumed: {text}" for text in found.assumed]
    notes += [str(outcome) for outcome in outcomes]
    badges = [
        (one.what if one.plan is not None else f"not found: {one.what}", one.plan is not None)
        for one in outcomes
    ]
    walks = {walk_file: walk.text} if walk.text else {}
    if walk.text and walk.found is not found:
        walks[walking_file] = robot_document(walk.found, paths(walk.found, directory), walk_file)
    looks = plan_looks(found.draft.robot(), found.robot, _TRIANGLES)
    page = {f"{made.name}.html": robot_page(found, made.climb.brace, badges, looks)}
    return NewRobot(made.name, made.files | walks | page, tuple(notes))
