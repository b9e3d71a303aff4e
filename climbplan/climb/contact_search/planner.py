"""Method `contact-search`: plan a climb of any length foothold by foothold, and its forces."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from climbplan.climb.contact_search.limb_move import join_instants
from climbplan.climb.contact_search.search import FootholdSearch, SearchResult
from climbplan.climb.contact_search.suitability import find_obstacle_to_method
from climbplan.climb.forces.planner import plan_forces
from climbplan.climb.gait.instants import build_instants, compute_joint_angles
from climbplan.climb.motion.motion import ClimbMotion, StageClock, SupportedMotion
from climbplan.climb.motion.open_rounds import OpenRoundsMotion, PartialClimb
from climbplan.climb.plan.climb_plan import Instants, Rounds
from climbplan.climb.postures.cost_bound import bound_posture_cost
from climbplan.climb.postures.planner import PostureResult
from climbplan.climb.scene.climb_scene import ClimbScene, ClimbStance
from climbplan.climb.windows.window_scenes import replace_rounds
from climbplan.errors import LimitReached, NoPlanFound, Remedy, Unresolved, UsageError


def plan_by_contact_search(
    scene: ClimbScene, clock: StageClock, deadline: float, max_moves: float = np.inf
) -> OpenRoundsMotion:
    """Plan footholds, body poses and swings along a guide path, then the forces of all instants.

    Args:
        scene: The scene, whose number of rounds is open.
        clock: Times the stages.
        deadline: Time limit in `time.monotonic` seconds.
        max_moves: Largest number of moves of limbs that are checked.

    Raises:
        UsageError: The method cannot state the scene.
        Unresolved: No sequence of footholds was found; the message says how far it came, and
            `partial` has what was found.
        LimitReached: The time limit or the number of moves was reached, likewise.
        NoForces: Some instants have no admissible forces.
    """
    if (obstacle := find_obstacle_to_method(scene)) is not None:
        raise UsageError(f"method contact-search plans {obstacle}")
    with clock.stage("posture"):
        search = FootholdSearch(scene)
        result = search.run(deadline, max_moves)
        if not result.is_complete:
            failure = _build_failure(scene, result, search)
            failure.partial = _keep_part(search, result, clock)
            raise failure
    return _plan_motion(scene, result, clock)


def _plan_motion(scene: ClimbScene, result: SearchResult, clock: StageClock) -> OpenRoundsMotion:
    """Plan instants and forces of the rounds found, in a scene whose goal is their end."""
    last = result.rounds[-1]
    end = replace(scene.goal, toes=last.standing.toes, region=last.standing.region)
    whole_scene = replace(replace_rounds(scene, len(result.rounds) - 1), goal=end)
    with clock.stage("kinematics"):
        rounds = _collect_rounds(result)
        instants = _collect_instants(whole_scene, result)
    posture = _describe_postures(whole_scene, rounds, result)
    swings = tuple(move.swing for planned in result.rounds for move in planned.moves)
    with clock.stage("force"):
        forces = plan_forces(whole_scene, instants)
    motion = ClimbMotion(posture, instants, (), swings)
    return OpenRoundsMotion(whole_scene, SupportedMotion(motion, forces))


def _keep_part(
    search: FootholdSearch, result: SearchResult, clock: StageClock
) -> PartialClimb | None:
    """Return the rounds of a search that ended early, up to one at whose end the body can rest."""
    count = len(result.rounds)
    while count > 1 and not search.can_rest(result.rounds[count - 1]):
        count -= 1
    if count == 1:
        return None
    kept_result = replace(result, rounds=result.rounds[:count])
    last = kept_result.rounds[-1]
    return PartialClimb(
        end=ClimbStance(last.base.com, last.base.rpy, last.standing.toes, last.standing.region),
        num_rounds=count - 1,
        covered=last.covered,
        length=search.length,
        build=lambda scene: _plan_motion(scene, kept_result, clock),
    )


def _build_failure(scene: ClimbScene, result: SearchResult, search: FootholdSearch) -> NoPlanFound:
    """Return the error of a search that did not reach the goal."""
    covered = result.rounds[-1].covered
    message = (
        f"contact search: footholds for {covered:.2f} of {search.length:.2f} m, in "
        f"{len(result.rounds) - 1} rounds"
    )
    remedies = result.remedies
    slope = float(np.rad2deg(search.guides[0].steepest))
    if slope > scene.spec.posture.rotation_limit_deg:
        steeper = Remedy(
            f"the body inclined as the ground, {slope:.0f} deg",
            "posture.rotation_limit_deg",
            float(np.ceil(slope)),
        )
        remedies = (steeper, *remedies)
    if result.stopped_by:
        message += f"; the next fails: {result.stopped_by}"
    if result.ran_out:
        limit = "the time limit" if result.ran_out == "time" else f"{result.num_checked} moves"
        return LimitReached(f"{message}; ended by {limit}", stage="posture", remedies=remedies)
    reason = "footholds near the nominal ones were tried along one path of the body"
    return Unresolved(message, because=reason, stage="posture", remedies=remedies)


def _collect_rounds(result: SearchResult) -> Rounds:
    """Return the body poses on the guide path and the toes at the end of each round."""
    planned = result.rounds
    return Rounds(
        com=np.array([entry.base.com for entry in planned]),
        rpy=np.array([entry.base.rpy for entry in planned]),
        toes=np.array([entry.standing.toes for entry in planned]),
        region=np.array([entry.standing.region for entry in planned], np.int64),
    )


def _collect_instants(scene: ClimbScene, result: SearchResult) -> Instants:
    """Return the instants with a lifted limb, each with that after it, before the next is lifted.

    While all limbs stand, the body goes to the pose of the next move, and at last to the goal.
    """
    moves = [move for entry in result.rounds for move in entry.moves]
    lifted = join_instants([move.lifted for move in moves])
    goal = result.rounds[-1].base
    pushed = build_instants(
        scene,
        rounds=lifted.round,
        com=np.concatenate([lifted.com[1:], goal.com[None]]),
        rpy=np.concatenate([lifted.rpy[1:], goal.rpy[None]]),
        toes=np.array([move.after.toes for move in moves]),
        region=np.array([move.after.region for move in moves], np.int64),
        lifted=np.zeros_like(lifted.lifted),
    )
    pushed = replace(pushed, joint_angles=compute_joint_angles(scene.robot, pushed, pushed.toes))
    in_turn = np.arange(2 * len(moves)).reshape(2, -1).T.ravel()
    both = join_instants([lifted, pushed])
    return Instants(**{name: value[in_turn] for name, value in vars(both).items()})


def _describe_postures(scene: ClimbScene, rounds: Rounds, result: SearchResult) -> PostureResult:
    """Return the rounds with their cost; the bound is that of the straight way."""
    from climbplan.climb.postures.nlp.check import compute_posture_cost

    objective, bound = compute_posture_cost(scene, rounds), bound_posture_cost(scene)
    note = (
        "footholds were chosen one after the other along a path of the body, the nominal ones "
        "first: another choice may move less; the bound is that of the straight way"
    )
    return PostureResult(
        rounds=rounds,
        status="feasible",
        objective=objective,
        bound=bound,
        gap=max(objective - bound, 0.0) / max(abs(objective), 1e-9),
        nodes=result.num_checked,
        solver="contact search",
        sizes={
            "moves_checked": result.num_checked,
            "bound_holds_for": "the straight way of body and toes in as many rounds",
        },
        warnings=(note,),
    )
