"""A proposed robot put to the test: a walk on ground and a climb between walls, as planned."""

from __future__ import annotations

import re
import tempfile
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from climbplan.climb.check.verification import verification_of
from climbplan.climb.plan.climb_plan import ClimbPlan
from climbplan.climb.planner import plan_climb
from climbplan.errors import NoPlanFound, SpecError, UsageError
from climbplan.robots.urdf.proposal.document import (
    chimney_document,
    ground_document,
    paths,
    robot_document,
)
from climbplan.robots.urdf.proposal.postures import Posture
from climbplan.robots.urdf.proposal.proposing import Proposal
from climbplan.spec.loading import load_climb

_TRIED = 8  # bracing postures that are planned with
_ENOUGH = 0.9  # of its margins: plans that keep less may fall
_LIMIT = 20.0  # [s] of a posture planner's time
_METHOD = ("solver.method=micp", f"solver.time_limit={_LIMIT}")

Told = Callable[[str], None]


@dataclass(frozen=True)
class Outcome:
    """What became of a spec."""

    what: str  # "walks on ground"
    plan: ClimbPlan | None  # that is verified
    why: str  # there is none

    @property
    def share(self) -> float:
        """Of its margins that the plan keeps at its worst instant; below zero without a plan."""
        if self.plan is None:
            return -1.0
        kept = self.plan.forces.margin_share
        return 1.0 if kept is None else float(kept.min())

    def __str__(self) -> str:
        return f"{self.what}: {'verified' if self.plan is not None else self.why}"


@dataclass(frozen=True)
class Proposed:
    """Files by name, and what became of their specs."""

    name: str
    files: dict[str, str]
    walk: Outcome
    climb: Outcome
    brace: Posture | None  # between the walls of the climb's spec


def planned_proposal(found: Proposal, directory: Path, report: Told) -> Proposed:
    """Specs of a proposed robot, each planned by the global method before it is written.

    Paths in the files are for `directory`; report: told what is being done. The climb's spec has
    the first bracing posture whose plan keeps nearly all of its margins, or the one that keeps
    most; where none leads to a plan, the best by the proposal, with its refusal.
    """
    name = _file_name(found.name)
    robot_file, ground, chimney = (f"{name}{end}.yaml" for end in ("", "_ground", "_chimney"))
    files = {
        robot_file: robot_document(found, paths(found, directory), f"{ground}, {chimney}"),
        ground: ground_document(found, robot_file),
    }
    with tempfile.TemporaryDirectory() as folder:
        place = Path(folder)
        absolute = robot_document(found, str(found.draft.urdf), "")
        (place / robot_file).write_text(absolute, encoding="utf-8")
        report("planning a walk on flat ground")
        walk = _outcome("walks on ground", place / ground, files[ground])
        what = "climbs between walls"
        climb = Outcome(what, None, "no posture between walls holds it with any leg lifted")
        brace: Posture | None = None
        for number, posture in enumerate(_varied(found.braces), 1):
            report(f"planning a climb between walls, posture {number}")
            text = chimney_document(found, robot_file, posture)
            one = _outcome(what, place / chimney, text)
            if brace is None or one.share > climb.share:
                brace, climb, files[chimney] = posture, one, text
            if climb.share >= _ENOUGH:
                break
    return Proposed(name, files, walk, climb, brace)


def _varied(braces: tuple[Posture, ...]) -> list[Posture]:
    """The best of each friction in turn, so that postures on rougher walls have their chance."""
    by_friction: dict[float, list[Posture]] = {}
    for brace in braces:
        by_friction.setdefault(brace.friction, []).append(brace)
    return [brace for own in by_friction.values() for brace in own[: _TRIED // len(by_friction)]]


def _outcome(what: str, path: Path, text: str) -> Outcome:
    """The verified plan of a spec, or why there is none."""
    path.write_text(text, encoding="utf-8")
    try:
        plan = plan_climb(load_climb(path, list(_METHOD)))
    except (NoPlanFound, SpecError, UsageError) as error:
        return Outcome(what, None, str(error).partition("\n")[0])
    verification = verification_of(plan)
    if not verification.passed:
        return Outcome(what, None, f"the plan fails its verification: {verification.headline()}")
    return Outcome(what, plan, "")


def _file_name(name: str) -> str:
    """A robot's name as one of a file."""
    return re.sub(r"[^a-z0-9]+", "_", name.lower()).strip("_") or "robot"
