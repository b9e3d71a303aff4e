"""The nonlinear block, eq. (6.12b): independent programs at all knots.

Equation numbers are those of X. Lin (UCLA 2022).
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from climbplan.arrays import Array, IntArray
from climbplan.limms.consensus.block_solution import LocalCopy, Modes
from climbplan.limms.consensus.knot_contacts import ModuleContacts, find_contacts
from climbplan.limms.consensus.knot_guess import compute_initial_guess
from climbplan.limms.consensus.knot_program import KnotConfiguration, KnotPrograms, KnotSolution
from climbplan.limms.consensus.planes import build_planes
from climbplan.limms.consensus.problem import (
    CHAIN_POINTS,
    POINTS,
    STABLE,
    ConsensusProblem,
    compute_start_points,
)
from climbplan.limms.modules.chain import forward, forward_from_last
from climbplan.limms.scene.limms_scene import FramePoses as Frame
from climbplan.limms.scene.limms_scene import Points

BOX_WEIGHT, POINT_WEIGHT = 10.0, 1.0  # [1/m^2] of squared disagreements
PENETRATION_TOLERANCE = 1e-4  # [m]; deeper links get new planes
LATCH_TOLERANCE = 1e-4  # [m]; above it another initial guess is tried
TARGET_TOLERANCE = 0.05  # [m] mean distance; above it another initial guess is tried
BLOCK_TOLERANCE = 1e-3  # [m] that a link may leave its free block by
MAX_PLANE_ROUNDS = 3
_ANYWHERE = np.array([[-np.inf] * 3, [np.inf] * 3])  # free blocks constrain the other block only


@dataclass(frozen=True)
class KinematicSolution:
    """A solution of the block: positions, joint angles (K + 1, L, 6), and violations."""

    copy: LocalCopy
    angles: Array
    region: IntArray  # (K + 1, L, 4) free block of each link
    violation: float  # of latches and bounds, the worst knot [m]
    penetration: float  # of links, the worst knot [m]
    seconds: float


@dataclass(frozen=True)
class _KnotTarget:
    """The target of one knot: box (3,), points (L, 5, 3) [m], whether the box is at its start."""

    box: Array
    points: Array
    is_box_at_start: bool


@dataclass(frozen=True)
class _KnotResult:
    """A solution at a knot, the penetration of links [m], and their free blocks (L, 4)."""

    solved: KnotSolution
    penetration: float
    region: IntArray
    target_distance: float  # mean over the points [m]

    @property
    def is_feasible(self) -> bool:
        """True if latches are closed and links are apart."""
        return self.max_violation() <= LATCH_TOLERANCE

    def max_violation(self) -> float:
        """Return the largest of violation and penetration [m]."""
        return max(self.solved.violation, self.penetration)

    def rank(self) -> tuple[float, float]:
        """Return the sort key, smaller is better: feasible first, then near."""
        return (0.0 if self.is_feasible else self.max_violation(), self.target_distance)


class NonlinearBlock:
    """The nonlinear block of one problem, with the last poses as initial guesses."""

    def __init__(self, problem: ConsensusProblem) -> None:
        self.problem = problem
        self.programs = KnotPrograms(problem)
        self._poses: list[KnotConfiguration | None] = [None] * problem.knots
        self.solves = 0

    def solve(self, target: LocalCopy, modes: Modes, deadline: float) -> KinematicSolution:
        """Solve for the nearest kinematics to a target in given modes.

        Args:
            target: The target positions.
            modes: The modes of the other block.
            deadline: Time after which no knot is begun, as `time.monotonic` [s]; the violation is
                then
                infinite.
        """
        start_time = time.perf_counter()
        build_seconds = self.programs.build_seconds
        problem = self.problem
        num_knots, num_modules = problem.knots, problem.scene.num_modules
        box, points = np.zeros((num_knots, 3)), np.zeros((num_knots, num_modules, POINTS, 3))
        angles, region = np.zeros((num_knots, num_modules, 6)), modes.region.copy()
        box[0], points[0] = problem.scene.box_start[0], compute_start_points(problem)
        poses: list[KnotConfiguration | None] = [None] * num_knots
        violation, penetration = 0.0, 0.0
        for knot in range(1, num_knots):
            if time.monotonic() > deadline:
                box[knot:], points[knot:] = target.box[knot:], target.points[knot:]
                violation = np.inf
                break
            contacts = find_contacts(problem, modes, knot)
            starts = [poses[knot - 1], self._poses[knot]]
            is_box_at_start = modes.box[knot - 1] == STABLE
            result = self._solve_knot(
                contacts,
                _KnotTarget(
                    box[0] if is_box_at_start else target.box[knot],
                    target.points[knot],
                    is_box_at_start,
                ),
                [pose for pose in starts if pose is not None],
                modes.region[knot],
                deadline,
            )
            poses[knot] = result.solved.pose
            box[knot], points[knot] = result.solved.pose.box, result.solved.points
            angles[knot], region[knot] = result.solved.pose.angles, result.region
            violation, penetration = (
                max(violation, result.solved.violation),
                max(penetration, result.penetration),
            )
        self._poses = poses
        seconds = time.perf_counter() - start_time - (self.programs.build_seconds - build_seconds)
        return KinematicSolution(
            LocalCopy(box, points), angles, region, violation, penetration, seconds
        )

    def _solve_knot(
        self,
        contacts: tuple[ModuleContacts, ...],
        target: _KnotTarget,
        starts: Sequence[KnotConfiguration],
        region: IntArray,
        deadline: float,
    ) -> _KnotResult:
        """Solve one knot, again from other guesses where latches are open or links overlap.

        Args:
            contacts: Contacts of all modules.
            target: The target of the knot.
            starts: Poses of the last knot and the last iterate. Their angles are candidates of the
                first
                guess, and they are guesses themselves if that one fails.
            region: Free block of each link (L, 4).
            deadline: Time limit as `time.monotonic` [s].
        """
        problem = self.problem
        earlier_angles = [
            np.array([pose.angles[m] for pose in starts]).reshape(-1, 6)
            for m in range(len(contacts))
        ]
        pose, module_points = compute_initial_guess(
            problem, contacts, target.box, target.points, earlier_angles
        )
        result = self._solve_from(contacts, target, pose, module_points, region, deadline)
        for start in starts:
            if result.is_feasible and result.target_distance <= TARGET_TOLERANCE:
                break
            pose = KnotConfiguration(target.box, start.root, start.angles)
            module_points = compute_points(problem, contacts, pose)
            retry = self._solve_from(contacts, target, pose, module_points, region, deadline)
            result = min(result, retry, key=_KnotResult.rank)
        return result

    def _solve_from(
        self,
        contacts: tuple[ModuleContacts, ...],
        target: _KnotTarget,
        pose: KnotConfiguration,
        module_points: Sequence[Points],
        region: IntArray,
        deadline: float,
    ) -> _KnotResult:
        """Solve one knot from a guess, with new planes for links that penetrate."""
        problem = self.problem
        planes, _ = build_planes(problem, contacts, module_points, pose.box)
        blocks = _ANYWHERE
        if problem.formulation.freezes_integers:
            region = select_regions(problem, module_points, region)
            blocks = problem.free_blocks[region]
        blocks = np.broadcast_to(blocks, (*region.shape, 2, 3))
        for _ in range(MAX_PLANE_ROUNDS):
            solved = self.programs.solve(
                contacts,
                pose,
                target_box=target.box,
                target_points=target.points,
                weights=(BOX_WEIGHT, POINT_WEIGHT),
                planes=planes,
                blocks=blocks,
                is_box_at_start=target.is_box_at_start,
                deadline=deadline,
            )
            self.solves += 1
            module_points = compute_points(problem, contacts, solved.pose)
            new_planes, penetration = build_planes(
                problem, contacts, module_points, solved.pose.box
            )
            if penetration <= PENETRATION_TOLERANCE:
                break
            pose, planes = solved.pose, new_planes
        distances = np.linalg.norm(solved.points - target.points, axis=-1)
        return _KnotResult(solved, penetration, region, float(distances.mean()))


def select_regions(
    problem: ConsensusProblem, module_points: Sequence[Points], current: IntArray
) -> IntArray:
    """Return free blocks (L, 4) of the links of poses: the same where links fit, else the nearest.

    A block chosen for straight lines between inexact points may contain no pose at all.
    """
    radius = problem.scene.module.radius
    points = np.array(
        [points_of_module.position[list(CHAIN_POINTS)] for points_of_module in module_points]
    )[:, :, None]
    margin = radius * np.array([0.0, 1.0, 1.0, 1.0, 0.0])[:, None, None]
    low, high = problem.free_blocks[:, 0] + margin, problem.free_blocks[:, 1] - margin  # (5, R, 3)
    max_violation = np.maximum(np.maximum(low - points, points - high), 0).max(axis=-1)  # (L, 5, R)
    max_violation = np.maximum(max_violation[:, :-1], max_violation[:, 1:])
    is_kept = (
        np.take_along_axis(max_violation, current[..., None], axis=-1)[..., 0] <= BLOCK_TOLERANCE
    )
    return np.where(is_kept, current, max_violation.argmin(axis=-1))


def compute_points(
    problem: ConsensusProblem, contacts: tuple[ModuleContacts, ...], pose: KnotConfiguration
) -> list[Points]:
    """Return all points of all modules of a pose."""
    points: dict[int, Points] = {}
    for m in sorted(range(len(contacts)), key=lambda m: contacts[m].parent >= 0):
        contact = contacts[m]
        end = contact.ends[contact.root]
        rotation = end.rotation
        if rotation is None:
            parent = points[end.parent]
            parent_end = 0 if problem.box_end[end.parent] == 0 else 7
            flip = np.eye(3) if parent_end == 0 else np.diag([1.0, -1.0, -1.0])
            rotation = parent.rotation[parent_end] @ flip
        kinematics = forward if contact.root == 0 else forward_from_last
        points[m] = kinematics(problem.scene.module, Frame(pose.root[m], rotation), pose.angles[m])
    return [points[m] for m in range(len(contacts))]
