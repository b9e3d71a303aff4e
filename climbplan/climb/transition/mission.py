"""From the ground to the top: a transition goes on as a climb, in one plan.

The climb starts where the transition ends, body and toes, and is planned as any climb is: postures,
then one limb at a time. Its rounds follow those of the transition; forces, trajectory and
verification are those of the whole.
"""

from __future__ import annotations

import time
from dataclasses import dataclass, replace

import numpy as np

from climbplan.climb.motion.motion import Motion, StageClock, plan_motion
from climbplan.climb.plan.climb_plan import Instants, Rounds
from climbplan.climb.postures.explanation import NoPostures
from climbplan.climb.scene.climb_scene import ClimbScene, Stance, build_scene, toes_as_stated
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
from climbplan.errors import NoPlanFound, NotProved, Remedy
from climbplan.robots.kinematics import to_body

_SHARE = 0.5  # of the time limit, for the climb's postures
_METHODS = ("micp", "nlp")  # the first whose postures hold is taken
_OF_CLIMB = ("task.rounds", "task.goal", "task.gait", "posture.")  # of a climb's keys, in `climb`


@dataclass(frozen=True)
class Tail:
    """The climb after a transition; rounds count on from the transition's."""

    rounds: Rounds  # the first posture is the transition's last
    instants: Instants
    goal: Stance


def climb_after(loaded: LoadedTransition, scene: TransitionScene, clock: StageClock) -> Tail | None:
    """The climb that the spec asks for after the transition; None if it asks for none.

    Raises what planning a climb raises.
    """
    if scene.spec.climb is None:
        return None
    climb = _climb_scene(loaded, scene)
    motion = _climb_motion(climb, clock)
    instants = replace(motion.instants, round=motion.instants.round + scene.spec.task.rounds)
    return Tail(motion.posture.rounds, instants, climb.goal)


def _climb_motion(climb: ClimbScene, clock: StageClock) -> Motion:
    """The climb's postures by the global method, and where that fails with exact rotations."""
    deadline = time.monotonic() + climb.spec.solver.time_limit
    first: NoPlanFound | None = None
    lacked = []
    for method in _METHODS:
        solver = climb.spec.solver.model_copy(update={"method": method})
        scene = replace(climb, spec=climb.spec.model_copy(update={"solver": solver}))
        try:
            return plan_motion(scene, clock, deadline=deadline)
        except NoPlanFound as error:
            first = first or error
            lacked.append(f"{method}: {error.message.partition(chr(10))[0]}")
    assert first is not None
    changes = first.changes if isinstance(first, NoPostures) else ()
    told = "\n".join(f"  {line}" for line in lacked)
    raise NotProved(
        f"no postures for the climb after the transition:\n{told}",
        [
            replace(c, where=f"climb, {c.where}", remedies=tuple(map(_renamed, c.remedies)))
            for c in first.conflicts
        ],
        because="the transition's end is given, and method nlp is local",
        stage=first.stage,
        remedies=[_renamed(remedy) for remedy in (*first.remedies, *changes)],
    ) from first


def _renamed(remedy: Remedy) -> Remedy:
    """A change of a climb as one of the spec that has it for a part."""
    if not remedy.key.startswith(_OF_CLIMB):
        return remedy
    return replace(remedy, key="climb." + remedy.key.removeprefix("task."))


def _climb_scene(loaded: LoadedTransition, scene: TransitionScene) -> ClimbScene:
    """The climb's own scene: the same robot and terrain, from where the transition ends."""
    goal, names = scene.goal, scene.robot.limb_names
    touching = toes_as_stated(scene.robot, scene.terrain, goal.toes, goal.region)
    toes = {
        name: (float(toe[0]), float(toe[1]), float(toe[2]))
        for name, toe in zip(names, touching, strict=True)
    }
    com = (float(goal.com[0]), float(goal.com[1]), float(goal.com[2]))
    start = StartSpec(com=com, rpy_deg=scene.spec.task.goal.rpy_deg, toes=toes)
    own = _climb_spec(scene.spec, start)
    built = build_scene(own, loaded.robot, loaded.source, loaded.directory)
    # Toes are those of the transition to the last digit, so that the postures join.
    stance = to_body(goal.com, goal.rpy, goal.toes)
    robot = replace(scene.robot, stance_body=stance)
    return replace(built, robot=robot, terrain=scene.terrain, start=goal)


def _climb_spec(spec: TransitionSpec, start: StartSpec) -> ClimbSpec:
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
        posture=_within(climb.posture, spec.posture),
        force=spec.force,
        margins=spec.margins,
        trajectory=spec.trajectory,
        solver=SolverSpec(time_limit=_SHARE * spec.solver.time_limit),
        seed=spec.seed,
    )


def _within(own: PosturePlannerSpec, whole: TransitionPostureSpec) -> PosturePlannerSpec:
    """The climb's posture planner, bounded by what the whole plan is verified against."""
    steps = own.steps.model_copy(
        update={
            "com_max": min(own.steps.com_max, whole.steps.com_max),
            "toe_max": min(own.steps.toe_max, whole.steps.toe_max),
            "shift_max": whole.steps.shift_max,
            "rotation_max_deg": min(own.steps.rotation_max_deg, whole.steps.rotation_max_deg),
        }
    )
    clearance = max(own.body_clearance, whole.body_clearance)
    return own.model_copy(update={"steps": steps, "body_clearance": clearance})


def joined_rounds(first: Rounds, tail: Rounds) -> Rounds:
    """Postures of both; the first of the tail is the last of the other."""
    return Rounds(
        **{
            name: np.concatenate([value, vars(tail)[name][1:]])
            for name, value in vars(first).items()
        }
    )


def joined_instants(first: Instants, tail: Instants) -> Instants:
    """Instants of both."""
    return Instants(
        **{name: np.concatenate([value, vars(tail)[name]]) for name, value in vars(first).items()}
    )
