"""Enumerate all contact sequences of a number of rounds: a graph search over stance sets.

A state is a foothold for every limb. In a round some limbs move to their next foothold while the
others hold the body, which stands still at a pose; then the body goes to its next pose. A round
is possible at a pose if every limb reaches its old and new footholds from there and the limbs that
stay have admissible forces. `pose_paths.py` finds the best path of a sequence through the poses.
"""

from __future__ import annotations

import itertools
import time
from collections.abc import Iterator
from dataclasses import dataclass, field

import numpy as np

from climbplan.arrays import Array, BoolArray
from climbplan.climb.plan.climb_plan import format_sequence
from climbplan.climb.transition.footholds import (
    GOAL,
    START,
    CandidateBodyPoses,
    compute_reach,
    list_footholds,
    list_poses,
)
from climbplan.climb.transition.pose_paths import (
    ContactSequence,
    State,
    add_friction_factors,
    find_cheapest_path,
    get_stance,
)
from climbplan.climb.transition.scene import TransitionScene
from climbplan.climb.transition.stance_forces import LIFTED, SearchTables, solve_stance_forces
from climbplan.errors import LimitReached

_POSE_TOLERANCE = 1e-9  # [m] and [rad]
_BATCH_SIZE = 5000  # force problems between two checks of the time limit


@dataclass
class SearchStatistics:
    """The size of a search."""

    stances: int = 0  # stance sets whose forces were solved
    problems: int = 0  # force problems: stance sets at poses
    truncated: bool = False  # there are more sequences than the limit
    timed_out: bool = False  # the time limit was reached before all were listed


@dataclass
class SequenceSearch:
    """The search in one scene; the forces of a stance are solved once."""

    scene: TransitionScene
    forces: bool = True  # False: kinematics only
    deadline: float = np.inf  # in `time.monotonic` seconds
    tables: SearchTables = field(init=False)
    statistics: SearchStatistics = field(default_factory=SearchStatistics)
    extra_poses: CandidateBodyPoses | None = None  # poses in addition to those of the grid
    _clear: dict[State, BoolArray] = field(default_factory=dict)  # state -> (B,) no limbs meet
    _torque_use: dict[State, Array] = field(default_factory=dict)  # stance -> (B,) 1 / S_tau

    def __post_init__(self) -> None:
        footholds, poses = list_footholds(self.scene), list_poses(self.scene, self.extra_poses)
        self.tables = SearchTables(
            self.scene, footholds, poses, compute_reach(self.scene, footholds, poses)
        )
        com = poses.com
        steps = self.scene.spec.posture.steps
        distances = np.linalg.norm(com[:, None] - com[None], axis=-1)
        rotations = np.abs(poses.rpy[:, None] - poses.rpy[None]).max(axis=-1)
        is_too_far = (distances > steps.com_max + 1e-9) | (
            rotations > np.deg2rad(steps.rotation_max_deg) + 1e-9
        )
        weights = self.scene.spec.posture.weights
        squared_rotation = np.sum((poses.rpy[:, None] - poses.rpy[None]) ** 2, axis=-1)
        self.step_max = compute_step_limits(self.scene)
        # Where the body may be at the first lift: level with its start, turned like it
        offset = com - com[0]
        is_level = (np.abs(offset[:, 2]) < _POSE_TOLERANCE) & (
            np.abs(poses.rpy - poses.rpy[0]).max(axis=1) < _POSE_TOLERANCE
        )
        is_near = is_level & (
            np.linalg.norm(offset, axis=1) <= max(steps.com_shift_max, _POSE_TOLERANCE)
        )
        self.first = np.where(is_near, weights.com * np.sum(offset**2, axis=1), np.inf)
        self.step_cost = np.where(
            is_too_far, np.inf, weights.com * distances**2 + weights.rotation * squared_rotation
        )

    def list_sequences(self) -> list[ContactSequence]:
        """List sequences of the spec's rounds, best first by the spec's ranking.

        At most twenty times `search.max_sequences` paths are looked at. Of sequences that move the
        same limbs in the same rounds only the cheapest is listed. A time
        limit after the first sequence truncates the list.

        Raises:
            LimitReached: The time limit was reached before any sequence was found.
        """
        self._explore()
        best: dict[bytes, ContactSequence] = {}
        max_paths = 20 * self.scene.spec.search.max_sequences
        for number, states in enumerate(self._list_paths()):
            self.statistics.timed_out = bool(best) and self._is_timed_out()
            if number == max_paths or self.statistics.timed_out:
                self.statistics.truncated = True
                break
            torque_uses = [
                self.compute_torque_use(j, a, b)
                for j, (a, b) in enumerate(itertools.pairwise(states))
            ]
            sequence = find_cheapest_path(
                self.tables, states, torque_uses, self.step_cost, self.first
            )
            if sequence is None:
                continue
            key = sequence.moves.tobytes()
            if key not in best or sequence.cost < best[key].cost:
                best[key] = sequence
        sequences = sorted(best.values(), key=lambda s: s.cost)[
            : self.scene.spec.search.max_sequences
        ]
        self.statistics.truncated |= len(best) > len(sequences)
        if self.forces:
            sequences = add_friction_factors(self.tables, sequences)
        rank = self.scene.spec.search.rank
        if rank == "torque":
            sequences.sort(key=lambda s: -s.safety_torque)
        elif rank == "friction":
            sequences.sort(key=lambda s: -s.safety_friction)
        return sequences

    def list_stances(self) -> list[State]:
        """List the stance sets of all possible rounds, those with most standing limbs first."""
        stances = {
            get_stance(state, after)
            for edges in self._edges.values()
            for state, following in edges.items()
            for after in following
        }
        return sorted(stances, key=lambda stance: (stance.count(LIFTED), stance))

    def format_name(self, sequence: ContactSequence) -> str:
        """Format a sequence, such as "3-3: RF RM LR | RR LM LF"."""
        return format_sequence(sequence.moves, self.scene.robot.limb_names)

    def _is_timed_out(self) -> bool:
        return time.monotonic() > self.deadline

    def _require_time(self, number: int) -> None:
        """Raise LimitReached after the time limit."""
        if self._is_timed_out():
            progress_text = (
                f"{self.statistics.problems} force problems are solved and round {number + 1} is "
                "not finished"
            )
            raise LimitReached(
                f"no contact sequence found within the time limit: {progress_text}; a larger "
                "`solver.time_limit`, a given `task.sequence`, fewer rounds or "
                "`search.between: boxes` may help"
            )

    # States and moves

    def _get_initial_state(self) -> State:
        real = self.tables.footholds.real[:, START]
        return tuple(START if r else GOAL for r in real)

    def _list_moves(self, state: State, number: int) -> Iterator[State]:
        """List states after round `number` from which the goal can be reached in time."""
        task = self.scene.spec.task
        rounds_left = task.rounds - number
        max_moving = len(state) - task.min_supporting_limbs
        for limbs in self._list_moving_sets(state, number):
            choices = [self._list_targets(state, i, rounds_left) for i in limbs]
            for targets in itertools.product(*choices):
                after = list(state)
                for limb, target in zip(limbs, targets, strict=True):
                    after[limb] = target
                num_waiting = sum(t != GOAL for t in after)
                if num_waiting <= max_moving * (rounds_left - 1):
                    yield tuple(after)

    def _list_moving_sets(self, state: State, number: int) -> Iterator[tuple[int, ...]]:
        """List sets of limbs that may move in a round: those requested, none at its goal."""
        task, names = self.scene.spec.task, self.scene.robot.limb_names
        waiting = [i for i in range(len(state)) if state[i] != GOAL]
        if task.limbs:
            limbs = tuple(names.index(name) for name in task.limbs[number])
            if all(i in waiting for i in limbs):
                yield limbs
            return
        max_moving = len(state) - task.min_supporting_limbs
        for size in [task.moving[number]] if task.moving else range(1, max_moving + 1):
            yield from itertools.combinations(waiting, size)

    def _list_targets(self, state: State, limb: int, rounds_left: int) -> list[int]:
        """List footholds that a limb may step to: its goal, or an intermediate one in time."""
        targets = [GOAL]
        footholds = self.tables.footholds
        if state[limb] == START and rounds_left > 1:
            targets += [c for c in range(2, footholds.count) if footholds.real[limb, c]]
        steps = np.linalg.norm(
            footholds.toe[limb, targets] - footholds.toe[limb, state[limb]], axis=1
        )
        return [c for c, step in zip(targets, steps, strict=True) if step <= self.step_max[limb]]

    def _iterate_rounds(self) -> Iterator[tuple[int, dict[State, list[State]]]]:
        """Iterate over rounds and the moves from all states that were reached."""
        task = self.scene.spec.task
        current = {self._get_initial_state()}
        for number in range(task.rounds):
            moves: dict[State, list[State]] = {}
            for state in current:
                self._require_time(number)
                moves[state] = list(self._list_moves(state, number))
            yield number, moves
            current = {
                after
                for state, following in self._edges.get(number, {}).items()
                for after in following
                if state in moves
            }

    def _explore(self) -> None:
        """Explore all rounds that are possible at some pose; stance sets are solved in batches."""
        self._edges: dict[int, dict[State, list[State]]] = {}
        for number, moves in self._iterate_rounds():
            self._solve(number, moves)
            self._edges[number] = {
                state: [
                    a
                    for a in following
                    if np.isfinite(self.compute_torque_use(number, state, a)).any()
                ]
                for state, following in moves.items()
            }

    def _solve(self, number: int, moves: dict[State, list[State]]) -> None:
        """Solve the forces of all stances of a round that are not solved yet."""
        if not self.forces:
            return
        required: dict[State, BoolArray] = {}
        for state, following in moves.items():
            for after in following:
                stance = get_stance(state, after)
                poses_to_solve = self._find_reachable_poses(number, state, after)
                if stance in self._torque_use:
                    poses_to_solve = poses_to_solve & np.isnan(self._torque_use[stance])
                if poses_to_solve.any():
                    required[stance] = (
                        required.get(stance, np.zeros(len(poses_to_solve), bool)) | poses_to_solve
                    )
        if not required:
            return
        pairs = [
            (stance, b)
            for stance, poses_to_solve in required.items()
            for b in np.flatnonzero(poses_to_solve)
        ]
        stances = np.array([stance for stance, _ in pairs], np.int64)
        poses = np.array([b for _, b in pairs], np.int64)
        uses = np.empty(len(pairs))
        for first in range(0, len(pairs), _BATCH_SIZE):
            self._require_time(number)
            rows = slice(first, first + _BATCH_SIZE)
            uses[rows] = solve_stance_forces(self.tables, stances[rows], poses[rows]).torque_use
        self.statistics.problems += len(pairs)
        self.statistics.stances += len(required.keys() - self._torque_use.keys())
        for (stance, b), torque_use in zip(pairs, uses, strict=True):
            self._torque_use.setdefault(stance, np.full(self.tables.poses.count, np.nan))[b] = (
                torque_use
            )

    def _find_reachable_poses(self, number: int, state: State, after: State) -> BoolArray:
        """Find poses (B,) from which all limbs reach their old and new footholds and are clear."""
        reach, limb = self.tables.reach, np.arange(len(state))
        reachable = [
            reach.valid[:, limb, stance].all(axis=1) & self._find_clear_poses(stance)
            for stance in (state, after)
        ]
        result_mask: BoolArray = np.asarray(reachable[0] & reachable[1])
        if number == 0:  # the first round starts near the start pose
            result_mask = result_mask & np.isfinite(self.first)
        return result_mask

    def _find_clear_poses(self, state: State) -> BoolArray:
        """Find poses (B,) from which no two limbs collide, each on its foothold."""
        if state not in self._clear:
            self._clear[state] = self.tables.reach.clear.find_clear_poses(state)
        return self._clear[state]

    def compute_torque_use(self, number: int, state: State, after: State) -> Array:
        """Return the torque use 1 / S_tau (B,) of a round by pose, infinite where impossible."""
        reachable = self._find_reachable_poses(number, state, after)
        if not self.forces:
            return np.where(reachable, 0.0, np.inf)
        torque_use = self._torque_use.get(get_stance(state, after))
        if torque_use is None:
            return np.full(len(reachable), np.inf)
        return np.where(reachable & ~np.isnan(torque_use), torque_use, np.inf)

    # Paths

    def _list_paths(self) -> Iterator[tuple[State, ...]]:
        """List all paths from start to goal through possible rounds."""
        rounds = self.scene.spec.task.rounds
        goal = tuple(GOAL for _ in self._get_initial_state())
        useful: list[set[State]] = [set() for _ in range(rounds + 1)]
        useful[rounds] = {goal}
        for number in reversed(range(rounds)):
            edges = self._edges[number]
            useful[number] = {
                s
                for s, following_states in edges.items()
                if any(a in useful[number + 1] for a in following_states)
            }

        def extend_path(path: tuple[State, ...]) -> Iterator[tuple[State, ...]]:
            number = len(path) - 1
            if number == rounds:
                yield path
                return
            for after in self._edges[number].get(path[-1], []):
                if after in useful[number + 1]:
                    yield from extend_path((*path, after))

        first = self._get_initial_state()
        if first in useful[0]:
            yield from extend_path((first,))


def compute_step_limits(scene: TransitionScene) -> Array:
    """Compute the largest toe step (N,) of each limb [m]."""
    task, max_step = scene.spec.task, scene.spec.posture.steps.toe_max
    return np.array(
        [min(task.step_max.get(name, max_step), max_step) for name in scene.robot.limb_names]
    )
