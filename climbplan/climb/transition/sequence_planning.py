"""Plan and verify a contact sequence: motion, instants, forces, trajectory, checks, summary."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, replace

import numpy as np

from climbplan.arrays import Array, BoolArray
from climbplan.climb.check.verification import verify_plan
from climbplan.climb.clearance.swing import SwingCollision
from climbplan.climb.forces.planner import plan_forces
from climbplan.climb.gait.instants import build_instants_at, compute_joint_angles
from climbplan.climb.motion.in_hand import plan_with_torque_reserve
from climbplan.climb.motion.motion import StageClock
from climbplan.climb.plan.climb_plan import (
    ClimbPlan,
    InstantForces,
    Instants,
    Rounds,
    Sequences,
    Trajectory,
)
from climbplan.climb.planner.planner import build_step_limits, describe_deflection
from climbplan.climb.planner.summary import describe_min_safety
from climbplan.climb.planner.visual_geometry import load_visual_geometry
from climbplan.climb.scene.climb_scene import ClimbStance
from climbplan.climb.schema.transition_loading import LoadedTransition
from climbplan.climb.transition.following_climb import FollowingClimb, join_instants, join_rounds
from climbplan.climb.transition.motion import TransitionMotion, plan_motion
from climbplan.climb.transition.motion_data import JOINT_MARGIN
from climbplan.climb.transition.pose_paths import ContactSequence
from climbplan.climb.transition.scene import TransitionScene
from climbplan.climb.transition.stance_forces import SearchTables
from climbplan.climb.transition.standing_clearance import describe_collision
from climbplan.errors import NoPlanFound, ReachFailure, Unresolved
from climbplan.robots.any_robot import list_assumptions
from climbplan.schema.robots.stored import collect_robot_texts
from climbplan.verification.verification import Verification

_MAX_LISTED_KINDS = 4  # kinds of sequence named
# Of the margins, tried in turn: forces of the moving body, after each lift, use up some of them
MARGIN_FRACTIONS = (1.2, 0.9, 0.6, 0.3, 0.0)


def format_summary(plan: ClimbPlan) -> tuple[str, ...]:
    """Format the head, search, motion and force lines that a terminal shows."""
    seconds, sizes = plan.timings, plan.sizes
    surfaces = ", ".join(s.name for s in plan.terrain.surfaces[:4])
    if len(plan.terrain.surfaces) > 4:
        surfaces += f" and {len(plan.terrain.surfaces) - 4} more"
    count = plan.instants.count
    head = f"{plan.robot.name}, {plan.rounds.count} rounds, {count} instants, surfaces {surfaces}"
    lines = [f"{plan.name:<16} {head}"]
    if plan.sequences is not None and "search" in sizes:
        kinds = Counter(name.partition(":")[0] for name in plan.sequences.name).most_common()
        listed = ", ".join(f"{n} {kind}" for kind, n in kinds[:_MAX_LISTED_KINDS])
        more_text = (
            f" and {sum(n for _, n in kinds[_MAX_LISTED_KINDS:])} more"
            if len(kinds) > _MAX_LISTED_KINDS
            else ""
        )
        found_text = f"{len(plan.sequences.name)} found"
        lines.append(
            f"{'search':<9} {found_text:<9} {seconds['search']:.2f} s   {listed}{more_text}; "
            f"{sizes['search']['force problems']} force problems"
        )
    lines.append(
        f"{'motion':<9} {plan.status:<9} {seconds['motion']:.2f} s   {plan.contact_sequence}, "
        f"cost {plan.objective:.4g}"
    )
    solved_text = f"{count} of {count}"
    lines.append(
        f"{'force':<9} {solved_text:<9} {seconds['force']:.2f} s   {describe_min_safety(plan)}"
    )
    return tuple(lines)


def plan_instants(
    scene: TransitionScene, rounds: Rounds, moves: BoolArray, first_position: Array
) -> Instants:
    """Build the 2 M instants of a transition with joint angles of the planned poses, without sag.

    The body waits while limbs swing.

    Args:
        scene: The scene.
        rounds: M + 1 postures.
        moves: (M, N) bool, limb moves in round.
        first_position: (3,) of the body at the first lift [m].

    Raises:
        ReachFailure: A toe is out of reach; it names round, limb and missing reach.
    """
    m, n = moves.shape
    row = np.repeat(np.arange(m), 2) + np.tile([0, 1], m)  # posture of each instant
    lifted = np.zeros((2 * m, n), bool)
    lifted[::2] = moves
    com = rounds.com[row]
    com[0] = first_position
    instants = build_instants_at(
        scene,
        np.repeat(np.arange(1, m + 1), 2),
        com,
        rounds.rpy[row],
        rounds.toes[row],
        region=rounds.region[row],
        lifted=lifted,
    )
    placed_toes = instants.toes.copy()
    placed_toes[::2] = rounds.toes[1:]
    compute_joint_angles(scene.robot, instants, placed_toes, " and placed")
    hovering = placed_toes.copy()
    hovering[::2] += (
        scene.spec.trajectory.swing_clearance * instants.normal[1::2] * moves[..., None]
    )
    compute_joint_angles(scene.robot, instants, hovering, ", above their new places")
    return instants


# Checks that separating constraints may repair
_CLEARANCE_CHECKS = frozenset(
    f"{subject}.{what}"
    for subject in ("limbs", "body", "trajectory")
    for what in ("clearance", "axis_collision", "collision", "self_collision")
)
_JOINT_MARGINS = (
    JOINT_MARGIN,
    1e-2,
    3e-2,
)  # [rad] off joint bounds, tried in turn where one is passed
_TORQUE_FACTORS = (1.0, 1.15, 1.35, 1.6)  # factors on S_tau tried in turn for one sequence


@dataclass(frozen=True)
class CompleteMotion:
    """A motion with everything that follows from it."""

    rounds: Rounds
    instants: Instants
    forces: InstantForces
    trajectory: Trajectory


@dataclass(frozen=True)
class TransitionRun:
    """One planning run."""

    loaded: LoadedTransition
    scene: TransitionScene
    clock: StageClock
    tail: FollowingClimb | None = None  # the climb that follows
    margin_fractions: tuple[float, ...] = MARGIN_FRACTIONS  # tried in turn


class LimbCollision(Unresolved):
    """Limbs meet the terrain, the body or one another."""

    def __init__(self, message: str) -> None:
        reason = "the motion of a sequence is found by a local method"
        super().__init__(f"limbs meet: {message}", because=reason, stage="motion")


def complete_motion(
    run: TransitionRun, rounds: Rounds, moves: BoolArray, first_position: Array
) -> CompleteMotion:
    """Compute instants, forces and trajectory of postures.

    Args:
        run: The planning run.
        rounds: M + 1 postures.
        moves: (M, N) bool, limb moves in round.
        first_position: (3,) of the body at the first lift [m].

    Raises:
        NoPlanFound: Limbs collide or leave their reach, or there are no forces or trajectory.
    """
    scene, clock = run.scene, run.clock
    with clock.stage("kinematics"):
        instants = plan_instants(scene, rounds, moves, first_position)
        collision = describe_collision(scene, instants)
        if collision is not None:
            raise LimbCollision(collision)
    if run.tail is not None:
        rounds = join_rounds(rounds, run.tail.rounds)
        instants = join_instants(scene.robot, instants, run.tail.instants)
    with clock.stage("force"):
        forces = plan_forces(scene, instants)
    with clock.stage("trajectory"):
        forces, trajectory = plan_with_torque_reserve(scene, rounds, instants, forces)
    return CompleteMotion(rounds, instants, forces, trajectory)


def verify_motion(
    run: TransitionRun, rounds: Rounds, moves: BoolArray, first_position: Array
) -> tuple[CompleteMotion, Verification]:
    """Complete a motion and run all checks of its plan; raise what `complete_motion` raises."""
    motion = complete_motion(run, rounds, moves, first_position)
    with run.clock.stage("check"):
        return motion, verify_plan(assemble_plan(run, TransitionResult(motion, {})))


def compute_cost(
    scene: TransitionScene, rounds: Rounds, forces: InstantForces, goal: ClimbStance | None = None
) -> float:
    """Compute the weighted cost of a transition: body, rotation and toe steps, and 1 / S_tau.

    goal: stance whose deviation from the last posture counts, too; None without a climb after it.
    """
    weights = scene.spec.posture.weights
    position_error = toe_error = rotation_error = np.zeros(3)
    if goal is not None:
        position_error, rotation_error = rounds.com[-1] - goal.com, rounds.rpy[-1] - goal.rpy
        toe_error = rounds.toes[-1] - goal.toes
    cost = (
        weights.goal * np.sum(toe_error**2)
        + weights.goal_com * np.sum(position_error**2)
        + weights.goal_rotation * np.sum(rotation_error**2)
        + weights.com * np.sum(np.diff(rounds.com, axis=0) ** 2)
        + weights.rotation * np.sum(np.diff(rounds.rpy, axis=0) ** 2)
        + weights.toe * np.sum(np.diff(rounds.toes, axis=0) ** 2)
        + weights.effort * np.sum(1 / forces.safety_torque[::2])
    )
    return float(cost)


@dataclass(frozen=True)
class SequenceResult:
    """The result for one sequence: a complete motion, or the reason why there is none."""

    motion: CompleteMotion | None
    iterations: int  # of IPOPT
    reason: str = ""


def plan_and_verify_sequence(
    run: TransitionRun, tables: SearchTables, sequence: ContactSequence
) -> SequenceResult:
    """Plan a motion of a sequence that passes its verification, with escalating safety factors.

    The motion program models no buckling, and links that hit a box only with separating planes. If
    forces, trajectory or verification fail, a larger S_tau is required, unless the motion has it
    already. All margins are required first, and a smaller fraction of them if there is no motion.
    """
    planner = _SequencePlanner(run, tables, sequence)
    min_safety_torque = run.scene.spec.force.safety_torque
    for margin_fraction in run.margin_fractions if run.scene.spec.margins.asked else (0.0,):
        achieved = 0.0  # S_tau of the motion that was found
        for factor in _TORQUE_FACTORS:
            safety_torque = factor * min_safety_torque
            if safety_torque > sequence.safety_torque:
                break
            if safety_torque <= achieved:
                continue
            complete, motion = planner.plan_and_verify(safety_torque, margin_fraction)
            if complete is not None:
                return SequenceResult(complete, planner.iterations)
            if not motion.is_accepted and margin_fraction > 0:
                break
            achieved = motion.safety_torque if motion.is_accepted else 0.0
    return SequenceResult(None, planner.iterations, planner.reason or "no room for a safety margin")


class _SequencePlanner:
    """Plans motions of one sequence, and adapts the program to the failures of earlier ones."""

    def __init__(self, run: TransitionRun, tables: SearchTables, sequence: ContactSequence) -> None:
        self.run, self.tables, self.sequence = run, tables, sequence
        self.reason, self.iterations = "", 0
        self._separate = False  # add constraints that keep limbs and body clear
        self._colliding_motion: Rounds | None = None  # a motion that came too close

    def plan_and_verify(
        self, safety_torque: float, margin_fraction: float
    ) -> tuple[CompleteMotion | None, TransitionMotion]:
        """Plan a motion with an S_tau and a fraction of the margins, and verify it.

        If limbs or body come too close to anything, the motion is planned again with separating
        constraints; if a limb leaves its reach between two poses, with larger joint margins.
        Returns the complete motion, None if there is none, and the last motion of the program.
        """
        joint_margins = list(_JOINT_MARGINS)
        joint_margin = joint_margins.pop(0)
        last_motion: TransitionMotion | None = None
        while True:
            motion = self._plan(safety_torque, margin_fraction, joint_margin)
            if not motion.is_accepted:
                message = f"no motion: {motion.block} off by {motion.violation:.2g}"
                self.reason = self.reason or message
                # Infeasible joint margins say nothing of the motion without them
                return (
                    None,
                    last_motion
                    if last_motion is not None and joint_margin > _JOINT_MARGINS[0]
                    else motion,
                )
            last_motion, separated = motion, self._separate
            complete, leaves_reach = self._complete_and_verify(motion)
            if complete is not None:
                return complete, motion
            if leaves_reach and joint_margins:
                joint_margin = joint_margins.pop(0)
            elif separated or not self._separate:
                return None, motion

    def _plan(
        self, safety_torque: float, margin_fraction: float, joint_margin: float
    ) -> TransitionMotion:
        with self.run.clock.stage("motion"):
            motion = plan_motion(
                self.tables,
                self.sequence,
                safety_torque,
                margin_fraction=margin_fraction,
                separate=self._separate,
                colliding_motion=self._colliding_motion,
                joint_margin=joint_margin,
            )
        self.iterations += motion.iterations
        return motion

    def _complete_and_verify(self, motion: TransitionMotion) -> tuple[CompleteMotion | None, bool]:
        """Complete and verify a motion; also return whether a limb leaves its reach on the way."""
        leaves_reach = False
        try:
            complete, verification = verify_motion(
                self.run, motion.rounds, self.sequence.moves, motion.first_position
            )
        except NoPlanFound as error:
            self.reason = " ".join(str(error).split())
            self._separate |= isinstance(error, LimbCollision | SwingCollision)
            leaves_reach = isinstance(error, ReachFailure)
        else:
            if verification.passed:
                return complete, False
            self.reason = f"fails its verification: {verification.headline()}"
            failed = {check.name for check in verification.checks if not check.passed}
            self._separate |= not failed.isdisjoint(_CLEARANCE_CHECKS)
        if self._separate:
            self._colliding_motion = motion.rounds
        return None, leaves_reach


@dataclass(frozen=True)
class TransitionResult:
    """The result of a planning method."""

    motion: CompleteMotion
    sizes: dict[str, dict[str, int]]
    sequences: Sequences | None = None
    warnings: tuple[str, ...] = ()
    notes: tuple[str, ...] = ()


def assemble_plan(run: TransitionRun, result: TransitionResult) -> ClimbPlan:
    """Assemble the plan from the result of a method."""
    loaded, scene, motion = run.loaded, run.scene, result.motion
    limits, robot_assumptions = (
        build_step_limits(scene),
        list_assumptions(loaded.robot, scene.robot),
    )
    goal = run.tail.goal if run.tail is not None else scene.goal
    if run.tail is not None:
        last_goal = scene.spec.last_goal
        limits = replace(
            limits,
            goal_com=goal.com,
            goal_toes=goal.toes,
            goal_rpy=goal.rpy,
            goal_tolerance=last_goal.tolerance,
            goal_rotation_tolerance=float(np.deg2rad(last_goal.rotation_tolerance_deg)),
        )
    plan = ClimbPlan(
        name=loaded.name,
        robot=scene.robot,
        terrain=scene.terrain,
        rounds=motion.rounds,
        instants=motion.instants,
        forces=motion.forces,
        trajectory=motion.trajectory,
        limits=limits,
        status="feasible",
        objective=compute_cost(scene, motion.rounds, motion.forces, goal),
        bound=None,
        gap=None,
        spec_text=loaded.text,
        spec_sha256=loaded.sha256,
        seed=scene.spec.seed,
        timings=dict(run.clock.seconds),
        solvers={"motion": "ipopt (mumps)", "force": scene.spec.solver.force_solver},
        sizes={**result.sizes, "force": {"instants": motion.instants.count}},
        warnings=(
            *robot_assumptions,
            *result.warnings,
            *describe_deflection(motion.forces),
            *motion.forces.notes,
        ),
        notes=result.notes,
        kind="transition",
        sequences=result.sequences,
        robot_texts=collect_robot_texts(loaded.spec.robot, loaded.directory, loaded.robot)
        if loaded.carried_robot is None
        else loaded.carried_robot.texts,
        looks=load_visual_geometry(loaded.robot, scene.robot),
    )
    return replace(plan, summary=format_summary(plan))
