"""Plan a climb that follows a transition, in one plan from the ground to the top.

The climb starts where the transition ends, body and toes, and is planned as any climb is: postures,
then one limb at a time. Its rounds follow those of the transition; forces, trajectory and
verification are those of the whole.
"""

from __future__ import annotations

import time
from dataclasses import dataclass, replace

import numpy as np

from climbplan.climb.motion.motion import ClimbMotion, StageClock, plan_motion
from climbplan.climb.plan.climb_plan import Instants, Rounds
from climbplan.climb.postures.explanation import NoPostures
from climbplan.climb.scene.climb_scene import (
    ClimbScene,
    ClimbStance,
    build_scene,
    compute_stated_toes,
)
from climbplan.climb.schema.model import (
    ClimbSpec,
    PosturePlannerSpec,
    SolverSpec,
    StartSpec,
    TaskSpec,
)
from climbplan.climb.schema.transition import TransitionPostureSpec, TransitionSpec
from climbplan.climb.schema.transition_loading import LoadedTransition
from climbplan.climb.transition.scene import TransitionScene
from climbplan.errors import NoPlanFound, Remedy, Unresolved
from climbplan.robots.kinematics import standing_inverse, to_body
from climbplan.robots.model import Robot

_TIME_FRACTION = 0.5  # of the time limit, for the climb's postures
METHODS = ("micp", "nlp")  # the first whose postures hold is taken
_CLIMB_KEYS = ("task.rounds", "task.goal", "task.gait", "posture.")  # of a climb's keys, in `climb`


@dataclass(frozen=True)
class FollowingClimb:
    """The climb after a transition; rounds count on from the transition's."""

    rounds: Rounds  # the first posture is the transition's last
    instants: Instants
    goal: ClimbStance


def plan_following_climb(
    loaded: LoadedTransition, scene: TransitionScene, clock: StageClock
) -> FollowingClimb | None:
    """Plan the climb that the spec requests after the transition; None if there is none.

    Raises what planning a climb raises.
    """
    if scene.spec.climb is None:
        return None
    climb = _build_climb_scene(loaded, scene)
    motion = _plan_climb_motion(climb, clock)
    instants = replace(motion.instants, round=motion.instants.round + scene.spec.task.rounds)
    return FollowingClimb(motion.posture.rounds, instants, climb.goal)


def _plan_climb_motion(climb: ClimbScene, clock: StageClock) -> ClimbMotion:
    """Plan the climb's postures by the global method; if that fails, with exact rotations."""
    deadline = time.monotonic() + climb.spec.solver.time_limit
    first_error: NoPlanFound | None = None
    reasons = []
    for method in METHODS:
        solver = climb.spec.solver.model_copy(update={"method": method})
        scene = replace(climb, spec=climb.spec.model_copy(update={"solver": solver}))
        try:
            return plan_motion(scene, clock, deadline=deadline)
        except NoPlanFound as error:
            first_error = first_error or error
            reasons.append(f"{method}: {error.message.partition(chr(10))[0]}")
    assert first_error is not None
    changes = first_error.changes if isinstance(first_error, NoPostures) else ()
    reasons_text = "\n".join(f"  {line}" for line in reasons)
    raise Unresolved(
        f"no postures for the climb after the transition:\n{reasons_text}",
        [
            replace(c, where=f"climb, {c.where}", remedies=tuple(map(_rename_remedy, c.remedies)))
            for c in first_error.conflicts
        ],
        because="the transition's end is given, and method nlp is local",
        stage=first_error.stage,
        remedies=[_rename_remedy(remedy) for remedy in (*first_error.remedies, *changes)],
    ) from first_error


def _rename_remedy(remedy: Remedy) -> Remedy:
    """Rename a remedy's key of a climb to that of the spec that contains the climb."""
    if not remedy.key.startswith(_CLIMB_KEYS):
        return remedy
    return replace(remedy, key="climb." + remedy.key.removeprefix("task."))


def _build_climb_scene(loaded: LoadedTransition, scene: TransitionScene) -> ClimbScene:
    """Build the climb's scene: the same robot and terrain, from the transition's end."""
    goal, names = scene.goal, scene.robot.limb_names
    touching = compute_stated_toes(scene.robot, scene.terrain, goal.toes, goal.region)
    toes = {
        name: (float(toe[0]), float(toe[1]), float(toe[2]))
        for name, toe in zip(names, touching, strict=True)
    }
    com = (float(goal.com[0]), float(goal.com[1]), float(goal.com[2]))
    start = StartSpec(com=com, rpy_deg=scene.spec.task.goal.rpy_deg, toes=toes)
    climb_spec = build_climb_spec(scene.spec, start)
    built = build_scene(climb_spec, loaded.robot, loaded.source, loaded.directory)
    # Toes are those of the transition to the last digit, so that the postures join.
    stance = to_body(goal.com, goal.rpy, goal.toes)
    robot = replace(scene.robot, stance_body=stance)
    return replace(built, robot=robot, terrain=scene.terrain, start=goal)


def build_climb_spec(spec: TransitionSpec, start: StartSpec) -> ClimbSpec:
    """Build the spec of the climb that follows a transition, from a start of its own.

    Raises ValueError for a transition that no climb follows.
    """
    climb = spec.climb
    if climb is None:
        raise ValueError("the spec asks for no climb")
    task = TaskSpec(
        rounds=climb.rounds,
        start=start,
        goal=climb.goal,
        gait=climb.gait,
        payload=spec.task.payload,
        external_wrench=spec.task.external_wrench,
    )
    return ClimbSpec(
        kind="climb",
        robot=spec.robot,
        terrain=spec.terrain,
        task=task,
        posture=_bound_postures(climb.posture, spec.posture),
        force=spec.force,
        margins=spec.margins,
        trajectory=spec.trajectory,
        solver=SolverSpec(time_limit=_TIME_FRACTION * spec.solver.time_limit),
        seed=spec.seed,
    )


def _bound_postures(
    postures: PosturePlannerSpec, limits: TransitionPostureSpec
) -> PosturePlannerSpec:
    """Bound the climb's posture planner by the limits that the whole plan is verified against."""
    steps = postures.steps.model_copy(
        update={
            "com_max": min(postures.steps.com_max, limits.steps.com_max),
            "toe_max": min(postures.steps.toe_max, limits.steps.toe_max),
            "com_shift_max": limits.steps.com_shift_max,
            "rotation_max_deg": min(postures.steps.rotation_max_deg, limits.steps.rotation_max_deg),
        }
    )
    clearance = max(postures.body_clearance, limits.body_clearance)
    return postures.model_copy(update={"steps": steps, "body_clearance": clearance})


def join_rounds(first: Rounds, tail: Rounds) -> Rounds:
    """Join the postures of both; the first of the tail is the last of the other."""
    return Rounds(
        **{
            name: np.concatenate([value, vars(tail)[name][1:]])
            for name, value in vars(first).items()
        }
    )


def join_instants(robot: Robot, first: Instants, tail: Instants) -> Instants:
    """Join the instants of both.

    The last push of the first leads the body to where it waits for the first lift of the tail,
    which may be shifted off the straight way.
    """
    joined = Instants(
        **{name: np.concatenate([value, vars(tail)[name]]) for name, value in vars(first).items()}
    )
    push, lift = first.count - 1, first.count
    joined.com[push], joined.rpy[push] = joined.com[lift], joined.rpy[lift]
    joined.joint_angles[push] = standing_inverse(
        robot, joined.com[push], joined.rpy[push], joined.toes[push], joined.normal[push]
    ).best()
    return joined
