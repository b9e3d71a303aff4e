"""Generate a robot file and specs that can be planned from a URDF alone."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from climbplan.climb.plan.climb_plan import ClimbPlan
from climbplan.climb.plan.world_sample import WorldSample
from climbplan.climb.planner.visual_geometry import load_visual_geometry
from climbplan.climb.proposed.outcome import SpecOutcome
from climbplan.climb.proposed.proposed import format_file_name, plan_proposal
from climbplan.climb.simulation.risk.sampling import sample_worlds
from climbplan.climb.simulation.risk.suggestions import suggest_knowledge
from climbplan.errors import UsageError
from climbplan.reports.robot_page import PlannedTask, build_robot_page
from climbplan.robots.urdf.proposal.propose_robot import propose_robot, read_tree
from climbplan.robots.urdf.proposal.robot_document import format_robot_document, format_urdf_path
from climbplan.walking.planner.proposed_walk import ProposedWalk, plan_proposed_walk

_CHOICE_SEED, _CHOICE_WORLDS = 1_000_003, 40  # of worlds by which postures are chosen
_SUGGESTION_WORLDS = 20  # by which it is told what should be known better
# Stages by the beginnings of their reports, with their usual fractions of the whole time
_STAGE_FRACTIONS = {
    "proposing": 0.2,
    "planning a walk on flat ground": 0.2,
    "planning: climbs": 0.15,
    "planning: goes": 0.2,
    "counting": 0.1,
    "planning a walk at speed": 0.15,
}
_FRESH_WORLDS = 100  # by which nothing is chosen, of which the notes tell
_TRIANGLES = 800  # of one shape in the pictures of a page


@dataclass(frozen=True)
class NewRobot:
    """The text of each generated file by name, and notes for the user."""

    name: str
    files: dict[str, str]
    notes: tuple[str, ...]


def list_file_names(urdf: Path) -> list[str]:
    """List the files that `new_robot` may write, before anything is planned.

    Raises SpecError for mistakes in the URDF.
    """
    name = format_file_name(read_tree(urdf).name)
    specs = ("ground", "chimney", "bracing", "wall", "wall_bracing", "walk", "walking")
    return [f"{name}.yaml", *(f"{name}_{spec}.yaml" for spec in specs), f"{name}.html"]


def new_robot(
    urdf: Path,
    directory: Path,
    report: Callable[[str], None] = lambda words: None,
    toes: Sequence[str] = (),
) -> NewRobot:
    """Generate a robot configuration from a URDF and plan with it.

    Specs that do not lead to a plan are returned as well; the notes say so.

    Args:
        urdf: the URDF file.
        directory: directory that paths in the files are relative to.
        report: called with the name of each stage.
        toes: links that the legs end in; () searches for them.

    Raises:
        SpecError: the URDF has mistakes.
        UsageError: no robot configuration can be generated from it.
    """
    report = _NewRobotProgress(report)
    report("proposing legs, toes and postures")
    proposal = propose_robot(urdf, toes=toes)
    planned = plan_proposal(proposal, directory, report, _sample_for_choice)
    proposal = planned.proposal
    report("counting falls in worlds that nothing was chosen by")
    outcomes: list[SpecOutcome | ProposedWalk] = [
        _in_fresh_worlds(proposed) for proposed in planned.outcomes
    ]
    walks = {}
    if planned.walks:
        report("planning a walk at speed")
        walk_file, walking_file = f"{planned.name}_walk.yaml", f"{planned.name}_walking.yaml"
        walk = plan_proposed_walk(proposal, f"{planned.name}.yaml", walking_file)
        outcomes.append(walk)
        if walk.text:
            walks[walk_file] = walk.text
        if walk.text and walk.proposal is not proposal:
            urdf_path = format_urdf_path(walk.proposal, directory)
            walks[walking_file] = format_robot_document(walk.proposal, urdf_path, walk_file)
    notes = [f"implausible: {text}" for text in proposal.implausible]
    notes += [f"assumed: {text}" for text in proposal.assumptions]
    notes += [str(outcome) for outcome in outcomes]
    badges = [_describe_for_page(outcome) for outcome in outcomes]
    visual_geometry = load_visual_geometry(proposal.draft.load_robot(), proposal.robot, _TRIANGLES)
    page = {
        f"{planned.name}.html": build_robot_page(proposal, planned.brace, badges, visual_geometry)
    }
    return NewRobot(planned.name, planned.files | walks | page, tuple(notes))


def _describe_for_page(outcome: SpecOutcome | ProposedWalk) -> PlannedTask:
    """Return what the robot's page says of a planned spec."""
    if outcome.plan is None:
        return PlannedTask(f"not found: {outcome.what}", "bad", str(outcome))
    has_reservation = isinstance(outcome, SpecOutcome) and (
        bool(outcome.implausible) or (outcome.sample is not None and not outcome.sample.enough)
    )
    return PlannedTask(outcome.what, "part" if has_reservation else "good", str(outcome))


class _NewRobotProgress:
    """Report stages with how many there are, the CPU time so far and an estimate of the rest."""

    def __init__(self, report: Callable[[str], None]) -> None:
        self._report, self._begin = report, time.process_time()

    def __call__(self, message: str) -> None:
        """Report the beginning of a stage, or of a step in it."""
        stages = list(_STAGE_FRACTIONS)
        number = next((i for i, stage in enumerate(stages) if message.startswith(stage)), None)
        if number is None:
            self._report(message)
            return
        elapsed = time.process_time() - self._begin
        done = sum(_STAGE_FRACTIONS[stage] for stage in stages[:number])
        estimate = f"; {elapsed:.0f} s of CPU so far" if done else ""
        if done:
            estimate += f", about {elapsed * (1 - done) / done:.0f} s to go"
        self._report(f"{number + 1} of {len(stages)}: {message}{estimate}")


def _sample_for_choice(plan: ClimbPlan) -> WorldSample | None:
    """Count falls in the worlds by which postures are chosen; None for robots of no engine."""
    try:
        return sample_worlds(plan, _CHOICE_SEED, _CHOICE_WORLDS)
    except UsageError:
        return None


def _in_fresh_worlds(outcome: SpecOutcome) -> SpecOutcome:
    """Return the outcome with the sample that planning its spec stores, and what it needs."""
    plan = outcome.plan
    if plan is None or outcome.sample is None:
        return outcome
    sample = sample_worlds(plan, plan.seed, _FRESH_WORLDS)
    needed = "" if sample.enough else suggest_knowledge(plan, _CHOICE_SEED, _SUGGESTION_WORLDS)
    return replace(outcome, sample=sample, needed=needed)
