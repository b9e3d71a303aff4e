"""Depth-first search over rounds: footholds along the guide path, the nominal ones first.

In each round every limb moves once, in the order of the gait, while the body advances along the
guide path (H. Escande et al., 2013, and S. Tonneau et al., 2018, plan contacts before and along
such a path). For each limb the candidates of `footholds.py` are checked exactly by `limb_move.py`,
and the first that passes is taken. On slopes and stairs the body takes a fraction of the ground's
inclination: of hind legs that bend forward, the shanks would meet the edges of steps otherwise.

Where a limb that stands stops a later move, that limb is placed elsewhere (conflict-directed
backjumping). A round that fails is tried with other inclinations and shorter advances; where none
remains, the round before it is planned again. Each place of the path is left a limited number of
times, so that the effort grows in proportion to its length.
"""

from __future__ import annotations

import logging
import time
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, field, replace

import numpy as np

from climbplan.arrays import Array
from climbplan.climb.contact_search.footholds import BodyPose, Foothold, FootholdFinder
from climbplan.climb.contact_search.guide_path import build_guide_path
from climbplan.climb.contact_search.limb_move import LimbMove, MoveChecker, MoveRejected, Standing
from climbplan.climb.contact_search.suitability import starts_on_ground
from climbplan.climb.scene.climb_scene import ClimbScene
from climbplan.errors import Remedy

_log = logging.getLogger(__name__)

_PACES = (1.0, 0.6, 0.3)  # fractions of the longest advance of a round, in turn
_INCLINATIONS = (0.6, 0.3, 1.0)  # fractions of the ground's angles that the body takes, in turn
_MAX_TRIED = 6  # footholds of a limb whose moves are checked
_MAX_REVISED = 4  # footholds of a round that are chosen again for a later limb of it
_MIN_DISTANCE = 0.05  # [m] of a foothold that is chosen again from the one before
_SHRINKING = 0.9  # of an advance whose step is too long
_MIN_ADVANCE_FRACTION = 0.1  # of the longest step of the body
_PLACE_FRACTION = 0.25  # of the longest step of the body: places of the path that count as one
_MAX_VISITS = 8  # times that rounds are planned from one place
_LOG_INTERVAL = 5.0  # [s]


@dataclass(frozen=True)
class PlannedRound:
    """The state after a round, and the moves in it."""

    base: BodyPose  # of the body on the guide path
    covered: float  # [m] of the path
    standing: Standing  # after the last move
    moves: tuple[LimbMove, ...] = ()
    guide: int = 0  # the guide path that it follows


@dataclass(frozen=True)
class _Advance:
    """A way to go on after a round: along a guide path by a distance."""

    guide: int
    distance: float  # [m]


@dataclass
class _Round:
    """A round that is planned, move by move."""

    before: PlannedRound
    base: BodyPose  # at its end
    advance: _Advance
    number: int  # from 1 on
    is_last: bool
    moves: list[LimbMove] = field(default_factory=list)  # so far
    choices: list[Iterator[LimbMove]] = field(default_factory=list)  # of the limbs so far
    num_revised: int = 0  # moves that were withdrawn

    def interpolate(self, fraction: float) -> BodyPose:
        """Return the body's pose after a fraction of the round, without shifts."""
        first, last = self.before.base, self.base
        return BodyPose(
            first.com + fraction * (last.com - first.com),
            first.rpy + fraction * (last.rpy - first.rpy),
        )


@dataclass
class _Node:
    """A round with the advances that are still to be tried after it."""

    planned: PlannedRound
    advances: list[_Advance]
    made_by: _Round | None = None  # None for the start


@dataclass(frozen=True)
class SearchResult:
    """The rounds found, and what ended the search where they do not reach the goal."""

    rounds: tuple[PlannedRound, ...]  # the start, then each round
    num_checked: int  # moves
    is_complete: bool
    stopped_by: str  # the last obstacle, where the search came furthest
    ran_out: str  # "time", "moves" or ""
    remedies: tuple[Remedy, ...] = ()  # changes that may help there


class FootholdSearch:
    """The search of one scene."""

    def __init__(self, scene: ClimbScene) -> None:
        self.scene = scene
        inclinations = _INCLINATIONS if starts_on_ground(scene) else _INCLINATIONS[:1]
        # All lead along the same places
        self.guides = [build_guide_path(scene, inclination) for inclination in inclinations]
        self.finder, self.checker = FootholdFinder(scene), MoveChecker(scene)
        self.num_checked = 0
        self.length = self.guides[0].length
        # Where the spec states no toe at the goal, the nearest place that fits is one
        goal, names = scene.spec.task.goal, scene.robot.limb_names
        tolerance = float(goal.tolerance) * (1.0 - 1e-6)
        self.goal_tolerance = [tolerance if name in goal.toes else np.inf for name in names]

    def run(self, deadline: float, max_moves: float = np.inf) -> SearchResult:
        """Search from the start to the goal.

        Args:
            deadline: `time.monotonic` [s] at which the search ends.
            max_moves: Largest number of moves that are checked.
        """
        start = self.scene.start
        pose = BodyPose(start.com, start.rpy)
        first = PlannedRound(pose, 0.0, Standing(pose, start.toes, start.region))
        stack = [_Node(first, self._list_advances(first))]
        furthest, stopped_by, ran_out = [first], "", ""
        remedies: tuple[Remedy, ...] = ()
        visits: Counter[int] = Counter()
        place_size = _PLACE_FRACTION * float(self.scene.spec.posture.steps.com_max)
        next_log = time.monotonic() + _LOG_INTERVAL
        while stack:
            now = time.monotonic()
            if now > deadline or self.num_checked >= max_moves:
                ran_out = "time" if now > deadline else "moves"
                break
            if now > next_log:
                next_log = now + _LOG_INTERVAL
                covered = stack[-1].planned.covered
                _log.info("contacts  %.2f of %.2f m", covered, self.length, extra={"note": True})
            node = stack[-1]
            place = int(node.planned.covered / place_size)
            if not node.advances or visits[place] >= _MAX_VISITS:
                stack.pop()
                continue
            visits[place] += 1
            next_round = self._begin_round(node.planned, node.advances.pop(0), len(stack))
            try:
                planned = self._plan_round(next_round)
            except MoveRejected as rejected:
                _log.debug(
                    "round %d by %.3f m: %s", len(stack), next_round.advance.distance, rejected
                )
                if len(stack) == len(furthest):
                    stopped_by = f"round {len(stack)}: {rejected}"
                    remedies = rejected.remedies
                if not rejected.whatever_foothold or next_round.moves or node.made_by is None:
                    continue
                # Before any limb moves: however far the body goes on, this round does not begin
                stack.pop()
                revised = self._revise_round(node.made_by, rejected.by_limb)
                if revised is None:
                    continue
                planned, next_round = revised, node.made_by
            stack.append(_Node(planned, self._list_advances(planned), next_round))
            if planned.covered > furthest[-1].covered:
                furthest = [entry.planned for entry in stack]
            if planned.covered >= self.length - 1e-9:
                rounds = tuple(entry.planned for entry in stack)
                return SearchResult(rounds, self.num_checked, True, "", "")
        return SearchResult(tuple(furthest), self.num_checked, False, stopped_by, ran_out, remedies)

    def can_rest(self, planned: PlannedRound) -> bool:
        """Return whether the body can go on to its place on the guide path and end there."""
        try:
            self.checker.check_way(planned.standing, planned.base)
        except MoveRejected:
            return False
        return True

    def _list_advances(self, planned: PlannedRound) -> list[_Advance]:
        """Return the advances to try after a round, without those that are the same.

        The longest ones come first, along the path of that round before others.
        """
        remaining = self.length - planned.covered
        other_guides = [g for g in range(len(self.guides)) if g != planned.guide]
        longest = {
            g: self._find_longest_advance(planned, g) for g in (planned.guide, *other_guides)
        }
        tried = [(pace, planned.guide) for pace in _PACES]
        tried[1:1] = [(_PACES[0], guide) for guide in other_guides]
        tried += [(pace, guide) for pace in _PACES[1:] for guide in other_guides]
        advances = [
            _Advance(guide, min(pace * longest[guide], remaining))
            for pace, guide in tried
            if longest[guide] > 0
        ]
        return list(dict.fromkeys(advances))

    def _find_longest_advance(self, planned: PlannedRound, guide: int) -> float:
        """Return the longest advance [m] with a step of the body within its bounds; 0 for none."""
        steps = self.scene.spec.posture.steps
        max_turn = np.deg2rad(steps.rotation_max_deg) * (1.0 - 1e-6)
        base, advance = planned.base, float(steps.com_max)
        while advance > _MIN_ADVANCE_FRACTION * steps.com_max:
            com, rpy = self.guides[guide].interpolate(planned.covered + advance)
            step, turn = np.linalg.norm(com - base.com), np.abs(rpy - base.rpy).max()
            if step <= steps.com_max * (1.0 - 1e-6) and turn <= max_turn:
                return advance
            advance *= _SHRINKING
        return 0.0

    def _begin_round(self, before: PlannedRound, advance: _Advance, number: int) -> _Round:
        """Return a round without moves, with the body's pose at its end."""
        covered = before.covered + advance.distance
        base = BodyPose(*self.guides[advance.guide].interpolate(covered))
        return _Round(before, base, advance, number, covered >= self.length - 1e-9)

    def _plan_round(self, next_round: _Round) -> PlannedRound:
        """Plan the moves that a round still needs; raise MoveRejected where one has none.

        Where a limb cannot be moved because of one that has moved in the same round, that one is
        moved to another foothold.
        """
        moves, choices = next_round.moves, next_round.choices
        while len(moves) < len(self.scene.gait):
            k = len(moves)
            if len(choices) == k:
                standing = moves[-1].after if moves else next_round.before.standing
                choices.append(self._generate_moves(next_round, k, standing))
            try:
                moves.append(next(choices[k]))
            except MoveRejected as rejected:
                if not self._withdraw_move(next_round, rejected.by_limb):
                    raise
        if next_round.is_last:
            try:
                self.checker.check_way(moves[-1].after, next_round.base)
            except MoveRejected as rejected:
                raise MoveRejected(f"{rejected} on the way to the goal") from None
        covered = next_round.before.covered + next_round.advance.distance
        guide = next_round.advance.guide
        return PlannedRound(next_round.base, covered, moves[-1].after, tuple(moves), guide)

    def _withdraw_move(self, next_round: _Round, limb: int | None) -> bool:
        """Withdraw a limb's move in a round, and those after it; return False where it has none."""
        positions = [m for m in range(len(next_round.moves)) if self.scene.gait[m] == limb]
        if not positions or next_round.num_revised == _MAX_REVISED:
            return False
        next_round.num_revised += 1
        del next_round.moves[positions[0] :], next_round.choices[positions[0] + 1 :]
        return True

    def _revise_round(self, next_round: _Round, limb: int | None) -> PlannedRound | None:
        """Return a planned round with a limb on another foothold; None where there is none."""
        if not self._withdraw_move(next_round, limb):
            return None
        try:
            return self._plan_round(next_round)
        except MoveRejected:
            return None

    def _generate_moves(self, next_round: _Round, k: int, standing: Standing) -> Iterator[LimbMove]:
        """Yield moves of the k-th limb that pass all checks, then raise why there are no more."""
        limb = self.scene.gait[k]
        pose, nominal = (
            next_round.interpolate(k / len(self.scene.gait)),
            self._place_nominal(next_round, k),
        )
        max_distance = self.goal_tolerance[limb] if next_round.is_last else np.inf
        expected = self._expect_poses(next_round, k, pose)
        footholds = self.finder.find(limb, standing.toes[limb], nominal, expected, max_distance)
        failure: MoveRejected | None = None
        refused: list[Foothold] = []  # that passed, but not what came later
        for foothold in footholds[:_MAX_TRIED]:
            if any(np.linalg.norm(foothold.point - r.point) < _MIN_DISTANCE for r in refused):
                continue
            self.num_checked += 1
            try:
                move = self.checker.check(standing, limb, foothold, pose, next_round.number)
            except MoveRejected as rejected:
                failure = failure or rejected
                if rejected.whatever_foothold:
                    break
                continue
            yield move
            refused.append(foothold)
        if failure is not None:
            raise failure
        self.num_checked += 1
        name, where = self.scene.robot.limb_names[limb], ", ".join(f"{v:.2f}" for v in nominal)
        raise MoveRejected(
            f"{name} has no{' other' if refused else ''} foothold within its reach and clear about "
            f"({where})",
            self.finder.suggest_longer_steps(limb, standing.toes[limb], nominal),
        )

    def _place_nominal(self, next_round: _Round, k: int) -> Array:
        """Return the nominal toe (3,) of the k-th limb of a round."""
        limb = self.scene.gait[k]
        if next_round.is_last:
            return np.asarray(self.scene.goal.toes[limb])
        # A limb stands best where the body is half way between this move and its next
        fraction = (k + 1) / len(self.scene.gait) + 0.5
        middle = next_round.before.covered + next_round.advance.distance * fraction
        guide = self.guides[next_round.advance.guide]
        return guide.place_nominal_toe(middle, self.scene.robot.stance_body[limb])

    def _expect_poses(self, next_round: _Round, k: int, pose: BodyPose) -> list[BodyPose]:
        """Return the body's poses at the k-th move of a round and at all until the limb's next.

        The shift over the standing limbs is that of each limb's last move.
        """
        gait, shifts = self.scene.gait, self.checker.shifts
        count, guide = len(gait), self.guides[next_round.advance.guide]
        poses = [BodyPose(pose.com + shifts[gait[k]], pose.rpy)]
        for later in range(k + 1, k + count + 1):
            if later < count:
                expected = next_round.interpolate(later / count)
            else:
                distance = next_round.advance.distance * later / count
                expected = BodyPose(*guide.interpolate(next_round.before.covered + distance))
            poses.append(replace(expected, com=expected.com + shifts[gait[later % count]]))
        return poses
