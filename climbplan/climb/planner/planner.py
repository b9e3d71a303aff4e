"""The climb planner: postures, instants, forces, trajectory (chapter 5.1).

Equation and chapter numbers are those of X. Lin (UCLA 2022).
"""

from __future__ import annotations

import logging
import time
from dataclasses import replace
from pathlib import Path

import numpy as np

from climbplan.arrays import Array
from climbplan.climb.motion.in_hand import plan_with_torque_reserve
from climbplan.climb.motion.motion import ClimbMotion, StageClock, plan_motion, plan_support
from climbplan.climb.motion.open_rounds import OpenRoundsMotion, PartialClimb
from climbplan.climb.plan.climb_plan import ClimbPlan, InstantForces, StepLimits, Trajectory
from climbplan.climb.planner.start_from_plan import resolve_start_plan
from climbplan.climb.planner.summary import format_summary
from climbplan.climb.planner.visual_geometry import load_visual_geometry
from climbplan.climb.scene.climb_scene import (
    ClimbScene,
    ClimbStance,
    MotionScene,
    apply_scan,
    build_scene,
)
from climbplan.climb.scene.within_reach import select_window
from climbplan.climb.schema.loading import LoadedClimb
from climbplan.climb.schema.model import ClimbSpec
from climbplan.errors import NoPlanFound, SpecError, Unresolved, UsageError
from climbplan.progress import Progress
from climbplan.robots.any_robot import list_assumptions
from climbplan.schema.overrides import Override
from climbplan.schema.robots.stored import collect_robot_texts
from climbplan.terrain.surfaces import Region

_SEARCH = "contact-search"
_log = logging.getLogger(__name__)


def plan_climb(
    loaded: LoadedClimb,
    report: Progress | None = None,
    jobs: int = 1,
    save_model: Path | None = None,
    nodes: float = np.inf,
    *,
    seek_remedies: bool = True,
) -> ClimbPlan:
    """Plan a climb by the method of its spec; plans of method `auto` are verified in memory.

    Args:
        loaded: The loaded spec.
        report: Called with the name of a stage and the fraction of it that is done.
        jobs: Number of worker processes of a study.
        save_model: File for the mixed-integer program; None for no file.
        nodes: Largest number of nodes of each branch and bound. Where this limit ends a search
            before the time limit does, the answer is the same on every machine.
        seek_remedies: Whether method `auto` plans changed specs where it finds no plan, to name
            changes with which there is one. It may take as long as the search itself.

    Raises:
        Infeasible: It is proved that the stated climb has no plan.
        Unresolved: No plan was found, which proves nothing.
        ReachFailure: A limb cannot reach its toe.
        LimitReached: A time or node limit ended the search.

        Where part of the way was planned, `partial` of the error is a `ClimbPlan`.
    """
    clock = StageClock(report or (lambda stage, fraction: None))
    begin = time.monotonic()
    loaded = apply_scan(resolve_start_plan(loaded))
    attempts: list[LoadedClimb] = []

    def build_scene_of_spec(spec: ClimbSpec) -> ClimbScene:
        return build_scene(spec, loaded.robot, loaded.source, loaded.directory)

    def plan_until(climb: LoadedClimb, deadline: float) -> ClimbPlan:
        # Other methods than the first of `auto` have no mixed-integer program to write
        model_path = save_model if loaded.spec.solver.method != "auto" or not attempts else None
        attempts.append(climb)
        return plan_by_method(climb, clock, deadline, model_path, nodes)

    try:
        if loaded.spec.solver.method == "auto":
            from climbplan.climb.planner.automatic import plan_automatically

            plan = plan_automatically(loaded, build_scene_of_spec, plan_until, seek_remedies)
        else:
            try:
                plan = plan_until(loaded, begin + loaded.spec.solver.time_limit)
            except NoPlanFound as error:
                _raise_proof(build_scene_of_spec(loaded.spec), error, nodes)
                raise
    except NoPlanFound as error:
        if isinstance(error.partial, PartialClimb):
            error.partial = _complete_partial_plan(error.partial, clock)
        raise
    plan = replace(_add_study(plan, loaded, jobs, clock), timings=dict(clock.seconds))
    return replace(plan, summary=format_summary(plan))


def _add_study(plan: ClimbPlan, loaded: LoadedClimb, jobs: int, clock: StageClock) -> ClimbPlan:
    """Return the plan with the study that its spec asks for, if any."""
    if loaded.spec.study is None:
        return plan
    from climbplan.climb.planner.study import run_study

    with clock.stage("study"):
        return replace(plan, study=run_study(loaded, jobs, clock.report))


def _raise_proof(scene: ClimbScene, error: NoPlanFound, nodes: float) -> None:
    """Raise Infeasible where it is proved that a scene has no plan.

    What a method cannot do proves nothing; a proof is worth more than what it says.
    """
    from climbplan.climb.planner.proof import PROOF_TIME_FRACTION, prove_infeasibility

    end = time.monotonic() + PROOF_TIME_FRACTION * scene.spec.solver.time_limit
    proof = prove_infeasibility(scene, end, nodes)
    if proof is not None:
        raise proof from error


def plan_by_method(
    loaded: LoadedClimb,
    clock: StageClock,
    deadline: float,
    save_model: Path | None = None,
    nodes: float = np.inf,
) -> ClimbPlan:
    """Plan a climb by the method of its spec, without verification.

    Args:
        loaded: The loaded spec; its method is not `auto` unless the climb is planned in windows.
        clock: Measures the stages.
        deadline: `time.monotonic` [s] at which the search for postures ends.
        save_model: File for the mixed-integer program; None for no file.
        nodes: Largest number of nodes of each branch and bound.

    Raises:
        Unresolved: No plan was found.
        ReachFailure: A limb cannot reach its toe.
        LimitReached: A limit ended the search.
    """
    spec = loaded.spec
    scene = build_scene(spec, loaded.robot, loaded.source, loaded.directory)
    if scene.terrain.scan is not None:
        _require_support(scene)
    assumed = list_assumptions(loaded.robot, scene.robot)
    window_size = select_window(scene)
    if save_model is not None and (window_size is not None or spec.solver.method == _SEARCH):
        raise UsageError("--save-model writes one mixed-integer program: plan without windows")
    try:
        if spec.solver.method == _SEARCH:
            from climbplan.climb.contact_search.planner import plan_by_contact_search

            planned = plan_by_contact_search(scene, clock, deadline, nodes)
        elif window_size is None:
            motion = plan_motion(scene, clock, save_model, deadline, nodes=nodes)
            planned = OpenRoundsMotion(scene, plan_support(scene, motion, clock, deadline, nodes))
        else:
            from climbplan.climb.windows.windows import plan_in_windows

            planned = plan_in_windows(scene, window_size, clock, deadline)
    except NoPlanFound as error:
        if isinstance(error.partial, PartialClimb):
            error.partial = replace(error.partial, loaded=loaded)
        raise
    return _time_motion(loaded, planned, clock, assumed)


def _complete_partial_plan(partial: PartialClimb, clock: StageClock) -> ClimbPlan | None:
    """Return what was found before a search ended, as the plan of a nearer goal.

    Forces and trajectory of the whole part are planned here; None where that fails.
    """
    loaded = partial.loaded
    assert loaded is not None
    goal = {"com": partial.end.com.tolist(), "rpy_deg": np.rad2deg(partial.end.rpy).tolist()}
    overrides = [Override.of(f"task.goal.{key}", goal[key], "partial plan") for key in goal]
    try:
        nearer = loaded.with_overrides(overrides)
        scene = build_scene(nearer.spec, nearer.robot, nearer.source, nearer.directory)
        planned = partial.build(scene)
        plan = _time_motion(
            nearer, planned, clock, list_assumptions(nearer.robot, planned.scene.robot)
        )
    except (NoPlanFound, SpecError) as failure:
        _log.info("partial   %s", failure)
        return None
    note = (
        f"partial: {partial.covered:.2f} of {partial.length:.2f} m of the way to the goal, in "
        f"{partial.num_rounds} rounds; the goal in the plan's spec is where it ends"
    )
    return replace(plan, status="partial", warnings=(note, *plan.warnings))


def _find_surface_points(scene: ClimbScene, stance: ClimbStance) -> Array:
    """Return the points (N, 3) of the surfaces below the toes, as a spec states them."""
    points = stance.toes.copy()
    for limb, region in enumerate(stance.region):
        surface = scene.terrain.surfaces[int(region)]
        if isinstance(surface, Region):
            points[limb] -= surface.standoff * surface.normal
    return points


def _time_motion(
    loaded: LoadedClimb, planned: OpenRoundsMotion, clock: StageClock, assumed: tuple[str, ...]
) -> ClimbPlan:
    """Return the plan of a motion, with its trajectory."""
    spec, scene, supported = loaded.spec, planned.scene, planned.supported
    if spec.task.rounds == "auto":
        # As with a start from another plan, the text says what was chosen
        names, toes = scene.robot.limb_names, _find_surface_points(scene, scene.goal).tolist()
        loaded = loaded.with_overrides(
            [
                Override("task.rounds", str(scene.spec.task.round_count), "rounds: auto"),
                Override.of("task.goal.toes", dict(zip(names, toes, strict=True)), "rounds: auto"),
            ]
        )
    motion, forces = supported.motion, supported.forces
    with clock.stage("trajectory"):
        forces, trajectory = plan_with_torque_reserve(
            scene, motion.posture.rounds, motion.instants, forces, motion.swings
        )
    timings = dict(clock.seconds)
    plan = _assemble_plan(
        loaded, scene, motion, forces, trajectory, timings=timings, assumed=assumed
    )
    return replace(plan, summary=format_summary(plan))


def _assemble_plan(
    loaded: LoadedClimb,
    scene: ClimbScene,
    motion: ClimbMotion,
    forces: InstantForces,
    trajectory: Trajectory,
    *,
    timings: dict[str, float],
    assumed: tuple[str, ...],
) -> ClimbPlan:
    """Assemble the plan with grips, warnings and the robot's texts, without its summary."""
    spec, instants = loaded.spec, motion.instants
    grips, grip_notes = None, tuple[str, ...]()
    if scene.grippers is not None:
        from climbplan.climb.forces.grips.plan import build_grip_plan, warn_of_extrapolation

        grips = build_grip_plan(scene, instants, forces, trajectory)
        grip_notes = warn_of_extrapolation(scene, instants)
    return ClimbPlan(
        name=loaded.name,
        robot=scene.robot,
        terrain=scene.terrain,
        rounds=motion.posture.rounds,
        instants=instants,
        forces=forces,
        trajectory=trajectory,
        limits=build_step_limits(scene),
        status=motion.posture.status,
        objective=motion.posture.objective,
        bound=motion.posture.bound,
        gap=motion.posture.gap,
        spec_text=loaded.text,
        spec_sha256=loaded.sha256,
        seed=spec.seed,
        timings=timings,
        solvers={
            "method": spec.solver.method,
            "posture": motion.posture.solver,
            "force": spec.solver.force_solver,
        },
        sizes={
            "posture": {**motion.posture.sizes, "nodes": motion.posture.nodes},
            "force": {"instants": instants.count},
        },
        warnings=(
            *motion.posture.warnings,
            *describe_deflection(forces),
            *forces.notes,
            *assumed,
            *grip_notes,
        ),
        notes=(*motion.posture.notes, *motion.tightenings),
        grips=grips,
        robot_texts=collect_robot_texts(spec.robot, loaded.directory, loaded.robot)
        if loaded.carried_robot is None
        else loaded.carried_robot.texts,
        looks=load_visual_geometry(loaded.robot, scene.robot),
    )


def _require_support(scene: ClimbScene) -> None:
    """Raise Unresolved where no toes on the regions of a scan could support start or goal."""
    from climbplan.climb.planner.static_feasibility import find_unsupported_places

    if unsupported := find_unsupported_places(scene):
        raise Unresolved(
            "; ".join(f"{place.place}: {place}" for place in unsupported),
            because="regions are those found in the scan, which face the body's way; what is too "
            "small for toes, or faces away, may hold it",
            stage="proof",
        )


def describe_deflection(forces: InstantForces) -> tuple[str, ...]:
    """Return the warning that an uncompensated body moves, by the linear model of eq. (4.11).

    The result is empty where forces deflect no body. The tuple has at most one entry.
    """
    if not forces.com_deflection.any():
        return ()
    shift = float(np.linalg.norm(forces.com_deflection[:, :3], axis=1).max())
    tilt = float(np.linalg.norm(forces.com_deflection[:, 3:], axis=1).max())
    text = (
        f"by the linear model the body moves up to {1e3 * shift:.0f} mm and turns up to "
        f"{np.rad2deg(tilt):.1f} deg from its planned pose; clearances are those of the planned "
        "pose, and what joints that are springs really do is told by the checks static.*, not "
        "judged; force.deflection_compensation: compensated holds the pose exactly"
    )
    return (text,)


def build_step_limits(scene: MotionScene) -> StepLimits:
    """Return the bounds that a plan is verified against."""
    steps, force = scene.spec.posture.steps, scene.spec.force
    return StepLimits(
        com_max=steps.com_max,
        toe_max=steps.toe_max,
        rotation_max=float(np.deg2rad(steps.rotation_max_deg)),
        com_min=steps.com_min,
        toe_min=steps.toe_min,
        shift_max=steps.com_shift_max,
        goal_com=scene.goal.com,
        goal_toes=scene.goal.toes,
        goal_tolerance=scene.spec.task.goal.tolerance,
        goal_rpy=scene.goal.rpy,
        goal_rotation_tolerance=float(np.deg2rad(scene.spec.task.goal.rotation_tolerance_deg)),
        body_clearance=scene.spec.posture.body_clearance,
        safety_friction=force.safety_friction,
        safety_torque=force.safety_torque,
    )
