"""The method `mpcc`: all knots as one nonlinear program, with relaxed complementarity of contacts.

Contacts c in [0, 1] with c (1 - c) <= eps start from a guessed gait, and IPOPT may change them. Its
contacts are rounded, and forces, footholds and motion of that gait are polished by SQP.
"""

from __future__ import annotations

import time
from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from climbplan.walking.check.checker import is_feasible
from climbplan.walking.offline.fixed_contact_qp import FixedContactProgram, WalkIterate
from climbplan.walking.offline.gaits import (
    assign_regions,
    build_gait_phases,
    generate_initial_gaits,
    has_enough_contacts,
    is_left_right_symmetric,
    mirror_gait,
    repeat_gait,
)
from climbplan.walking.offline.nlp_program import (
    NlpShape,
    build_parameters,
    build_variables,
    compile_nlp,
    split_variables,
)
from climbplan.walking.offline.sqp import (
    COARSE_TOLERANCE,
    REACH_SLACK,
    GaitAnswer,
    build_iterate,
    guess_iterate,
    solve_gait,
)
from climbplan.walking.offline.warm_up import warm_up
from climbplan.walking.plan.answer import Improvement, WalkAnswer
from climbplan.walking.task.task import Gait, WalkTask

_INITIAL_QPS = 3  # before IPOPT, which saves iterations of it
_OTHER_GAIT_QPS = 6  # the same for gaits other than the guessed one
_WORKSPACE_MARGIN = (
    1e-4  # [m] so far inside their boxes the polish keeps toes, which ends it sooner
)
_POLISH_QPS = (2, 6, 40)  # limits of successive attempts, until the exact check passes
_REPORTED_VIOLATION = 1e-3  # of a row at IPOPT's answer, that its message names
_MAX_REACH_VIOLATION = 3e-3  # [m] beyond which the SQP is not continued


class NlpSolver:
    """The compiled program of a task, which serves all tasks that differ in numbers only."""

    def __init__(self, task: WalkTask) -> None:
        self.task = task
        self.program = compile_nlp(NlpShape.of(task))

    def solve(self, start: Gait, iterate: WalkIterate, seconds: float) -> WalkAnswer:
        """Solve the program from a motion of a gait, whose regions are kept.

        Args:
            start: The gait.
            iterate: Its motion.
            seconds: Time limit [s].
        """
        begin = time.perf_counter()
        task = self.task
        program = self.program
        point = np.concatenate(list(build_variables(task, start, iterate).values()))
        numbers = build_parameters(task, start, iterate).values()
        answer = program.solver.solve(
            np.clip(point, program.bounds.lower, program.bounds.upper),
            np.concatenate([parameter.ravel(order="F") for parameter in numbers]),
            program.bounds,
            time.monotonic() + seconds,
        )
        message, x = answer.word, answer.v
        worst = max(program.residuals(answer), key=lambda block: block.residual)
        if worst.residual > _REPORTED_VIOLATION:
            message += f", {worst.name} off by {worst.residual:.2g} {worst.unit}".rstrip()
        state, force, toes, relaxed = split_variables(task, x)
        contact = relaxed > 0.5
        gait = assign_regions(task, contact, np.vstack([task.start.state, state]))
        if not (np.isfinite(x).all() and has_enough_contacts(task, contact)):
            return WalkAnswer(None, np.inf, time.perf_counter() - begin, message, tried=1)
        if np.array_equal(contact, start.contact):
            gait = start
        program_of_gait = FixedContactProgram(task, gait)
        footing = program_of_gait.footing
        polished = _polish(
            task,
            gait,
            WalkIterate(
                np.vstack([task.start.state, state]),
                np.where(gait.contact[:-1, :, None], force, 0.0),
                toes[footing.first - 1, footing.leg],
            ),
        )
        if not polished.is_feasible:
            polished_start = _polish(task, start, iterate)
            if polished_start.is_feasible:
                seconds_used = time.perf_counter() - begin
                return _build_answer(
                    polished_start, seconds_used, f"IPOPT: {message}, the motion before it kept"
                )
        seconds_used = time.perf_counter() - begin
        return _build_answer(
            polished, seconds_used, f"IPOPT: {message}, {'same' if gait is start else 'other'} gait"
        )


def solve_nlp(task: WalkTask, guess_name: str, seconds: float) -> WalkAnswer:
    """Solve a task from guessed gaits, until an answer passes the exact check.

    The most promising phase of the named gait comes first. Its other phases, other gaits, and gaits
    after braking follow.

    Args:
        task: The task.
        guess_name: Name of the gait.
        seconds: Time limit [s].
    """
    method = NlpSolver(task)
    warm_up(task)
    begin, tried = time.perf_counter(), 0
    message = f"no phase of {guess_name!r} keeps {task.min_contacts} legs standing"
    for gait, iterate in generate_guesses(task, guess_name):
        seconds_left = seconds - (time.perf_counter() - begin)
        if seconds_left <= 0:
            message = "time limit"
            break
        answer = method.solve(gait, iterate, seconds_left)
        tried += 1
        if answer.trajectory is None:
            message = answer.word
            continue
        seconds_used = time.perf_counter() - begin
        history = (Improvement(seconds_used, answer.objective),)
        return replace(answer, seconds=seconds_used, tried=tried, history=history)
    return WalkAnswer(None, np.inf, time.perf_counter() - begin, message, tried=tried)


def generate_guesses(task: WalkTask, name: str) -> Iterator[tuple[Gait, WalkIterate]]:
    """Yield gaits with a motion after a few QPs: phases of the named gait, then other gaits.

    Phases are in the order of the cost that one QP predicts, other gaits in that of their workspace
    violation. Mirror images of a gait are left out in a symmetric task.
    """
    legs = task.body.leg_count
    starts = range(len(build_gait_phases(name, legs)))
    phases = [assign_regions(task, repeat_gait(name, legs, task.knots, k)) for k in starts]
    phases = [gait for gait in phases if has_enough_contacts(task, gait.contact)]
    predicted = [
        solve_gait(task, gait, None, 1, agreement=COARSE_TOLERANCE).predicted for gait in phases
    ]
    is_symmetric = is_left_right_symmetric(task)
    yielded_keys: set[bytes] = set()
    for k in np.argsort(predicted, kind="stable"):
        if phases[k].key not in yielded_keys:
            yield phases[k], _run_initial_sqp(task, phases[k], _INITIAL_QPS)[0]
        yielded_keys |= _list_equivalent_keys(phases[k], is_symmetric)
    for brakes in (range(1), range(1, 4)):
        other_gaits: list[Gait] = []
        for gait in generate_initial_gaits(task, brakes=brakes):
            if gait.key not in yielded_keys:
                yielded_keys |= _list_equivalent_keys(gait, is_symmetric)
                other_gaits.append(gait)
        initial = [_run_initial_sqp(task, gait, _INITIAL_QPS) for gait in other_gaits]
        hopeless: list[tuple[Gait, WalkIterate]] = []
        for k in np.argsort([reach for _, reach in initial], kind="stable"):
            iterate, reach = _run_initial_sqp(task, other_gaits[k], _OTHER_GAIT_QPS, initial[k][0])
            if reach <= _MAX_REACH_VIOLATION:
                yield other_gaits[k], iterate
            else:
                hopeless.append((other_gaits[k], iterate))
        yield from hopeless


def _list_equivalent_keys(gait: Gait, is_symmetric: bool) -> set[bytes]:
    """Return the key of a gait and, in a symmetric task, that of its mirror image."""
    return {gait.key, mirror_gait(gait).key} if is_symmetric else {gait.key}


def _run_initial_sqp(
    task: WalkTask, gait: Gait, qps: int, start: WalkIterate | None = None
) -> tuple[WalkIterate, float]:
    """Run a few QPs from a guess.

    Returns:
        The motion, or the start if a QP has no solution; and its workspace violation [m].
    """
    start = guess_iterate(task, gait) if start is None else start
    answer = solve_gait(task, gait, start, qps, agreement=COARSE_TOLERANCE)
    if answer.trajectory is None:
        return start, np.inf
    return build_iterate(answer.trajectory, gait), max(answer.reach_violation, REACH_SLACK)


def _polish(task: WalkTask, gait: Gait, iterate: WalkIterate) -> GaitAnswer:
    """Make IPOPT's answer exact by SQP, with more iterations if the exact check does not pass."""
    for iterations in _POLISH_QPS:
        answer = solve_gait(task, gait, iterate, iterations, _WORKSPACE_MARGIN, COARSE_TOLERANCE)
        if answer.trajectory is None or answer.reach_violation > _MAX_REACH_VIOLATION:
            return answer
        if answer.is_feasible and is_feasible(task, answer.trajectory):
            return answer
        iterate = build_iterate(answer.trajectory, gait)
    return answer


def _build_answer(answer: GaitAnswer, seconds: float, message: str) -> WalkAnswer:
    """Return the answer, or the message if its gait is infeasible."""
    if answer.trajectory is None or not answer.is_feasible:
        return WalkAnswer(None, np.inf, seconds, f"{message}, but its gait does not hold", tried=1)
    return WalkAnswer(answer.trajectory, answer.objective, seconds, message, tried=1)
