"""The transition planner: sequences, motion, instants, forces, trajectory (chapter 5.3)."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from climbplan.climb.forces.planner import plan_forces
from climbplan.climb.planner import Progress, StageClock, deflection_warnings, step_limits
from climbplan.climb.trajectory import plan_trajectory
from climbplan.errors import Infeasible, LimitReached, ReachFailure
from climbplan.plans.climb_plan import (
    ClimbPlan,
    Forces,
    Instants,
    Mask,
    Rounds,
    Sequences,
    Trajectory,
)
from climbplan.spec.transition_loading import LoadedTransition
from climbplan.transition.gait import plan_instants
from climbplan.transition.motion import Motion, plan_motion
from climbplan.transition.refusal import no_sequence
from climbplan.transition.scene import TransitionScene, build_transition
from climbplan.transition.search import Search, Sequence
from climbplan.transition.summary import summary_lines

_FIRMER = (1.0, 1.15, 1.35)  # factors on S_tau tried in turn for one sequence


@dataclass(frozen=True)
class Complete:
    """A motion with everything that follows from it."""

    rounds: Rounds
    instants: Instants
    forces: Forces
    trajectory: Trajectory


def complete(scene: TransitionScene, rounds: Rounds, moved: Mask, clock: StageClock) -> Complete:
    """Instants, forces and trajectory of postures; raises what each of them raises."""
    with clock.stage("kinematics"):
        instants = plan_instants(scene, rounds, moved)
    with clock.stage("force"):
        forces = plan_forces(scene, instants)
    with clock.stage("trajectory"):
        trajectory = plan_trajectory(scene, rounds, instants, forces)
    return Complete(rounds, instants, forces, trajectory)


def transition_cost(scene: TransitionScene, rounds: Rounds, forces: Forces) -> float:
    """Body, turn and toe steps, and 1 / S_tau at every lift, weighted as in the spec."""
    w = scene.spec.posture.weights
    cost = (
        w.com * np.sum(np.diff(rounds.com, axis=0) ** 2)
        + w.rotation * np.sum(np.diff(rounds.rpy, axis=0) ** 2)
        + w.toe * np.sum(np.diff(rounds.toes, axis=0) ** 2)
        + w.effort * np.sum(1 / forces.safety_torque[::2])
    )
    return float(cost)


@dataclass(frozen=True)
class Attempt:
    """A sequence whose motion was planned."""

    number: int  # in the list of sequences
    motion: Motion
    complete: Complete


def _planned(
    search: Search, found: list[Sequence], clock: StageClock, outcome: list[str]
) -> Attempt:
    """The first sequence whose motion holds; outcomes of those before it are filled in."""
    scene = search.scene
    for number, sequence in enumerate(found[: scene.spec.search.tried]):
        reason = ""
        for factor in _FIRMER:
            asked = factor * scene.spec.force.safety_torque
            if asked > sequence.safety_torque:
                break
            with clock.stage("motion"):
                motion = plan_motion(search.lab, sequence, asked)
            if not motion.accepted:
                reason = f"no motion: {motion.block} off by {motion.violation:.2g}"
                continue
            try:
                done = complete(scene, motion.rounds, sequence.moved, clock)
            except (Infeasible, ReachFailure, LimitReached) as error:
                reason = " ".join(str(error).split())
                continue
            outcome[number] = "chosen"
            return Attempt(number, motion, done)
        outcome[number] = reason or "no room for a safety margin"
    refused = [f"{search.name(s)}: {o}" for s, o in zip(found, outcome, strict=True) if o]
    raise LimitReached("\n".join(["no sequence could be planned to the end", *refused[:5]]))


def plan_transition(loaded: LoadedTransition, report: Progress | None = None) -> ClimbPlan:
    """A transition plan for a loaded spec, not yet verified.

    Raises Infeasible where no sequence exists on the poses searched, saying which contacts slip,
    and LimitReached where none of the sequences tried could be planned to the end.
    """
    clock = StageClock(report or (lambda stage, fraction: None))
    scene = build_transition(loaded)
    with clock.stage("search"):
        search = Search(scene)
        found = search.sequences()
        if not found:
            raise no_sequence(scene)
    outcome = [""] * len(found)
    attempt = _planned(search, found, clock, outcome)
    done = attempt.complete
    plan = ClimbPlan(
        name=loaded.name,
        robot=scene.robot,
        terrain=scene.terrain,
        rounds=done.rounds,
        instants=done.instants,
        forces=done.forces,
        trajectory=done.trajectory,
        limits=step_limits(scene),
        status="feasible",
        objective=transition_cost(scene, done.rounds, done.forces),
        bound=None,
        gap=None,
        spec_text=loaded.text,
        spec_sha256=loaded.sha256,
        seed=scene.spec.seed,
        timings=dict(clock.seconds),
        solvers={"motion": "ipopt (mumps)", "force": scene.spec.solver.force},
        sizes={
            "search": {
                "sequences": len(found),
                "stance sets": search.tally.stances,
                "force problems": search.tally.problems,
                "poses": search.lab.poses.count,
            },
            "motion": {"iterations": attempt.motion.iterations, "tried": attempt.number + 1},
            "force": {"instants": done.instants.count},
        },
        warnings=(*_warnings(search), *deflection_warnings(done.forces)),
        kind="transition",
        sequences=Sequences(
            name=tuple(search.name(s) for s in found),
            cost=np.array([s.cost for s in found]),
            safety_torque=np.array([s.safety_torque for s in found]),
            safety_friction=np.array([s.safety_friction for s in found]),
            outcome=tuple(outcome),
        ),
    )
    return replace(plan, summary=summary_lines(plan))


def _warnings(search: Search) -> tuple[str, ...]:
    if not search.tally.truncated:
        return ()
    most = search.scene.spec.search.most
    return (f"more sequences exist than the {most} listed: search.most asks for more",)
