"""The multi-phase nonlinear program of a mode sequence, for IPOPT through CasADi.

Variables: durations; position, velocity and acceleration of the box at knots; joint angles of all
limbs at knots; footholds, feet in the air, and foot forces. Built once, solved any number of times.
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from typing import Any

import casadi as ca
import numpy as np

from climbplan.limms.answers import Cut, Ends, Outcome
from climbplan.limms.box_forces import box_forces
from climbplan.limms.building import Building
from climbplan.limms.closed_chains import close_chains
from climbplan.limms.footholds import feet_of
from climbplan.limms.scene import Array, Scene
from climbplan.limms.statement import Limb, Trace
from climbplan.limms.unknowns import Unknowns
from climbplan.solvers.interruption import Deadline, interruptible

FEASIBLE = 1e-6  # largest violation of an answer that is used


def solve(
    scene: Scene,
    limbs: Sequence[Limb],
    guess: Sequence[Trace],
    ends: Ends,
    cuts: Sequence[Cut] = (),
    time_limit: float = 30.0,
    iterations: int = 120,
) -> Outcome:
    """Build and solve the program of some phases from a guess; `guess` carries the phases."""
    began = time.perf_counter()
    store = Unknowns()
    parts = _Program(scene, limbs, store)
    for number, trace in enumerate(guess):
        parts.phase(number, trace, [c for c in cuts if c.phase == number])
    parts.finish(ends)
    x, g = ca.vertcat(*store.x), ca.vertcat(*store.g)
    deadline = Deadline(x.numel(), g.numel(), 0)
    deadline.at = time.monotonic() + time_limit
    nlp: dict[str, Any] = {"x": x, "f": parts.cost, "g": g}
    options: dict[str, Any] = {
        "ipopt.print_level": 0,
        "print_time": False,
        "expand": True,
        "ipopt.sb": "yes",
        "ipopt.max_iter": iterations,
        "iteration_callback": deadline,
        "error_on_fail": False,
        "ipopt.tol": 1e-5,
        "ipopt.constr_viol_tol": 1e-7,
        "ipopt.acceptable_tol": 1e-3,
        "ipopt.acceptable_constr_viol_tol": 1e-7,
        "ipopt.acceptable_iter": 6,
        "ipopt.mu_strategy": "adaptive",
        "ipopt.mumps_mem_percent": 200,
    }
    solver = ca.nlpsol("limms", "ipopt", nlp, options)
    built = time.perf_counter()
    with interruptible(deadline.stop):
        answer = solver(
            x0=np.concatenate(store.start),
            lbx=np.concatenate(store.low),
            ubx=np.concatenate(store.high),
            lbg=np.concatenate(store.g_low),
            ubg=np.concatenate(store.g_high),
        )
    values = np.asarray(answer["g"]).ravel()
    violation = float(
        np.max(
            np.maximum(np.concatenate(store.g_low) - values, values - np.concatenate(store.g_high))
        )
    )
    status = solver.stats()["return_status"]
    read = ca.Function("read", [x], parts.outputs)(answer["x"])
    traces = parts.traces([np.asarray(v) for v in read], guess)
    return Outcome(
        solved=violation <= FEASIBLE,  # whatever the solver says of optimality
        message=f"{status}, {solver.stats()['iter_count']} iterations, violation {violation:.1e}",
        traces=traces,
        violation=violation,
        objective=float(answer["f"]),
        seconds=time.perf_counter() - built,
        build_seconds=built - began,
        variables=int(x.numel()),
        constraints=int(g.numel()),
    )


class _Program(Building):
    """Adds phase after phase."""

    def __init__(self, scene: Scene, limbs: Sequence[Limb], store: Unknowns) -> None:
        super().__init__(scene, limbs, store)
        self.outputs: list[ca.MX] = []

    def phase(self, number: int, guess: Trace, cuts: Sequence[Cut]) -> None:
        """One phase: motion, kinematics, forces, feet."""
        store, phase = self.store, guess.phase
        count = phase.intervals
        duration = store.variable(f"T{number}", guess.duration, phase.shortest, phase.longest)
        step = duration / count
        p = [
            store.variable("p", guess.position[k], phase.lower, phase.upper)
            for k in range(count + 1)
        ]
        v = [store.variable("v", guess.velocity[k], -8.0, 8.0) for k in range(count + 1)]
        a = [store.variable("a", guess.acceleration[k], -60.0, 60.0) for k in range(count + 1)]
        lower, upper = ca.DM(phase.lower), ca.DM(phase.upper)
        for k in range(count):
            # The chain of cubics, and its control points inside the phase's free block
            store.equal(v[k + 1] - v[k] - step * (a[k] + a[k + 1]) / 2)
            store.equal(p[k + 1] - p[k] - step * v[k] - step**2 * (2 * a[k] + a[k + 1]) / 6)
            for control in (p[k] + step * v[k] / 3, p[k + 1] - step * v[k + 1] / 3):
                store.add(control - lower, 0.0, np.inf)
                store.add(upper - control, 0.0, np.inf)
            self.cost += 0.02 * step * ca.sumsqr((a[k] + a[k + 1]) / 2)
        self.cost += duration
        feet = feet_of(self, phase, guess)
        q = close_chains(self, phase, guess, p, v, feet, step, cuts)
        force = box_forces(self, phase, guess, p, a, feet)
        if self.last is None:
            self.first_p, self.first_v = p[0], v[0]
        else:
            before_p, before_v, before_q = self.last
            store.equal(p[0] - before_p)
            store.equal(v[0] - before_v)
            if phase.kind != "flight":
                for mine, theirs in zip(q[0], before_q, strict=True):
                    store.equal(mine - theirs)
        self.last = (p[-1], v[-1], q[-1])
        self.outputs += [
            duration,
            ca.horzcat(*p).T,
            ca.horzcat(*v).T,
            ca.horzcat(*a).T,
            ca.horzcat(*(ca.vertcat(*row) for row in q)).T if q[0] else ca.MX(0),
            ca.horzcat(*(ca.vertcat(*row) for row in feet)).T if feet[0] else ca.MX(0),
            ca.horzcat(*(ca.vertcat(*row) for row in force)).T if force[0] else ca.MX(0),
        ]

    def finish(self, ends: Ends) -> None:
        """Rest at the start; the goal at the end."""
        assert self.last is not None
        assert self.first_p is not None
        assert self.first_v is not None
        store = self.store
        store.equal(self.first_p - ca.DM(ends.start))
        store.equal(self.first_v)
        p, v, _ = self.last
        store.equal(p - ca.DM(ends.goal))
        if ends.arrival_speed > 0:
            store.add(ca.sumsqr(v), 0.0, ends.arrival_speed**2)
            self.cost += 0.5 * ca.sumsqr(v)
        else:
            store.equal(v)

    def traces(self, read: list[Array], guess: Sequence[Trace]) -> tuple[Trace, ...]:
        """The answer, phase by phase."""
        traces = []
        n = len(self.limbs)
        for number, old in enumerate(guess):
            duration, p, v, a, q, feet, force = read[7 * number : 7 * number + 7]
            knots = old.phase.intervals + 1
            flight = old.phase.kind == "flight"
            traces.append(
                Trace(
                    phase=old.phase,
                    duration=float(duration[0, 0]),
                    position=p,
                    velocity=v,
                    acceleration=a,
                    angles=np.zeros((knots, n, 6)) if flight else q.reshape(knots, n, 6),
                    feet=feet.reshape(knots, n, 3),
                    force=np.zeros((knots, n, 3)) if flight else force.reshape(knots, n, 3),
                )
            )
        return tuple(traces)
