"""A proposed robot put to the test: over ground, up stairs, between walls, from ground to walls."""

from __future__ import annotations

import re
import tempfile
from collections.abc import Callable
from dataclasses import dataclass, replace
from itertools import islice
from pathlib import Path

from climbplan.climb.check.verification import verification_of
from climbplan.climb.planner.planner import plan_climb
from climbplan.climb.proposed.outcome import NONE_KEPT, Outcome, SampleWorlds
from climbplan.climb.schema.loading import load_climb
from climbplan.climb.schema.transition_loading import load_transition
from climbplan.climb.transition.planner import plan_transition
from climbplan.errors import NoPlanFound, SpecError, UsageError
from climbplan.robots.urdf.proposal.bracing_search import place_on_ground, propose_bracing_postures
from climbplan.robots.urdf.proposal.postures import Posture
from climbplan.robots.urdf.proposal.prepared_robot import Proposal
from climbplan.robots.urdf.proposal.robot_document import format_robot_document, format_urdf_path
from climbplan.robots.urdf.proposal.spec_documents import (
    format_chimney_document,
    format_ground_document,
    format_stairs_document,
    format_wall_document,
)

_STANDINGS = 4  # standing postures that are planned with
_TRIED = 8  # bracing postures that are planned with
_ENOUGH = 0.9  # of its margins: plans that keep less may fall
_ALL_KEPT = 0.95  # of its margins: motors have something left to press with
_LARGER_MARGINS = ("{slip: 0.5, friction: 0.16}", "{slip: 0.6, friction: 0.24, pressure: 0.15}")
_BENT = 6  # postures that bend limbs otherwise than the robot stands
_WALL_ENOUGH = 0.5  # of a transition's, whose stances are fewer to choose from
_WALL_PLANS = 3  # transitions that are planned to the end, at most
# Work decides what is found, the same on any machine under any load; the clock only caps
_NODES = 2000  # of each search for postures by branch and bound; most take one
_CAP = 3600.0  # [s]
_METHOD = ("solver.method=micp", f"solver.time_limit={_CAP}")
# Motions of sequences take ten seconds and more each
_WALL_SEQUENCES = 6  # of a transition, that are planned to the end
_WALL_TRIED = 5  # bracing postures that transitions are planned to
_WALL_METHOD = (
    "solver.method=enumerate",
    f"solver.time_limit={_CAP}",
    f"search.max_planned={_WALL_SEQUENCES}",
)

Told = Callable[[str], None]
Document = Callable[[Proposal, str, Posture], str]  # of a robot, its file, and how it braces


@dataclass(frozen=True)
class Proposed:
    """Files by name, and what became of their specs."""

    name: str
    found: Proposal  # in the standing posture that was settled on
    files: dict[str, str]
    outcomes: tuple[Outcome, ...]  # of a walk on ground first
    brace: Posture | None  # between walls that it climbs
    walks: bool  # whether a walk at speed may be asked of it


class Trials:
    """Specs of a proposed robot, planned in a folder; a folder is for one robot."""

    def __init__(
        self, found: Proposal, folder: Path, sample_worlds: SampleWorlds = lambda plan: None
    ) -> None:
        """Settle on the roomiest of its standing postures in which it walks on ground.

        Args:
            found: The proposed robot.
            folder: Where robot files and specs are written; of this robot alone.
            sample_worlds: Counts falls in worlds of a plan, by which postures are chosen.
        """
        self.folder = folder
        self._sample_worlds = sample_worlds
        self.name = file_name(found.name)
        self.robot_file = f"{self.name}.yaml"
        self.bracing_file = f"{self.name}_bracing.yaml"
        self.wall_bracing_file = f"{self.name}_wall_bracing.yaml"
        self._stand(found)
        self._others: list[Proposal] | None = None
        self.ground = first = self._walk()
        if first.plan is not None:
            return
        for other in self.others():
            self._stand(other)
            self.ground = self._walk()
            if self.ground.plan is not None:
                return
        self._stand(found)
        self.ground = first

    def others(self) -> list[Proposal]:
        """The robot in the other standing postures that are tried, roomiest first."""
        if self._others is None:
            self._others = list(islice(self.found.generate_alternatives(), _STANDINGS - 1))
        return [one for one in self._others if one is not self.found]

    def _stand(self, found: Proposal) -> None:
        """Write the robot file, for what is planned from now on."""
        self.found = found
        text = format_robot_document(found, str(found.draft.urdf), "")
        (self.folder / self.robot_file).write_text(text, encoding="utf-8")

    def _walk(self) -> Outcome:
        """A few steps on flat ground."""
        return self._outcome("walks on ground", format_ground_document(self.found, self.robot_file))

    def stairs(self) -> Outcome:
        """Up two stairs, the body pitching with the stance, or else level.

        Where the robot does not as it stands on the ground, in its other standing postures; where
        it does in none, up gentler stairs.
        """
        settled, first = self.found, self._stairs()
        if first.plan is not None:
            return first
        found = first
        for other in self.others():
            self._stand(other)
            found = self._stairs()
            if found.plan is not None:
                break
        self._stand(settled)
        if found.plan is None:
            text = format_stairs_document(settled, self.robot_file, gentle=True)
            found = self._outcome("walks up stairs", text)
        return first if found.plan is None else found

    def _stairs(self) -> Outcome:
        first: Outcome | None = None
        for leans in (True, False):
            text = format_stairs_document(self.found, self.robot_file, leans)
            if first is not None and text == first.text:
                break
            one = self._outcome("walks up stairs", text)
            if one.plan is not None:
                return one
            first = first or one
        assert first is not None
        return first

    def chimney(self, report: Told) -> Outcome:
        """Up between walls: in the first posture whose plan stands in nearly all sampled worlds.

        Where no worlds are sampled, in the first whose plan keeps nearly all of its margins. Else
        in the one that stands in, or keeps, most; where none leads to a plan, or to one that keeps
        none of its margins, in postures that bend its limbs otherwise than it stands; and where
        none of these does, the best by the proposal, with its refusal.
        """
        what, most = "climbs between walls", (_TRIED, _TRIED)
        first = self._braced(what, format_chimney_document, report, _ENOUGH, most)
        first = self._with_larger_margins(first, report)
        return self._bent(what, first, report, _ENOUGH, self.bracing_file, format_chimney_document)

    def _with_larger_margins(self, first: Outcome, report: Told) -> Outcome:
        """The plan with larger margins where it keeps all of them and falls in too many worlds."""
        best = first
        for margins in _LARGER_MARGINS:
            if best.sample is None or best.good_enough(0.0) or best.share < _ALL_KEPT:
                break
            report(f"planning: {first.what}, margins {margins}")
            text = first.text.replace("\nseed: ", f"\nmargins: {margins}\nseed: ")
            one = self._outcome(first.what, text, first.brace)
            if one.rank > best.rank:
                best = one
        return best

    def _bent(
        self,
        what: str,
        first: Outcome,
        report: Told,
        enough: float,
        file: str,
        document: Document,
    ) -> Outcome:
        """In postures of a robot file of their own; first: bent as the robot stands.

        That stays where it is planned, unless toes keep hold with none of their margins.
        """
        if first.share > NONE_KEPT and not first.implausible:
            return first
        report(f"planning: {what}, limbs bent otherwise than it stands")
        best: Outcome | None = None
        for found in propose_bracing_postures(self.found, _BENT):
            robot = format_robot_document(found, str(found.draft.urdf), "")
            (self.folder / file).write_text(robot, encoding="utf-8")
            (brace,) = found.braces
            text = document(found, file, brace)
            one = replace(self._outcome(what, text, brace), bent=found)
            if best is None or one.rank > best.rank:
                best = one
            if best.good_enough(enough):
                break
        if best is None and first.plan is None:
            return replace(first, why=f"{first.why}; nor was any with its limbs bent otherwise")
        if best is None or (best.rank <= first.rank and first.text):
            return first
        return best

    def wall(self, report: Told) -> Outcome:
        """From the ground to walls, chosen likewise."""
        what = "goes from the ground to walls"
        most = _WALL_PLANS, _WALL_TRIED
        first = self._braced(what, format_wall_document, report, _WALL_ENOUGH, most)

        def document(found: Proposal, file: str, brace: Posture) -> str:
            return format_wall_document(place_on_ground(found, self.found), file, brace)

        return self._bent(what, first, report, _WALL_ENOUGH, self.wall_bracing_file, document)

    def _braced(
        self,
        what: str,
        document: Document,
        report: Told,
        enough: float,
        most: tuple[int, int],
    ) -> Outcome:
        """most: plans that are made, and postures that are planned with."""
        best: Outcome | None = None
        planned = 0
        plans, postures = most
        for number, posture in enumerate(_varied(self.found.braces)[:postures], 1):
            report(f"planning: {what}, posture {number}")
            one = self._outcome(what, document(self.found, self.robot_file, posture), posture)
            planned += one.plan is not None
            if best is None or one.rank > best.rank:
                best = one
            if best.good_enough(enough) or planned == plans:
                break
        if best is not None:
            return best
        why = f"no posture between walls was found{self.found.brace_failure}"
        return Outcome(what, None, why)

    def _outcome(self, what: str, text: str, brace: Posture | None = None) -> Outcome:
        """The verified plan of a spec, or why there is none."""
        path = self.folder / "spec.yaml"
        path.write_text(text, encoding="utf-8")
        try:
            if text.partition("\nkind: ")[2].startswith("transition"):
                plan = plan_transition(load_transition(path, _WALL_METHOD))
            else:
                plan = plan_climb(load_climb(path, _METHOD), nodes=_NODES)
        except (NoPlanFound, SpecError, UsageError) as error:
            return Outcome(what, None, _why(error), text, brace)
        verification = verification_of(plan)
        if not verification.passed:
            why = f"the plan fails its verification: {verification.headline()}"
            return Outcome(what, None, why, text, brace)
        odd = verification.implausible
        return Outcome(
            what, plan, "", text, brace, sample=self._sample_worlds(plan), implausible=odd
        )


def planned_proposal(
    found: Proposal,
    directory: Path,
    report: Told,
    sample_worlds: SampleWorlds = lambda plan: None,
) -> Proposed:
    """Specs of a proposed robot, each planned by the global method before it is written.

    Paths in the files are for `directory`; report: told what is being done. sample_worlds: counts
    falls in worlds of a plan, by which postures are chosen.
    """
    soled = found.prepared.soles is not None
    with tempfile.TemporaryDirectory() as folder:
        report("planning a walk on flat ground")
        trials = Trials(found, Path(folder), sample_worlds)
        outcomes = {"ground": trials.ground}
        if not soled:
            outcomes |= {"chimney": trials.chimney(report), "wall": trials.wall(report)}
    specs = {
        f"{trials.name}_{end}.yaml": outcome.text
        for end, outcome in outcomes.items()
        if outcome.text
    }
    bent = {f"{trials.name}_{end}.yaml": o.bent for end, o in outcomes.items() if o.bent}
    own = ", ".join(name for name in specs if name not in bent)
    files = {
        trials.robot_file: format_robot_document(
            trials.found, format_urdf_path(found, directory), own
        )
    } | specs
    own_files = {"chimney": trials.bracing_file, "wall": trials.wall_bracing_file}
    for end, file in own_files.items():
        if (other := bent.get(spec := f"{trials.name}_{end}.yaml")) is not None:
            files[file] = format_robot_document(other, format_urdf_path(found, directory), spec)
    brace = outcomes["chimney"].brace if "chimney" in outcomes else None
    return Proposed(
        trials.name, trials.found, files, tuple(outcomes.values()), brace, walks=not soled
    )


def _why(error: Exception) -> str:
    """The first two lines of a refusal: what is lacking often stands in the second."""
    lines = [line.strip() for line in str(error).splitlines()[:2]]
    return "; ".join(line for line in lines if line)


def _varied(braces: tuple[Posture, ...]) -> list[Posture]:
    """The best of each friction in turn, so that postures on rougher walls have their chance."""
    by_friction: dict[float, list[Posture]] = {}
    for brace in braces:
        by_friction.setdefault(brace.friction, []).append(brace)
    return [brace for own in by_friction.values() for brace in own[: _TRIED // len(by_friction)]]


def file_name(name: str) -> str:
    """A robot's name as one of a file."""
    return re.sub(r"[^a-z0-9]+", "_", name.lower()).strip("_") or "robot"
