"""The climb planner: postures, instants, forces, trajectory (chapter 5.1)."""

from __future__ import annotations

import time
from dataclasses import replace
from pathlib import Path

import numpy as np

from climbplan.climb.motion.in_hand import in_hand
from climbplan.climb.motion.motion import StageClock, plan_motion, plan_support
from climbplan.climb.plan.climb_plan import ClimbPlan, Forces, StepLimits
from climbplan.climb.planner.chaining import started
from climbplan.climb.planner.looks import plan_looks
from climbplan.climb.planner.summary import summary_lines
from climbplan.climb.scene.climb_scene import ClimbScene, MotionScene, build_scene, on_scan
from climbplan.climb.scene.within_reach import window_of
from climbplan.climb.schema.loading import LoadedClimb
from climbplan.climb.schema.model import ClimbSpec
from climbplan.errors import NoPlanFound, NotProved, UsageError
from climbplan.progress import Progress
from climbplan.robots.any_robot import assumptions
from climbplan.schema.overrides import Override
from climbplan.schema.robots.stored import robot_texts


def plan_climb(
    loaded: LoadedClimb,
    report: Progress | None = None,
    jobs: int = 1,
    save_model: Path | None = None,
    nodes: float = np.inf,
) -> ClimbPlan:
    """A climb plan for a loaded spec, by its method; that of `auto` is verified in memory.

    report: called with stage name and fraction done. jobs: worker processes of a study. nodes: of
    each search by branch and bound, at most: where they end it, not the time, the answer is the
    same on every machine.
    Raises Infeasible where it is proved that the stated climb has no plan, and NotProved,
    ReachFailure or LimitReached where none was found, all in the robot's terms.
    """
    clock = StageClock(report or (lambda stage, fraction: None))
    begin = time.monotonic()
    loaded = on_scan(started(loaded))

    tried: list[LoadedClimb] = []

    def scene_of(spec: ClimbSpec) -> ClimbScene:
        return build_scene(spec, loaded.robot, loaded.source, loaded.directory)

    def by_method(given: LoadedClimb, deadline: float) -> ClimbPlan:
        # Other methods than the first of `auto` have no mixed-integer program to write
        saved = save_model if loaded.spec.solver.method != "auto" or not tried else None
        tried.append(given)
        return plan_by_method(given, clock, deadline, saved, nodes)

    limit = loaded.spec.solver.time_limit
    if loaded.spec.solver.method == "auto":
        from climbplan.climb.planner.automatic import plan_automatically

        plan = plan_automatically(loaded, scene_of, by_method)
    else:
        try:
            plan = by_method(loaded, begin + limit)
        except NoPlanFound as error:
            from climbplan.climb.planner.proof import PROOF_SHARE, proof_of_infeasibility

            # What a method cannot do proves nothing; a proof is worth more than what it says
            end = time.monotonic() + PROOF_SHARE * limit
            proof = proof_of_infeasibility(scene_of(loaded.spec), end, nodes)
            if proof is None:
                raise
            raise proof from error
    if loaded.spec.study is not None:
        from climbplan.climb.planner.study import run_study

        with clock.stage("study"):
            plan = replace(plan, study=run_study(loaded, jobs, clock.report))
    plan = replace(plan, timings=dict(clock.seconds))
    return replace(plan, summary=summary_lines(plan))


def plan_by_method(
    loaded: LoadedClimb,
    clock: StageClock,
    deadline: float,
    save_model: Path | None = None,
    nodes: float = np.inf,
) -> ClimbPlan:
    """A climb plan by the method of the spec, not yet verified.

    deadline: `time.monotonic` [s] at which the search for postures ends; nodes: of each search by
    branch and bound, at most. Raises NotProved, ReachFailure or LimitReached.
    """
    spec = loaded.spec
    scene = build_scene(spec, loaded.robot, loaded.source, loaded.directory)
    if scene.terrain.scan is not None:
        _require_held(scene)
    assumed = assumptions(loaded.robot, scene.robot)
    window = window_of(scene)
    if window is None:
        motion = plan_motion(scene, clock, save_model, deadline, nodes=nodes)
        supported = plan_support(scene, motion, clock, deadline, nodes)
    else:
        if save_model is not None:
            raise UsageError("--save-model writes one mixed-integer program: plan without windows")
        from climbplan.climb.windows.windows import plan_in_windows

        found = plan_in_windows(scene, window, clock, deadline)
        scene, supported = found.scene, found.supported
        if spec.task.rounds == "auto":
            # As with a start from another plan, the text says what was chosen
            count = str(scene.spec.task.round_count)
            loaded = loaded.with_overrides([Override("task.rounds", count, "rounds: auto")])
    motion, forces = supported.motion, supported.forces
    rounds, instants = motion.posture.rounds, motion.instants
    with clock.stage("trajectory"):
        forces, trajectory = in_hand(scene, rounds, instants, forces, motion.swings)
    grips, grips_told = None, tuple[str, ...]()
    if scene.grippers is not None:
        from climbplan.climb.forces.grips.plan import grip_plan, grip_warnings

        grips = grip_plan(scene, instants, forces, trajectory)
        grips_told = grip_warnings(scene, instants)
    plan = ClimbPlan(
        name=loaded.name,
        robot=scene.robot,
        terrain=scene.terrain,
        rounds=rounds,
        instants=instants,
        forces=forces,
        trajectory=trajectory,
        limits=step_limits(scene),
        status=motion.posture.status,
        objective=motion.posture.objective,
        bound=motion.posture.bound,
        gap=motion.posture.gap,
        spec_text=loaded.text,
        spec_sha256=loaded.sha256,
        seed=spec.seed,
        timings=dict(clock.seconds),
        solvers={
            "method": spec.solver.method,
            "posture": motion.posture.solver,
            "force": spec.solver.force,
        },
        sizes={
            "posture": {**motion.posture.sizes, "nodes": motion.posture.nodes},
            "force": {"instants": instants.count},
        },
        warnings=(
            *motion.posture.warnings,
            *motion.tightenings,
            *deflection_warnings(forces),
            *forces.notes,
            *assumed,
            *grips_told,
        ),
        grips=grips,
        robot_texts=robot_texts(spec.robot, loaded.directory, loaded.robot),
        looks=plan_looks(loaded.robot, scene.robot),
    )
    return replace(plan, summary=summary_lines(plan))


def _require_held(scene: ClimbScene) -> None:
    """Raise NotProved where no toes on the regions found in a scan could hold start or goal."""
    from climbplan.climb.planner.holding import unheld

    if places := unheld(scene):
        raise NotProved(
            "; ".join(f"{place.where}: {place}" for place in places),
            because="regions are those found in the scan, which face the body's way; what is too "
            "small for toes, or faces away, may hold it",
            stage="proof",
        )


def deflection_warnings(forces: Forces) -> tuple[str, ...]:
    """What a body that is to sag is in for: more than the linear model of eq. (4.11) tells."""
    if not forces.com_deflection.any():
        return ()
    shift = float(np.linalg.norm(forces.com_deflection[:, :3], axis=1).max())
    tilt = float(np.linalg.norm(forces.com_deflection[:, 3:], axis=1).max())
    text = (
        f"by the linear model the body moves up to {1e3 * shift:.0f} mm and turns up to "
        f"{np.rad2deg(tilt):.1f} deg from its planned pose; clearances are those of the planned "
        "pose, and what joints that are springs really do is told by the checks static.*, not "
        "judged; force.sag: compensated holds the pose exactly"
    )
    return (text,)


def step_limits(scene: MotionScene) -> StepLimits:
    """The bounds a plan is verified against."""
    steps, force = scene.spec.posture.steps, scene.spec.force
    return StepLimits(
        com_max=steps.com_max,
        toe_max=steps.toe_max,
        rotation_max=float(np.deg2rad(steps.rotation_max_deg)),
        com_min=steps.com_min,
        toe_min=steps.toe_min,
        shift_max=steps.shift_max,
        goal_com=scene.goal.com,
        goal_toes=scene.goal.toes,
        goal_tolerance=scene.spec.task.goal.tolerance,
        goal_rpy=scene.goal.rpy,
        goal_rotation_tolerance=float(np.deg2rad(scene.spec.task.goal.rotation_tolerance_deg)),
        body_clearance=scene.spec.posture.body_clearance,
        safety_friction=force.safety_friction,
        safety_torque=force.safety_torque,
    )
