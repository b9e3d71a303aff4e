"""All contact sequences of a number of rounds: a search over stance sets.

A state is a foothold for every limb. In a round some limbs move to their next foothold while the
others hold the body, which stands still at a pose; then the body goes to its next pose. A round
is possible at a pose if every limb reaches its old and new footholds from there and the limbs that
stay find admissible forces. The best ways of a sequence through the poses: `pose_ways.py`.
"""

from __future__ import annotations

import itertools
import time
from collections.abc import Iterator
from dataclasses import dataclass, field

import numpy as np

from climbplan.arrays import Array, BoolArray
from climbplan.climb.plan.climb_plan import sequence_name
from climbplan.climb.transition.footholds import (
    GOAL,
    START,
    Poses,
    footholds_of,
    poses_of,
    reach_of,
)
from climbplan.climb.transition.pose_ways import (
    Sequence,
    State,
    cheapest_way,
    stance_of_move,
    with_friction,
)
from climbplan.climb.transition.scene import TransitionScene
from climbplan.climb.transition.stances import LIFTED, Laboratory, stance_forces
from climbplan.errors import LimitReached

_LEVEL = 1e-9  # [m] and [rad] that count for nothing
_BATCH = 5000  # force problems between two looks at the clock


@dataclass
class Tally:
    """How much was looked at."""

    stances: int = 0  # stance sets with forces asked for
    problems: int = 0  # force problems: stance sets at poses
    truncated: bool = False  # more sequences than asked for
    late: bool = False  # time was up before all were listed


@dataclass
class Search:
    """The search on one scene; forces are solved once for a stance and kept."""

    scene: TransitionScene
    forces: bool = True  # False: kinematics only
    deadline: float = np.inf  # in `time.monotonic` seconds
    lab: Laboratory = field(init=False)
    tally: Tally = field(default_factory=Tally)
    beside: Poses | None = None  # poses to look at beside those of the grid
    _clear: dict[State, BoolArray] = field(default_factory=dict)  # state -> (B,) no limbs meet
    _use: dict[State, Array] = field(default_factory=dict)  # stance -> (B,) 1 / S_tau

    def __post_init__(self) -> None:
        footholds, poses = footholds_of(self.scene), poses_of(self.scene, self.beside)
        self.lab = Laboratory(self.scene, footholds, poses, reach_of(self.scene, footholds, poses))
        com = poses.com
        steps = self.scene.spec.posture.steps
        apart = np.linalg.norm(com[:, None] - com[None], axis=-1)
        turned = np.abs(poses.rpy[:, None] - poses.rpy[None]).max(axis=-1)
        far = (apart > steps.com_max + 1e-9) | (turned > np.deg2rad(steps.rotation_max_deg) + 1e-9)
        weights = self.scene.spec.posture.weights
        turn = np.sum((poses.rpy[:, None] - poses.rpy[None]) ** 2, axis=-1)
        self.step_max = toe_step_limits(self.scene)
        # Where the body may be at the first lift: level with its start, turned like it
        off = com - com[0]
        level = (np.abs(off[:, 2]) < _LEVEL) & (
            np.abs(poses.rpy - poses.rpy[0]).max(axis=1) < _LEVEL
        )
        near = level & (np.linalg.norm(off, axis=1) <= max(steps.shift_max, _LEVEL))
        self.first = np.where(near, weights.com * np.sum(off**2, axis=1), np.inf)
        self.step_cost = np.where(far, np.inf, weights.com * apart**2 + weights.rotation * turn)

    def sequences(self) -> list[Sequence]:
        """All sequences of the spec's rounds, best first by the spec's ranking.

        Of sequences that move the same limbs in the same rounds the cheapest stands for all.
        Raises LimitReached where time is up before any is known; later the list is cut short.
        """
        self._explore()
        best: dict[bytes, Sequence] = {}
        most = 20 * self.scene.spec.search.most
        for number, states in enumerate(self._paths()):
            self.tally.late = bool(best) and self._late()
            if number == most or self.tally.late:
                self.tally.truncated = True
                break
            uses = [self.uses(j, a, b) for j, (a, b) in enumerate(itertools.pairwise(states))]
            found = cheapest_way(self.lab, states, uses, self.step_cost, self.first)
            if found is None:
                continue
            key = found.moved.tobytes()
            if key not in best or found.cost < best[key].cost:
                best[key] = found
        listed = sorted(best.values(), key=lambda s: s.cost)[: self.scene.spec.search.most]
        self.tally.truncated |= len(best) > len(listed)
        if self.forces:
            listed = with_friction(self.lab, listed)
        rank = self.scene.spec.search.rank
        if rank == "torque":
            listed.sort(key=lambda s: -s.safety_torque)
        elif rank == "friction":
            listed.sort(key=lambda s: -s.safety_friction)
        return listed

    def stances(self) -> list[State]:
        """Stance sets of all rounds that are possible, those of most standing limbs first."""
        found = {
            stance_of_move(state, after)
            for edges in self._edges.values()
            for state, following in edges.items()
            for after in following
        }
        return sorted(found, key=lambda stance: (stance.count(LIFTED), stance))

    def name(self, sequence: Sequence) -> str:
        """Such as "3-3: RF RM LR | RR LM LF"."""
        return sequence_name(sequence.moved, self.scene.robot.limb_names)

    def _late(self) -> bool:
        return time.monotonic() > self.deadline

    def _require_time(self, number: int) -> None:
        """Raises LimitReached once time is up."""
        if self._late():
            looked = f"{self.tally.problems} force problems solved, round {number + 1} not finished"
            raise LimitReached(
                f"time limit in the search over stance sets: {looked}; a sequence asked for "
                "(`task.sequence`), fewer rounds or `search.between: boxes` make it smaller"
            )

    # States and moves

    def _initial(self) -> State:
        real = self.lab.footholds.real[:, START]
        return tuple(START if r else GOAL for r in real)

    def _moves(self, state: State, number: int) -> Iterator[State]:
        """States after round `number`, as far as the goal can be reached in the rounds left."""
        task = self.scene.spec.task
        rounds_left = task.rounds - number
        most = len(state) - task.supporting
        for limbs in self._movers(state, number):
            choices = [self._targets(state, i, rounds_left) for i in limbs]
            for targets in itertools.product(*choices):
                after = list(state)
                for limb, target in zip(limbs, targets, strict=True):
                    after[limb] = target
                short = sum(t != GOAL for t in after)
                if short <= most * (rounds_left - 1):
                    yield tuple(after)

    def _movers(self, state: State, number: int) -> Iterator[tuple[int, ...]]:
        """Sets of limbs that may move in a round: as asked for, none that is at its goal."""
        task, names = self.scene.spec.task, self.scene.robot.limb_names
        waiting = [i for i in range(len(state)) if state[i] != GOAL]
        if task.limbs:
            limbs = tuple(names.index(name) for name in task.limbs[number])
            if all(i in waiting for i in limbs):
                yield limbs
            return
        most = len(state) - task.supporting
        for size in [task.moving[number]] if task.moving else range(1, most + 1):
            yield from itertools.combinations(waiting, size)

    def _targets(self, state: State, limb: int, rounds_left: int) -> list[int]:
        """Footholds that a limb may step to: its goal, or one between if rounds are left for it."""
        targets = [GOAL]
        holds = self.lab.footholds
        if state[limb] == START and rounds_left > 1:
            targets += [c for c in range(2, holds.count) if holds.real[limb, c]]
        steps = np.linalg.norm(holds.toe[limb, targets] - holds.toe[limb, state[limb]], axis=1)
        return [c for c, step in zip(targets, steps, strict=True) if step <= self.step_max[limb]]

    def _layers(self) -> Iterator[tuple[int, dict[State, list[State]]]]:
        """Round by round the possible moves from states reached so far."""
        task = self.scene.spec.task
        current = {self._initial()}
        for number in range(task.rounds):
            moves: dict[State, list[State]] = {}
            for state in current:
                self._require_time(number)
                moves[state] = list(self._moves(state, number))
            yield number, moves
            current = {
                after
                for state, following in self._edges.get(number, {}).items()
                for after in following
                if state in moves
            }

    def _explore(self) -> None:
        """Find all rounds that are possible at some pose, stance sets solved batch by batch."""
        self._edges: dict[int, dict[State, list[State]]] = {}
        for number, moves in self._layers():
            self._solve(number, moves)
            self._edges[number] = {
                state: [a for a in following if np.isfinite(self.uses(number, state, a)).any()]
                for state, following in moves.items()
            }

    def _solve(self, number: int, moves: dict[State, list[State]]) -> None:
        """Forces of all stances of a round that are not known yet."""
        if not self.forces:
            return
        wanted: dict[State, BoolArray] = {}
        for state, following in moves.items():
            for after in following:
                stance = stance_of_move(state, after)
                at = self._reachable(number, state, after)
                if stance in self._use:
                    at = at & np.isnan(self._use[stance])
                if at.any():
                    wanted[stance] = wanted.get(stance, np.zeros(len(at), bool)) | at
        if not wanted:
            return
        pairs = [(stance, b) for stance, at in wanted.items() for b in np.flatnonzero(at)]
        stances = np.array([stance for stance, _ in pairs], np.int64)
        poses = np.array([b for _, b in pairs], np.int64)
        found = np.empty(len(pairs))
        for first in range(0, len(pairs), _BATCH):
            self._require_time(number)
            rows = slice(first, first + _BATCH)
            found[rows] = stance_forces(self.lab, stances[rows], poses[rows]).use
        self.tally.problems += len(pairs)
        self.tally.stances += len(wanted.keys() - self._use.keys())
        for (stance, b), use in zip(pairs, found, strict=True):
            self._use.setdefault(stance, np.full(self.lab.poses.count, np.nan))[b] = use

    def _reachable(self, number: int, state: State, after: State) -> BoolArray:
        """(B,) poses from which all limbs reach the footholds of a round, old and new, apart."""
        reach, limb = self.lab.reach, np.arange(len(state))
        both = [reach.valid[:, limb, own].all(axis=1) & self._apart(own) for own in (state, after)]
        at: BoolArray = np.asarray(both[0] & both[1])
        if number == 0:  # the first round starts near the start pose
            at = at & np.isfinite(self.first)
        return at

    def _apart(self, state: State) -> BoolArray:
        """(B,) poses from which no two limbs meet, each on its foothold."""
        if state not in self._clear:
            self._clear[state] = self.lab.reach.clear.apart(state)
        return self._clear[state]

    def uses(self, number: int, state: State, after: State) -> Array:
        """(B,) torque use 1 / S_tau of a round by pose, infinite where it is not possible."""
        at = self._reachable(number, state, after)
        if not self.forces:
            return np.where(at, 0.0, np.inf)
        use = self._use.get(stance_of_move(state, after))
        if use is None:
            return np.full(len(at), np.inf)
        return np.where(at & ~np.isnan(use), use, np.inf)

    # Paths

    def _paths(self) -> Iterator[tuple[State, ...]]:
        """All ways from start to goal through possible rounds."""
        rounds = self.scene.spec.task.rounds
        goal = tuple(GOAL for _ in self._initial())
        useful: list[set[State]] = [set() for _ in range(rounds + 1)]
        useful[rounds] = {goal}
        for number in reversed(range(rounds)):
            edges = self._edges[number]
            useful[number] = {
                s for s, f in edges.items() if any(a in useful[number + 1] for a in f)
            }

        def onward(path: tuple[State, ...]) -> Iterator[tuple[State, ...]]:
            number = len(path) - 1
            if number == rounds:
                yield path
                return
            for after in self._edges[number].get(path[-1], []):
                if after in useful[number + 1]:
                    yield from onward((*path, after))

        first = self._initial()
        if first in useful[0]:
            yield from onward((first,))


def toe_step_limits(scene: TransitionScene) -> Array:
    """(N,) largest toe steps [m]."""
    task, most = scene.spec.task, scene.spec.posture.steps.toe_max
    return np.array([min(task.step_max.get(name, most), most) for name in scene.robot.limb_names])
