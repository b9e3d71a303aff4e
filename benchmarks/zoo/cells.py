"""What is asked of every robot of the zoo: one function a column, from a proposal to a cell."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass

from benchmarks.climb.stands import fares
from climbplan.climb.proposed.outcome import SpecOutcome
from climbplan.climb.proposed.proposed import ProposalTrials
from climbplan.errors import UsageError
from climbplan.simulation.conditions import NOMINAL
from climbplan.walking.plan.walk_plan import WalkPlan
from climbplan.walking.planner.proposed_walk import plan_proposed_walk
from climbplan.walking.simulation.comparison import compare_walk
from climbplan.walking.simulation.walk_report import build_end
from climbplan.walking.simulation.whole_body_replay import simulate_whole_body

Told = Callable[[str], None]
NOT_SIMULATED = "not simulated"


@dataclass(frozen=True)
class Cell:
    """What became of one thing asked of one robot."""

    planned: bool  # and verified
    simulated: str  # "stands"; how it ends in MuJoCo otherwise; empty without a plan
    words: str  # why there is no plan; what is reached
    cpu: float  # [s] of planning, simulation not counted


Column = Callable[[ProposalTrials, Told], Cell]


def _simulated(end: Callable[[], str]) -> str:
    """How a plan ends; of a robot that `simulate` refuses, that it was not simulated."""
    try:
        return end()
    except UsageError:
        return NOT_SIMULATED


def _climb(make: Callable[[ProposalTrials, Told], SpecOutcome]) -> Column:
    def cell(trials: ProposalTrials, told: Told) -> Cell:
        begin = time.process_time()
        outcome = make(trials, told)
        spent = time.process_time() - begin
        plan = outcome.plan
        if plan is None:
            return Cell(False, "", outcome.why, spent)
        kept = f"keeps {outcome.margin_fraction:.0%} of its margins"
        return Cell(True, _simulated(lambda: fares(plan, "joints")), kept, spent)

    return cell


def _walk(turns: bool) -> Column:
    def cell(trials: ProposalTrials, told: Told) -> Cell:
        begin = time.process_time()
        made = plan_proposed_walk(trials.proposal, trials.robot_file, trials.robot_file, turns)
        spent = time.process_time() - begin
        walk = made.plan
        if walk is None:
            return Cell(False, "", made.message, spent)
        return Cell(True, _simulated(lambda: _fares(walk)), made.message, spent)

    return cell


def _fares(plan: WalkPlan) -> str:
    """How a walk ends in MuJoCo with the whole robot."""
    run = simulate_whole_body(plan, NOMINAL)
    if run.fallen:
        return f"falls at {run.time[-1]:.1f} s"
    end = build_end(plan, run, compare_walk(plan, run), float(run.speed.max(initial=0.0)))
    if end.good:
        return "stands"
    fast = f", joint speeds {end.joint_speed:.0%}" if end.too_fast else ""
    return f"{end.slips} slips, {end.lost_contacts} lost{fast}"


COLUMNS: dict[str, Column] = {
    "ground": _climb(lambda trials, told: trials.ground),
    "stairs": _climb(lambda trials, told: trials.plan_stairs()),
    "chimney": _climb(lambda trials, told: trials.plan_chimney(told)),
    "wall": _climb(lambda trials, told: trials.plan_wall(told)),
    "forward": _walk(turns=False),
    "turn": _walk(turns=True),
}
"""By what the table calls them: steps on flat ground, up two stairs, up between walls, from the
ground to walls, a walk at 0.5 m/s, a turn on the spot."""
