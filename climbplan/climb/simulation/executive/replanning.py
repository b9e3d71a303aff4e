"""Plan the rest of a plan anew, from the stance that a robot in execution has measured.

Where toes have slid off their footholds, or a surface has less friction than planned, the plan in
execution no longer describes the robot. The planner is asked for another one with the same goal:
it starts from the measured stance, on the friction and with the load that were measured. In a
climb, a limb that has slid moves first. A mission whose transition has ended goes on as a climb.
What is found is verified like every plan.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace

import numpy as np
import yaml
from scipy.spatial.transform import Rotation

from climbplan.arrays import Array
from climbplan.climb.check.verification import verify_plan
from climbplan.climb.plan.climb_plan import ClimbPlan
from climbplan.climb.planner.planner import plan_climb
from climbplan.climb.scene.climb_scene import compute_stated_toes
from climbplan.climb.schema.loading import LoadedClimb, load_planned_climb
from climbplan.climb.schema.model import ClimbSpec, StartSpec
from climbplan.climb.schema.transition import TransitionSpec
from climbplan.climb.schema.transition_loading import LoadedTransition, load_planned_transition
from climbplan.climb.transition.following_climb import METHODS, build_climb_spec
from climbplan.climb.transition.planner import plan_transition
from climbplan.errors import NoPlanFound, SpecError, Unresolved, UsageError
from climbplan.schema.overrides import Override
from climbplan.schema.robots.stored import CarriedRobot, NotKept

_MIN_SLIDE = 0.01  # [m] from which on a toe is off its foothold, so that it moves first
_MIN_LOAD = 0.05  # of the robot's weight, from which on an unknown load is planned with
_SAFETY_FRICTION = 1.3  # most that is asked for on friction that slips have shown
_OPTION = "measured stance"
_MAX_TRANSITION_ROUNDS = 8
_MAX_OFFSET = 0.03  # [m] of a toe from its surface, which is not drift
_SURFACE_DEVIATION, _DRIFT_DEVIATION = 5e-3, 0.03  # [m] of toes from surfaces; of the body
_TURN_DEVIATION = 0.2  # [rad] of the body
_DRIFT_ITERATIONS = 5


@dataclass(frozen=True)
class MeasuredStance:
    """A stance on all N toes, as a robot in execution has measured it; R surfaces."""

    com: Array  # (3,) body origin [m]
    rotation: Array  # (3, 3) body to world
    toes: Array  # (N, 3) [m]
    friction: Array  # (R,) factors on the planned coefficients
    load: Array  # (6,) beside the planned one, about the body's origin [N, N m]
    instant: int  # of the plan in execution
    next_instant: int  # at which the limb is lifted that is to move next


def correct_drift(plan: ClimbPlan, stance: MeasuredStance) -> MeasuredStance:
    """Turn and shift a stance so that its toes lie near the surfaces that they stand on.

    Where most toes have slid, leg odometry has lost the body's pose. With toes p_i on planned
    surfaces of normal n_i through points q_i, the stance moves as a rigid body by the Gauss-Newton
    steps (shift x, turn t about the body's origin c) of

        min  sum_i (n_i . (p_i + x + t x (p_i - c) - q_i))^2 / s^2 + |x|^2 / a^2 + |t|^2 / b^2

    Stances whose toes are all within `_MAX_OFFSET` of their surfaces stay as they are, as surfaces
    may lie elsewhere than planned; so do those on curved terrain.

    Args:
        plan: The plan in execution.
        stance: What was measured.
    """
    standing = plan.instants.contact[stance.instant]
    points = plan.instants.toes[stance.instant, standing]
    normal = plan.instants.normal[stance.instant, standing]
    corrected = stance
    for _ in range(_DRIFT_ITERATIONS):
        offset = ((corrected.toes[standing] - points) * normal).sum(axis=1)
        if corrected is stance and (np.abs(offset).max() < _MAX_OFFSET or plan.terrain.is_curved):
            return stance
        arm = corrected.toes - corrected.com
        rows = np.hstack([normal, np.cross(arm[standing], normal)]) / _SURFACE_DEVIATION
        prior = np.diag(1.0 / np.repeat([_DRIFT_DEVIATION, _TURN_DEVIATION], 3) ** 2)
        step = np.linalg.solve(rows.T @ rows + prior, -rows.T @ offset / _SURFACE_DEVIATION)
        turn = Rotation.from_rotvec(step[3:]).as_matrix()
        com = corrected.com + step[:3]
        corrected = replace(
            corrected, com=com, rotation=turn @ corrected.rotation, toes=com + arm @ turn.T
        )
    return corrected


def replan_climb(plan: ClimbPlan, stance: MeasuredStance) -> ClimbPlan:
    """Plan the rest of a climb, transition or mission anew, from a measured stance.

    Args:
        plan: The plan in execution.
        stance: What was measured.

    Returns:
        A verified plan, whose spec states what was measured.

    Raises:
        UsageError: The plan does not carry what its spec names.
        Unresolved: None of the orders of limbs and numbers of rounds that were tried has a
            verified plan.
    """
    try:
        attempts = _list_attempts(plan, stance)
    except (NotKept, SpecError) as error:
        raise UsageError(f"{plan.name} cannot be planned anew: {error}") from error
    reasons: list[str] = []
    for loaded in attempts:
        replanned, reason = _try_plan(loaded)
        if replanned is not None:
            return replace(replanned, looks=plan.looks)
        reasons.append(reason)
    tried = f"{len(reasons)} combinations of an order of limbs and a number of rounds were tried"
    raise Unresolved(f"no plan from the measured stance: {reasons[0]}", because=tried)


def _try_plan(loaded: LoadedClimb | LoadedTransition) -> tuple[ClimbPlan | None, str]:
    """Return a verified plan, or None and why there is none."""
    try:
        if isinstance(loaded, LoadedClimb):
            replanned = plan_climb(loaded)
        else:
            replanned = plan_transition(loaded, seek_remedies=False)
    except (NoPlanFound, SpecError, UsageError) as error:
        return None, str(error).splitlines()[0]
    verification = verify_plan(replanned)
    return (replanned, "") if verification.passed else (None, verification.headline())


def _list_attempts(
    plan: ClimbPlan, stance: MeasuredStance
) -> Sequence[LoadedClimb | LoadedTransition]:
    """List specs of the rest of a plan, the most promising first.

    Raises NotKept and SpecError where the plan does not carry what its spec names.
    """
    fields_of_robot = {entry.name: getattr(plan.robot, entry.name) for entry in fields(plan.robot)}
    carried = CarriedRobot(plan.robot_texts, fields_of_robot)
    if plan.kind == "climb":
        loaded = load_planned_climb(plan.spec_text, plan.name, carried)
        return _list_climbs(plan, stance, loaded, plan.solvers["method"])
    transition = load_planned_transition(plan.spec_text, plan.name, carried)
    rounds = transition.spec.task.rounds - int(plan.instants.round[stance.next_instant]) + 1
    if rounds < 1:
        text = _state_following_climb(transition.spec)
        loaded = load_planned_climb(text, plan.name, carried)
        return [climb for method in METHODS for climb in _list_climbs(plan, stance, loaded, method)]
    measured = transition.with_overrides(_state_stance(plan, transition.spec, stance))
    any_sequence = Override("task.sequence", "null", _OPTION)
    return [
        measured.with_overrides([Override.of("task.rounds", number, _OPTION), any_sequence])
        for number in (rounds, min(rounds + 1, _MAX_TRANSITION_ROUNDS))
    ]


def _state_following_climb(spec: TransitionSpec) -> str:
    """Return the spec of the climb that follows a transition, as text; its start is to be set."""
    climb = build_climb_spec(spec, StartSpec(com=(0.0, 0.0, 0.0)))
    stated = climb.model_dump(mode="json", exclude_unset=True, by_alias=True)
    stated["force"] = spec.force.model_dump(mode="json", by_alias=True)  # whose defaults differ
    return yaml.safe_dump(stated, sort_keys=False)


def _state_stance(
    plan: ClimbPlan, spec: ClimbSpec | TransitionSpec, stance: MeasuredStance
) -> list[Override]:
    """Return what was measured as values of the plan's spec."""
    region = np.array(
        [plan.terrain.nearest_surface(limb, toe) for limb, toe in enumerate(stance.toes)]
    )
    places = [
        plan.terrain.surfaces[int(index)].project(toe)
        for index, toe in zip(region, stance.toes, strict=True)
    ]
    toes = compute_stated_toes(plan.robot, plan.terrain, np.array(places), region)
    start = {
        "com": stance.com.tolist(),
        "rpy_deg": Rotation.from_matrix(stance.rotation).as_euler("xyz", degrees=True).tolist(),
        "toes": dict(zip(plan.robot.limb_names, toes.tolist(), strict=True)),
    }
    overrides = [Override.of("task.start", start, _OPTION)]
    load = -float(stance.load[2])  # [N] downwards
    if load > _MIN_LOAD * plan.robot.mass * plan.robot.gravity:
        mass = spec.task.payload.mass + load / plan.robot.gravity
        overrides.append(Override.of("task.payload.mass", mass, _OPTION))
    return overrides + _state_friction(plan, spec, stance.friction)


def _state_friction(
    plan: ClimbPlan, spec: ClimbSpec | TransitionSpec, factor: Array
) -> list[Override]:
    """Return friction coefficients times factors (R,), where they are below one."""
    if (factor >= 1.0).all():
        return []
    lowest: dict[str, float] = {}
    for surface, surface_factor in zip(plan.terrain.surfaces, factor, strict=True):
        key = _find_friction_key(spec, surface.name)
        lowest[key] = min(lowest.get(key, np.inf), surface.friction * float(surface_factor))
    overrides = [Override.of(key, value, _OPTION) for key, value in lowest.items()]
    safety = min(spec.force.safety_friction, _SAFETY_FRICTION)
    return [*overrides, Override.of("force.safety_friction", safety, _OPTION)]


def _find_friction_key(spec: ClimbSpec | TransitionSpec, name: str) -> str:
    """Return the key of a surface's friction coefficient in a spec."""
    terrain = spec.terrain
    regions, boxes = ([item.name for item in items] for items in (terrain.regions, terrain.boxes))
    for key, names in (("regions", regions), ("boxes", boxes)):
        if name in names:
            return f"terrain.{key}.{names.index(name)}.friction"
    if name in ("left", "right") and terrain.walls is not None:
        return "terrain.walls.friction"
    if name == "ground" and terrain.ground is not None:
        return "terrain.ground.friction"
    return "terrain.friction"


def _list_climbs(
    plan: ClimbPlan, stance: MeasuredStance, loaded: LoadedClimb, method: str
) -> list[LoadedClimb]:
    """List climbs by orders of limbs and numbers of rounds, the most promising first.

    Args:
        plan: The plan in execution.
        stance: What was measured.
        loaded: The spec of the climb.
        method: Of the planner.
    """
    measured = loaded.with_overrides(
        [
            *_state_stance(plan, loaded.spec, stance),
            Override.of("solver.method", method, _OPTION),  # of `auto` the one that it chose
            Override("study", "null", _OPTION),
        ]
    )
    instants, names = plan.instants, plan.robot.limb_names
    number = int(instants.round[stance.next_instant])
    order = np.nonzero(instants.lifted[instants.round == number])[1].tolist()
    moving = int(np.flatnonzero(instants.lifted[stance.next_instant])[0])
    position = order.index(moving)
    planned = order[position:] + order[:position]
    slide = np.linalg.norm(stance.toes - instants.toes[stance.instant], axis=1)
    slid = [limb for limb in np.argsort(-slide).tolist() if slide[limb] > _MIN_SLIDE]
    first = slid + [limb for limb in planned if limb not in slid]
    rounds = plan.rounds.count - number + 1
    orders = [first, planned] if first != planned else [planned, planned[1:] + planned[:1]]
    attempts = []
    for gait in orders:
        for extra in (0, 1):
            overrides = [Override.of("task.gait", [names[limb] for limb in gait], _OPTION)]
            if measured.spec.task.rounds != "auto":
                overrides.append(Override.of("task.rounds", rounds + extra, _OPTION))
            attempts.append(measured.with_overrides(overrides))
    return attempts
