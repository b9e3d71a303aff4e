"""A contact sequence carried through: motion, instants, forces, trajectory, checks, summary."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, replace

import numpy as np

from climbplan.arrays import Array, BoolArray
from climbplan.climb.check.verification import verification_of
from climbplan.climb.clearance.swing import SwingMeets
from climbplan.climb.forces.planner import plan_forces
from climbplan.climb.gait.instants import instants_at, joint_angles
from climbplan.climb.motion.in_hand import in_hand
from climbplan.climb.motion.motion import StageClock
from climbplan.climb.plan.climb_plan import (
    ClimbPlan,
    Forces,
    Instants,
    Rounds,
    Sequences,
    Trajectory,
)
from climbplan.climb.planner.looks import plan_looks
from climbplan.climb.planner.planner import deflection_warnings, step_limits
from climbplan.climb.planner.summary import least_safety
from climbplan.climb.scene.climb_scene import Stance
from climbplan.climb.schema.transition_loading import LoadedTransition
from climbplan.climb.transition.clear_standing import standing_trouble
from climbplan.climb.transition.mission import Tail, joined_instants, joined_rounds
from climbplan.climb.transition.motion import Motion, plan_motion
from climbplan.climb.transition.motion_numbers import JOINT_ROOM
from climbplan.climb.transition.pose_ways import Sequence
from climbplan.climb.transition.scene import TransitionScene
from climbplan.climb.transition.stances import Laboratory
from climbplan.errors import NoPlanFound, NotProved, ReachFailure
from climbplan.robots.any_robot import assumptions
from climbplan.schema.robots.stored import robot_texts
from climbplan.verification.verification import Verification

_KINDS = 4  # kinds of sequence named


def summary_lines(plan: ClimbPlan) -> tuple[str, ...]:
    """Head, search, motion and force lines as shown on a terminal."""
    seconds, sizes = plan.timings, plan.sizes
    surfaces = ", ".join(s.name for s in plan.terrain.surfaces[:4])
    if len(plan.terrain.surfaces) > 4:
        surfaces += f" and {len(plan.terrain.surfaces) - 4} more"
    count = plan.instants.count
    head = f"{plan.robot.name}, {plan.rounds.count} rounds, {count} instants, surfaces {surfaces}"
    lines = [f"{plan.name:<16} {head}"]
    if plan.sequences is not None and "search" in sizes:
        kinds = Counter(name.partition(":")[0] for name in plan.sequences.name).most_common()
        listed = ", ".join(f"{n} {kind}" for kind, n in kinds[:_KINDS])
        more = f" and {sum(n for _, n in kinds[_KINDS:])} more" if len(kinds) > _KINDS else ""
        found = f"{len(plan.sequences.name)} found"
        lines.append(
            f"{'search':<9} {found:<9} {seconds['search']:.2f} s   {listed}{more}; "
            f"{sizes['search']['force problems']} force problems"
        )
    lines.append(
        f"{'motion':<9} {plan.status:<9} {seconds['motion']:.2f} s   {plan.contact_sequence}, "
        f"cost {plan.objective:.4g}"
    )
    solved = f"{count} of {count}"
    lines.append(f"{'force':<9} {solved:<9} {seconds['force']:.2f} s   {least_safety(plan)}")
    return tuple(lines)


def plan_instants(
    scene: TransitionScene, rounds: Rounds, moved: BoolArray, first: Array
) -> Instants:
    """The 2 M instants of a transition with their joint angles.

    moved: (M, N) limbs of each round; first: (3,) where the body is at the first lift. The body
    waits while limbs swing. Joint angles are those of the planned pose, without sag. Raises
    ReachFailure naming round, limb and missing reach.
    """
    m, n = moved.shape
    row = np.repeat(np.arange(m), 2) + np.tile([0, 1], m)  # posture of each instant
    lifted = np.zeros((2 * m, n), bool)
    lifted[::2] = moved
    com = rounds.com[row]
    com[0] = first
    instants = instants_at(
        scene,
        np.repeat(np.arange(1, m + 1), 2),
        com,
        rounds.rpy[row],
        rounds.toes[row],
        rounds.region[row],
        lifted,
    )
    placed = instants.toes.copy()
    placed[::2] = rounds.toes[1:]
    joint_angles(scene.robot, instants, placed, " and placed")
    above = placed.copy()
    above[::2] += scene.spec.trajectory.lift * instants.normal[1::2] * moved[..., None]
    joint_angles(scene.robot, instants, above, ", above their new places")
    return instants


# Of the margins, tried in turn; forces of the body that goes on, after each lift, take some
_SHARES = (1.2, 0.9, 0.6, 0.3, 0.0)
# Checks that rows for limbs and body may mend
_TOO_CLOSE = frozenset(
    f"{part}.{what}"
    for part in ("limbs", "body", "trajectory")
    for what in ("clearance", "capsules", "self_collision")
)
_ROOMS = (JOINT_ROOM, 1e-2, 3e-2)  # [rad] off joint bounds, tried in turn where one is passed
_FIRMER = (1.0, 1.15, 1.35, 1.6)  # factors on S_tau tried in turn for one sequence


@dataclass(frozen=True)
class Complete:
    """A motion with everything that follows from it."""

    rounds: Rounds
    instants: Instants
    forces: Forces
    trajectory: Trajectory


@dataclass(frozen=True)
class Run:
    """One planning run."""

    loaded: LoadedTransition
    scene: TransitionScene
    clock: StageClock
    tail: Tail | None = None  # the climb that follows


class LimbsMeet(NotProved):
    """Limbs meet the terrain, the body or one another."""

    def __init__(self, words: str) -> None:
        because = "the motion of a sequence is found by a local method"
        super().__init__(f"limbs meet: {words}", because=because, stage="motion")


def complete(run: Run, rounds: Rounds, moved: BoolArray, first: Array) -> Complete:
    """Instants, forces and trajectory of postures; raises what each of them raises.

    first: (3,) where the body is at the first lift.
    """
    scene, clock = run.scene, run.clock
    with clock.stage("kinematics"):
        instants = plan_instants(scene, rounds, moved, first)
        trouble = standing_trouble(scene, instants)
        if trouble is not None:
            raise LimbsMeet(trouble)
    if run.tail is not None:
        rounds = joined_rounds(rounds, run.tail.rounds)
        instants = joined_instants(instants, run.tail.instants)
    with clock.stage("force"):
        forces = plan_forces(scene, instants)
    with clock.stage("trajectory"):
        forces, trajectory = in_hand(scene, rounds, instants, forces)
    return Complete(rounds, instants, forces, trajectory)


def verified(
    run: Run, rounds: Rounds, moved: BoolArray, first: Array
) -> tuple[Complete, Verification]:
    """What follows from postures, and all checks of their plan; raises what `complete` raises."""
    done = complete(run, rounds, moved, first)
    with run.clock.stage("check"):
        return done, verification_of(assemble(run, Found(done, {})))


def transition_cost(
    scene: TransitionScene, rounds: Rounds, forces: Forces, goal: Stance | None = None
) -> float:
    """Body, turn and toe steps, and 1 / S_tau at every lift, weighted as in the spec.

    Where a climb follows, also what it misses of its goal.
    """
    w = scene.spec.posture.weights
    off_com = off_toes = off_turn = np.zeros(3)
    if goal is not None:
        off_com, off_turn = rounds.com[-1] - goal.com, rounds.rpy[-1] - goal.rpy
        off_toes = rounds.toes[-1] - goal.toes
    cost = (
        w.goal * np.sum(off_toes**2)
        + w.goal_com * np.sum(off_com**2)
        + w.goal_rotation * np.sum(off_turn**2)
        + w.com * np.sum(np.diff(rounds.com, axis=0) ** 2)
        + w.rotation * np.sum(np.diff(rounds.rpy, axis=0) ** 2)
        + w.toe * np.sum(np.diff(rounds.toes, axis=0) ** 2)
        + w.effort * np.sum(1 / forces.safety_torque[::2])
    )
    return float(cost)


@dataclass(frozen=True)
class Attempt:
    """What became of a sequence: a whole motion, or why there is none."""

    complete: Complete | None
    iterations: int  # of IPOPT
    reason: str = ""


def carry_through(run: Run, lab: Laboratory, sequence: Sequence) -> Attempt:
    """The verified motion of a sequence, planned firmer where it does not hold.

    The program of the motion knows neither buckling nor links that hit a box: where the forces, the
    trajectory or the verification fail it is asked for a larger S_tau, which leaves room for them;
    not where the motion has that S_tau already and would stay what it is. It is asked for all
    margins first, and for less where it finds no motion with them.
    """
    tries = _Tries(run, lab, sequence)
    least = run.scene.spec.force.safety_torque
    for share in _SHARES if run.scene.spec.margins.asked else (0.0,):
        has = 0.0  # S_tau of the motion that was found
        for factor in _FIRMER:
            asked = factor * least
            if asked > sequence.safety_torque:
                break
            if asked <= has:
                continue
            done, motion = tries.carried(asked, share)
            if done is not None:
                return Attempt(done, tries.iterations)
            if not motion.accepted and share > 0:
                break
            has = motion.safety_torque if motion.accepted else 0.0
    return Attempt(None, tries.iterations, tries.reason or "no room for a safety margin")


class _Tries:
    """Motions of one sequence, and what was learnt from those that did not hold."""

    def __init__(self, run: Run, lab: Laboratory, sequence: Sequence) -> None:
        self.run, self.lab, self.sequence = run, lab, sequence
        self.reason, self.iterations = "", 0
        self._parted = False  # with rows that keep limbs and body off everything
        self._met: Rounds | None = None  # a motion that came too close

    def carried(self, asked: float, share: float) -> tuple[Complete | None, Motion]:
        """A motion for an S_tau and a share of the margins, if it holds; and the last one found.

        Where limbs or body come too close to anything it is planned again with rows that keep them
        off, where a limb leaves its reach between two poses with more room to joint bounds.
        """
        rooms = list(_ROOMS)
        room = rooms.pop(0)
        last: Motion | None = None
        while True:
            motion = self._planned(asked, share, room)
            if not motion.accepted:
                found = f"no motion: {motion.block} off by {motion.violation:.2g}"
                self.reason = self.reason or found
                # More room than there is says nothing of the motion without
                return None, last if last is not None and room > _ROOMS[0] else motion
            last, parted = motion, self._parted
            done, leaves_reach = self._followed(motion)
            if done is not None:
                return done, motion
            if leaves_reach and rooms:
                room = rooms.pop(0)
            elif parted or not self._parted:
                return None, motion

    def _planned(self, asked: float, share: float, room: float) -> Motion:
        with self.run.clock.stage("motion"):
            motion = plan_motion(
                self.lab, self.sequence, asked, share, self._parted, self._met, room
            )
        self.iterations += motion.iterations
        return motion

    def _followed(self, motion: Motion) -> tuple[Complete | None, bool]:
        """What follows from a motion, if it holds; whether a limb leaves its reach on the way."""
        leaves_reach = False
        try:
            done, verification = verified(
                self.run, motion.rounds, self.sequence.moved, motion.first
            )
        except NoPlanFound as error:
            self.reason = " ".join(str(error).split())
            self._parted |= isinstance(error, LimbsMeet | SwingMeets)
            leaves_reach = isinstance(error, ReachFailure)
        else:
            if verification.passed:
                return done, False
            self.reason = f"fails its verification: {verification.headline()}"
            failed = {check.name for check in verification.checks if not check.passed}
            self._parted |= not failed.isdisjoint(_TOO_CLOSE)
        if self._parted:
            self._met = motion.rounds
        return None, leaves_reach


@dataclass(frozen=True)
class Found:
    """What a method found."""

    complete: Complete
    sizes: dict[str, dict[str, int]]
    sequences: Sequences | None = None
    warnings: tuple[str, ...] = ()


def assemble(run: Run, found: Found) -> ClimbPlan:
    """The plan of what a method found."""
    loaded, scene, done = run.loaded, run.scene, found.complete
    limits, assumed = step_limits(scene), assumptions(loaded.robot, scene.robot)
    goal = run.tail.goal if run.tail is not None else scene.goal
    if run.tail is not None:
        last = scene.spec.last_goal
        limits = replace(
            limits,
            goal_com=goal.com,
            goal_toes=goal.toes,
            goal_rpy=goal.rpy,
            goal_tolerance=last.tolerance,
            goal_rotation_tolerance=float(np.deg2rad(last.rotation_tolerance_deg)),
        )
    plan = ClimbPlan(
        name=loaded.name,
        robot=scene.robot,
        terrain=scene.terrain,
        rounds=done.rounds,
        instants=done.instants,
        forces=done.forces,
        trajectory=done.trajectory,
        limits=limits,
        status="feasible",
        objective=transition_cost(scene, done.rounds, done.forces, goal),
        bound=None,
        gap=None,
        spec_text=loaded.text,
        spec_sha256=loaded.sha256,
        seed=scene.spec.seed,
        timings=dict(run.clock.seconds),
        solvers={"motion": "ipopt (mumps)", "force": scene.spec.solver.force},
        sizes={**found.sizes, "force": {"instants": done.instants.count}},
        warnings=(*assumed, *found.warnings, *deflection_warnings(done.forces), *done.forces.notes),
        kind="transition",
        sequences=found.sequences,
        robot_texts=robot_texts(loaded.spec.robot, loaded.directory, loaded.robot),
        looks=plan_looks(loaded.robot, scene.robot),
    )
    return replace(plan, summary=summary_lines(plan))
