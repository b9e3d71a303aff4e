"""Test a proposed robot by planning: on ground, up stairs, between walls, from ground to walls."""

from __future__ import annotations

import re
import tempfile
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import islice, zip_longest
from pathlib import Path

from climbplan.climb.check.verification import verify_plan
from climbplan.climb.planner.planner import plan_climb
from climbplan.climb.proposed.outcome import (
    NEGLIGIBLE_MARGIN,
    TARGET_STANDING,
    SampleWorlds,
    SpecOutcome,
)
from climbplan.climb.schema.loading import load_climb
from climbplan.climb.schema.transition_loading import load_transition
from climbplan.climb.transition.planner import plan_transition
from climbplan.errors import NoPlanFound, SpecError, UsageError
from climbplan.robots.urdf.proposal.bracing_random_search import (
    place_on_ground,
    propose_bracing_postures,
)
from climbplan.robots.urdf.proposal.postures import LeggedPosture
from climbplan.robots.urdf.proposal.prepared_robot import RobotProposal
from climbplan.robots.urdf.proposal.robot_document import format_robot_document, format_urdf_path
from climbplan.robots.urdf.proposal.spec_documents import (
    format_chimney_document,
    format_ground_document,
    format_stairs_document,
    format_wall_document,
)

_MAX_STANDING_POSTURES = 3  # standing postures that are planned with
_MAX_BRACING_POSTURES = 6  # bracing postures that are planned with
_MAX_FAILURES = 3  # postures without any plan in turn, after which no further ones are planned
_MAX_BRACING_PLANS = 3  # plans among which the best is chosen
_MIN_IMPROVEMENT = 0.05  # of worlds without a fall, by which further postures have to be better
_MIN_MARGIN_FRACTION = 0.9  # of its margins: plans that keep less may fall
_FULL_MARGIN_FRACTION = 0.95  # of its margins: motors have something left to press with
_LARGER_MARGINS = ("{slip: 0.5, friction: 0.16}", "{slip: 0.6, friction: 0.24, normal_force: 0.15}")
_MAX_ALTERNATIVE_POSTURES = 3  # postures that bend limbs otherwise than the robot stands
_WALL_MIN_MARGIN_FRACTION = 0.5  # of a transition's, whose stances are fewer to choose from
_MAX_WALL_PLANS = 2  # transitions that are planned to the end, at most
_WALL_TARGET_STANDING = 0.8  # fraction of worlds without a fall that ends their search
# Work decides what is found, the same on any machine under any load; the clock only caps
_MAX_NODES = 2000  # of each search for postures by branch and bound; most take one
_TIME_LIMIT = 3600.0  # [s]
_METHOD = ("solver.method=micp", f"solver.time_limit={_TIME_LIMIT}")
# Motions of sequences take ten seconds and more each
_WALL_SEQUENCES = 2  # of a transition, that are planned to the end
_WALL_MARGIN_FRACTIONS = 1.2, 0.6  # of the margins, that motions of a sequence are planned with
_WALL_RISES = (0.0, 0.15)  # of the body on its way to walls, over its height, tried in turn
_WALL_METHOD = (
    "solver.method=stance-search",
    f"solver.time_limit={_TIME_LIMIT}",
    f"search.max_planned={_WALL_SEQUENCES}",
)

Report = Callable[[str], None]
FormatDocument = Callable[
    [RobotProposal, str, LeggedPosture], str
]  # of a robot, its file, and how it braces


@dataclass(frozen=True)
class PlannedProposal:
    """The files of a proposal by name, and the outcomes of their specs."""

    name: str
    proposal: RobotProposal  # in the standing posture that was settled on
    files: dict[str, str]
    outcomes: tuple[SpecOutcome, ...]  # of a walk on ground first
    brace: LeggedPosture | None  # between walls that it climbs
    walks: bool  # whether a walk at speed may be asked of it


class ProposalTrials:
    """Plans the specs of one proposed robot in a folder of its own."""

    def __init__(
        self, proposal: RobotProposal, folder: Path, sample_worlds: SampleWorlds = lambda plan: None
    ) -> None:
        """Select the standing posture of largest clearance in which the robot walks on ground.

        Args:
            found: The proposed robot.
            folder: Where robot files and specs are written; of this robot alone.
            sample_worlds: Counts falls in worlds of a plan, by which postures are chosen.
        """
        self.folder = folder
        self._sample_worlds = sample_worlds
        self.name = format_file_name(proposal.name)
        self.robot_file = f"{self.name}.yaml"
        self.bracing_file = f"{self.name}_bracing.yaml"
        self.wall_bracing_file = f"{self.name}_wall_bracing.yaml"
        self._write_robot(proposal)
        self._alternatives: list[RobotProposal] | None = None
        self._bracing_alternatives: list[RobotProposal] | None = None
        self._climbs: list[SpecOutcome] = []  # between walls, with postures of the proposal
        self.ground = self._plan_walk()
        best = proposal
        for alternative in self.list_alternatives():
            if self.ground.is_good_enough(NEGLIGIBLE_MARGIN):
                break
            if self.ground.plan is not None and self.ground.sample is None:
                break
            self._write_robot(alternative)
            outcome = self._plan_walk()
            if outcome.rank > self.ground.rank:
                self.ground, best = outcome, alternative
        self._write_robot(best)

    def list_alternatives(self) -> list[RobotProposal]:
        """List the robot in its other standing postures, by decreasing clearance."""
        if self._alternatives is None:
            self._alternatives = list(
                islice(self.proposal.generate_alternatives(), _MAX_STANDING_POSTURES - 1)
            )
        return [
            alternative for alternative in self._alternatives if alternative is not self.proposal
        ]

    def _write_robot(self, proposal: RobotProposal) -> None:
        """Write the robot file, which later plans use."""
        self.proposal = proposal
        text = format_robot_document(proposal, str(proposal.draft.urdf), "")
        (self.folder / self.robot_file).write_text(text, encoding="utf-8")

    def _plan_walk(self) -> SpecOutcome:
        """Plan a few steps on flat ground."""
        return self._plan_spec(
            "walks on ground", format_ground_document(self.proposal, self.robot_file)
        )

    def plan_stairs(self) -> SpecOutcome:
        """Plan a walk up two stairs, with the body pitched with the stance, or else level.

        If there is no plan in the ground posture the other standing postures are tried, then
        gentler stairs.
        """
        original, first = self.proposal, self._plan_stairs_once()
        if first.plan is not None:
            return first
        outcome = first
        for alternative in self.list_alternatives():
            self._write_robot(alternative)
            outcome = self._plan_stairs_once()
            if outcome.plan is not None:
                break
        self._write_robot(original)
        if outcome.plan is None:
            text = format_stairs_document(original, self.robot_file, gentle=True)
            outcome = self._plan_spec("walks up stairs", text)
        return first if outcome.plan is None else outcome

    def _plan_stairs_once(self) -> SpecOutcome:
        first: SpecOutcome | None = None
        for leans in (True, False):
            text = format_stairs_document(self.proposal, self.robot_file, leans)
            if first is not None and text == first.text:
                break
            outcome = self._plan_spec("walks up stairs", text)
            if outcome.plan is not None:
                return outcome
            first = first or outcome
        assert first is not None
        return first

    def plan_chimney(self, report: Report) -> SpecOutcome:
        """Plan a climb between walls and select the posture of the best plan.

        The search ends at a plan without a fall in nearly all sampled worlds, or, without samples,
        at one that keeps nearly all of its margins. If no posture leads to a plan with margins,
        postures that bend the limbs differently are tried. If none works, the outcome states why.
        """
        task = "climbs between walls"
        braces = _interleave_frictions(self.proposal.braces)[:_MAX_BRACING_POSTURES]
        planned = self._plan_bracing_postures(task, braces, format_chimney_document, report)
        targets = _MIN_MARGIN_FRACTION, TARGET_STANDING
        first, self._climbs = self._select_best(task, planned, _MAX_BRACING_PLANS, targets)
        first = self._try_larger_margins(first, report)
        return self._try_alternative_postures(
            task, first, report, _MIN_MARGIN_FRACTION, self.bracing_file, format_chimney_document
        )

    def _try_larger_margins(self, first: SpecOutcome, report: Report) -> SpecOutcome:
        """Plan with larger margins if a plan keeps all of them but falls in too many worlds."""
        best = first
        for margins in _LARGER_MARGINS:
            if (
                best.sample is None
                or best.is_good_enough(0.0)
                or best.margin_fraction < _FULL_MARGIN_FRACTION
            ):
                break
            report(f"planning: {first.what}, margins {margins}")
            text = first.text.replace("\nseed: ", f"\nmargins: {margins}\nseed: ")
            outcome = self._plan_spec(first.what, text, first.brace)
            if outcome.rank > best.rank:
                best = outcome
        return best

    def _try_alternative_postures(
        self,
        task: str,
        first: SpecOutcome,
        report: Report,
        min_margin_fraction: float,
        file: str,
        document: FormatDocument,
    ) -> SpecOutcome:
        """Try postures that bend the limbs differently, with a robot file of their own.

        first: the outcome with limbs bent as the robot stands, which stays if it keeps margins.
        """
        if first.margin_fraction > NEGLIGIBLE_MARGIN and not first.implausible:
            return first
        report(f"planning: {task}, limbs bent otherwise than it stands")
        best: SpecOutcome | None = None
        if self._bracing_alternatives is None:
            self._bracing_alternatives = propose_bracing_postures(
                self.proposal, _MAX_ALTERNATIVE_POSTURES
            )
        for alternative in self._bracing_alternatives:
            robot = format_robot_document(alternative, str(alternative.draft.urdf), "")
            (self.folder / file).write_text(robot, encoding="utf-8")
            (brace,) = alternative.braces
            text = document(alternative, file, brace)
            outcome = replace(self._plan_spec(task, text, brace), proposal=alternative)
            if best is None or outcome.rank > best.rank:
                best = outcome
            if best.is_good_enough(min_margin_fraction):
                break
        if best is None and first.plan is None:
            return replace(first, why=f"{first.why}; nor was any with its limbs bent otherwise")
        if best is None or (best.rank <= first.rank and first.text):
            return first
        return best

    def plan_wall(self, report: Report) -> SpecOutcome:
        """Plan a transition from the ground to walls; postures are selected as for climbs.

        Postures between whose walls the robot climbs well come first.
        """
        task = "goes from the ground to walls"
        targets = _WALL_MIN_MARGIN_FRACTION, _WALL_TARGET_STANDING
        braces = self._rank_braces()
        planned = self._plan_wall_trials(task, braces[:1], report)
        first, _ = self._select_best(task, planned, _MAX_WALL_PLANS, targets)
        if any(climb.plan is not None for climb in self._climbs):
            return first  # it braces with its limbs bent as it stands, so others promise little

        def document(proposal: RobotProposal, file: str, brace: LeggedPosture) -> str:
            return format_wall_document(place_on_ground(proposal, self.proposal), file, brace)

        return self._try_alternative_postures(
            task, first, report, _WALL_MIN_MARGIN_FRACTION, self.wall_bracing_file, document
        )

    def _plan_wall_trials(
        self, task: str, braces: Sequence[LeggedPosture], report: Report
    ) -> Iterator[SpecOutcome]:
        """Plan transitions to bracing postures with rises of the body, and yield their outcomes."""
        trials = ((brace, rise) for brace in braces for rise in _WALL_RISES)
        for number, (brace, rise) in enumerate(trials, 1):
            report(f"planning: {task}, trial {number}")
            text = format_wall_document(self.proposal, self.robot_file, brace, rise)
            yield self._plan_unverified(task, text, brace)

    def _rank_braces(self) -> list[LeggedPosture]:
        """Return bracing postures: those that climb by their outcomes, the unplanned, the others.

        Postures without a climb come last, because what holds nothing between walls holds nothing
        on the way there either.
        """
        tried = sorted(self._climbs, key=lambda outcome: outcome.rank, reverse=True)
        climbing = [o.brace for o in tried if o.plan is not None and o.brace is not None]
        failing = [o.brace for o in tried if o.plan is None and o.brace is not None]
        planned = {id(brace) for brace in (*climbing, *failing)}
        untried = [
            brace
            for brace in _interleave_frictions(self.proposal.braces)
            if id(brace) not in planned
        ]
        return [*climbing, *untried, *failing]

    def _plan_bracing_postures(
        self,
        task: str,
        braces: list[LeggedPosture],
        document: FormatDocument,
        report: Report,
    ) -> Iterator[SpecOutcome]:
        """Plan with bracing postures in turn and yield their outcomes."""
        for number, posture in enumerate(braces, 1):
            report(f"planning: {task}, posture {number}")
            yield self._plan_unverified(
                task, document(self.proposal, self.robot_file, posture), posture
            )

    def _select_best(
        self,
        task: str,
        outcomes: Iterable[SpecOutcome],
        max_plans: int,
        targets: tuple[float, float],
    ) -> tuple[SpecOutcome, list[SpecOutcome]]:
        """Return the best outcome up to the first that is good enough, and those up to there.

        Plans are verified once they are the best, as those of other postures are not written.

        Args:
            task: What is planned, for a robot without any posture.
            outcomes: Of postures, in their order, with plans that are not verified yet.
            max_plans: Number of plans after which no further outcome is taken.
            targets: Fraction of margins and of worlds without a fall that are good enough.
        """
        tried: list[SpecOutcome] = []
        verified: set[int] = set()  # places in `tried`
        for outcome in outcomes:
            tried.append(outcome)
            if outcome.is_good_enough(*targets):
                verified.add(len(tried) - 1)
                tried[-1] = _verify_outcome(outcome)
            num_plans = sum(o.plan is not None for o in tried)
            if tried[-1].is_good_enough(*targets) or num_plans == max_plans:
                break
            if num_plans == 0 and len(tried) == _MAX_FAILURES:
                break
            if outcome.plan is not None and num_plans > 1 and _is_stagnant(tried):
                break
        while tried:
            best = max(range(len(tried)), key=lambda place: tried[place].rank)
            if best in verified or tried[best].plan is None:
                return tried[best], tried
            verified.add(best)
            tried[best] = _verify_outcome(tried[best])
        why = f"no posture between walls was found{self.proposal.brace_failure}"
        return SpecOutcome(task, None, why), tried

    def _plan_spec(self, task: str, text: str, brace: LeggedPosture | None = None) -> SpecOutcome:
        """Plan and verify a spec; the outcome states why there is no plan."""
        return _verify_outcome(self._plan_unverified(task, text, brace))

    def _plan_unverified(
        self, task: str, text: str, brace: LeggedPosture | None = None
    ) -> SpecOutcome:
        """Plan a spec and sample worlds of its plan; the outcome states why there is no plan."""
        path = self.folder / "spec.yaml"
        path.write_text(text, encoding="utf-8")
        try:
            if text.partition("\nkind: ")[2].startswith("transition"):
                plan = plan_transition(
                    load_transition(path, _WALL_METHOD), margin_fractions=_WALL_MARGIN_FRACTIONS
                )
            else:
                plan = plan_climb(load_climb(path, _METHOD), nodes=_MAX_NODES)
        except (NoPlanFound, SpecError, UsageError) as error:
            return SpecOutcome(task, None, _summarise_failure(error), text, brace)
        return SpecOutcome(task, plan, "", text, brace, sample=self._sample_worlds(plan))


def _is_stagnant(tried: Sequence[SpecOutcome]) -> bool:
    """Return whether the last plan stands in hardly more worlds than the best one before it."""
    last = tried[-1]
    best = max(outcome.standing for outcome in tried[:-1])
    return last.sample is not None and last.standing < best + _MIN_IMPROVEMENT


def _verify_outcome(outcome: SpecOutcome) -> SpecOutcome:
    """Return the outcome with its plan verified, or without a plan and why."""
    if outcome.plan is None:
        return outcome
    verification = verify_plan(outcome.plan)
    if not verification.passed:
        why = f"the plan fails its verification: {verification.headline()}"
        return replace(outcome, plan=None, why=why, sample=None)
    return replace(outcome, implausible=verification.implausible)


def plan_proposal(
    proposal: RobotProposal,
    directory: Path,
    report: Report,
    sample_worlds: SampleWorlds = lambda plan: None,
) -> PlannedProposal:
    """Plan the specs of a proposed robot by the global method, and collect its files.

    Args:
        proposal: The proposed robot.
        directory: Where the files will be, for the paths in them.
        report: Called with a text about the present step.
        sample_worlds: Counts falls in worlds of a plan, by which postures are selected.
    """
    has_soles = proposal.prepared.soles is not None
    with tempfile.TemporaryDirectory() as folder:
        report("planning a walk on flat ground")
        trials = ProposalTrials(proposal, Path(folder), sample_worlds)
        outcomes = {"ground": trials.ground}
        if not has_soles:
            outcomes |= {"chimney": trials.plan_chimney(report), "wall": trials.plan_wall(report)}
    specs = {
        f"{trials.name}_{end}.yaml": outcome.text
        for end, outcome in outcomes.items()
        if outcome.text
    }
    alternatives = {
        f"{trials.name}_{end}.yaml": o.proposal for end, o in outcomes.items() if o.proposal
    }
    specs_of_robot = ", ".join(name for name in specs if name not in alternatives)
    files = {
        trials.robot_file: format_robot_document(
            trials.proposal, format_urdf_path(proposal, directory), specs_of_robot
        )
    } | specs
    bracing_files = {"chimney": trials.bracing_file, "wall": trials.wall_bracing_file}
    for end, file in bracing_files.items():
        if (alternative := alternatives.get(spec := f"{trials.name}_{end}.yaml")) is not None:
            files[file] = format_robot_document(
                alternative, format_urdf_path(proposal, directory), spec
            )
    brace = outcomes["chimney"].brace if "chimney" in outcomes else None
    return PlannedProposal(
        trials.name, trials.proposal, files, tuple(outcomes.values()), brace, walks=not has_soles
    )


def _summarise_failure(error: Exception) -> str:
    """Summarise a failure by its first two lines, as the second often names what is missing."""
    lines = [line.strip() for line in str(error).splitlines()[:2]]
    return "; ".join(line for line in lines if line)


def _interleave_frictions(braces: tuple[LeggedPosture, ...]) -> list[LeggedPosture]:
    """Return the best posture of each friction, the second best of each, and so on."""
    by_friction: dict[float, list[LeggedPosture]] = {}
    for brace in braces:
        by_friction.setdefault(brace.friction, []).append(brace)
    ranks = zip_longest(*by_friction.values())
    return [brace for rank in ranks for brace in rank if brace is not None]


def format_file_name(name: str) -> str:
    """Format a robot's name as a file name."""
    return re.sub(r"[^a-z0-9]+", "_", name.lower()).strip("_") or "robot"
