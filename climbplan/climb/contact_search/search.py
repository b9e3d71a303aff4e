"""Depth-first search over rounds: footholds along the guide path, the nominal ones first.

In each round every limb moves once, in the order of the gait, while the body advances along the
guide path (H. Escande et al., 2013, and S. Tonneau et al., 2018, plan contacts before and along
such a path). For each limb the candidates of `footholds.py` are checked exactly by `limb_move.py`,
and the first that passes is taken. A round that fails is tried with a shorter advance; where none
remains, the round before it is planned again. Each place of the path is left a limited number of
times, so that the effort grows in proportion to its length.
"""

from __future__ import annotations

import logging
import time
from collections import Counter
from dataclasses import dataclass, field

import numpy as np

from climbplan.arrays import Array
from climbplan.climb.contact_search.footholds import BodyPose, Foothold, FootholdFinder
from climbplan.climb.contact_search.guide_path import GuidePath
from climbplan.climb.contact_search.limb_move import LimbMove, MoveChecker, MoveRejected, Standing
from climbplan.climb.scene.climb_scene import ClimbScene

_log = logging.getLogger(__name__)

_PACES = (1.0, 0.6, 0.3)  # fractions of the longest advance of a round, in turn
_MAX_TRIED = 6  # footholds of a limb whose moves are checked
_SHRINKING = 0.9  # of an advance whose step is too long
_PLACE_FRACTION = 0.25  # of the longest step of the body: places of the path that count as one
_MAX_VISITS = 6  # times that rounds are planned from one place
_LOG_INTERVAL = 5.0  # [s]


@dataclass(frozen=True)
class PlannedRound:
    """The state after a round, and the moves in it."""

    base: BodyPose  # of the body on the guide path
    covered: float  # [m] of the path
    standing: Standing  # after the last move
    moves: tuple[LimbMove, ...] = ()


@dataclass
class _Node:
    """A round with the advances that are still to be tried after it."""

    planned: PlannedRound
    advances: list[float] = field(default_factory=list)


@dataclass(frozen=True)
class SearchResult:
    """The rounds found, and what ended the search where they do not reach the goal."""

    rounds: tuple[PlannedRound, ...]  # the start, then each round
    num_checked: int  # moves
    is_complete: bool
    stopped_by: str  # the last obstacle, where the search came furthest
    ran_out: str  # "time", "moves" or ""


class FootholdSearch:
    """The search of one scene."""

    def __init__(self, scene: ClimbScene, guide: GuidePath) -> None:
        self.scene, self.guide = scene, guide
        self.finder, self.checker = FootholdFinder(scene), MoveChecker(scene)
        self.num_checked = 0
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
                _log.info(
                    "contacts  %.2f of %.2f m", covered, self.guide.length, extra={"note": True}
                )
            node = stack[-1]
            place = int(node.planned.covered / place_size)
            if not node.advances or visits[place] >= _MAX_VISITS:
                stack.pop()
                continue
            visits[place] += 1
            advance = node.advances.pop(0)
            try:
                planned = self._plan_round(node.planned, advance, len(stack))
            except MoveRejected as rejected:
                _log.debug("round %d by %.3f m: %s", len(stack), advance, rejected)
                if len(stack) == len(furthest):
                    stopped_by = f"round {len(stack)}: {rejected}"
                continue
            stack.append(_Node(planned, self._list_advances(planned)))
            if planned.covered > furthest[-1].covered:
                furthest = [entry.planned for entry in stack]
            if planned.covered >= self.guide.length - 1e-9:
                rounds = tuple(entry.planned for entry in stack)
                return SearchResult(rounds, self.num_checked, True, "", "")
        return SearchResult(tuple(furthest), self.num_checked, False, stopped_by, ran_out)

    def can_rest(self, planned: PlannedRound) -> bool:
        """Return whether the body can go on to its place on the guide path and end there."""
        try:
            self.checker.check_way(planned.standing, planned.base)
        except MoveRejected:
            return False
        return True

    def _list_advances(self, planned: PlannedRound) -> list[float]:
        """Return the advances [m] to try after a round, without those that are the same."""
        longest = self._find_longest_advance(planned.covered)
        remaining = self.guide.length - planned.covered
        return list(dict.fromkeys(min(pace * longest, remaining) for pace in _PACES))

    def _find_longest_advance(self, covered: float) -> float:
        """Return the longest advance whose steps of the body are within their bounds [m]."""
        steps = self.scene.spec.posture.steps
        max_turn = np.deg2rad(steps.rotation_max_deg) * (1.0 - 1e-6)
        com, rpy = self.guide.interpolate(covered)
        advance = float(steps.com_max)
        while True:
            next_com, next_rpy = self.guide.interpolate(covered + advance)
            step, turn = np.linalg.norm(next_com - com), np.abs(next_rpy - rpy).max()
            if step <= steps.com_max * (1.0 - 1e-6) and turn <= max_turn:
                return advance
            advance *= _SHRINKING

    def _plan_round(self, before: PlannedRound, advance: float, number: int) -> PlannedRound:
        """Plan the moves of all limbs in one round; raise MoveRejected where one has none."""
        gait = self.scene.gait
        count = len(gait)
        covered = before.covered + advance
        is_last = covered >= self.guide.length - 1e-9
        base = BodyPose(*self.guide.interpolate(covered))
        standing = before.standing
        moves: list[LimbMove] = []
        for k, limb in enumerate(gait):
            fraction = k / count
            pose = BodyPose(
                before.base.com + fraction * (base.com - before.base.com),
                before.base.rpy + fraction * (base.rpy - before.base.rpy),
            )
            # A limb stands best where the body is half way between this move and its next
            middle = before.covered + advance * ((k + 1) / count + 0.5)
            nominal = (
                self.scene.goal.toes[limb]
                if is_last
                else self.guide.place_nominal_toe(middle, self.scene.robot.stance_body[limb])
            )
            expected = self._expect_poses(before.covered, advance, k, pose)
            max_distance = self.goal_tolerance[limb] if is_last else np.inf
            footholds = self.finder.find(limb, standing.toes[limb], nominal, expected, max_distance)
            move = self._find_move(standing, limb, nominal, footholds, pose, number)
            moves.append(move)
            standing = move.after
        if is_last:
            try:
                self.checker.check_way(standing, base)
            except MoveRejected as rejected:
                raise MoveRejected(f"{rejected} on the way to the goal") from None
        return PlannedRound(base, covered, standing, tuple(moves))

    def _expect_poses(
        self, covered: float, advance: float, k: int, pose: BodyPose
    ) -> list[BodyPose]:
        """Return the body's poses at the k-th move of a round and at all until the limb's next.

        The shift over the standing limbs is that of each limb's last move.
        """
        gait, shifts = self.scene.gait, self.checker.shifts
        count = len(gait)
        poses = [BodyPose(pose.com + shifts[gait[k]], pose.rpy)]
        for later in range(k + 1, k + count + 1):
            com, rpy = self.guide.interpolate(covered + advance * later / count)
            poses.append(BodyPose(com + shifts[gait[later % count]], rpy))
        return poses

    def _find_move(
        self,
        standing: Standing,
        limb: int,
        nominal: Array,
        footholds: list[Foothold],
        pose: BodyPose,
        number: int,
    ) -> LimbMove:
        """Return the first move that passes all checks; raise the first failure without one."""
        failure: MoveRejected | None = None
        for foothold in footholds[:_MAX_TRIED]:
            self.num_checked += 1
            try:
                return self.checker.check(standing, limb, foothold, pose, number)
            except MoveRejected as rejected:
                failure = failure or rejected
                if rejected.whatever_foothold:
                    break
        if failure is not None:
            raise failure
        name = self.scene.robot.limb_names[limb]
        where = ", ".join(f"{v:.2f}" for v in nominal)
        self.num_checked += 1
        raise MoveRejected(f"{name} has no foothold within its reach and clear about ({where})")
