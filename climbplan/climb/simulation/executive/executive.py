"""Execute a climb in closed loop: each contact is measured before the plan goes on.

The executive runs the plan's clock. It stops the clock at gates (`schedule.py`) until the robot is
as the plan says:

- Touch-down. A toe that ends its swing moves on along the inward normal until its contact force
  reaches a threshold, within a range of its planned place. A toe that meets its surface early stops
  there. The plan goes on from the place that was found.
- Forces. Before a limb hands over its load, and once it has found its place, the forces of the next
  stance are solved for measured places, friction and load (`stance_forces.py`). The internal forces
  are then regulated to these.
- Lift. A limb that still carries at the end of its unloading is drawn back slowly, while the others
  take over. It leaves once it is unloaded and they hold.
- Slip. If a toe slips while a limb is in the air, that limb returns to where it stood. Forces are
  solved again for the friction that was seen. A toe that has slid far ends the climb.

Where there is no way on, the robot stops with all its toes that can be on their surfaces, and says
why. From a stance on all toes the rest of the climb can then be planned anew (`replanning.py`).

Joint commands are the plan's at the clock, plus the regulator's corrections
(`control/joint_regulator.py`), plus what presses with the solved forces instead of the planned.
"""

from __future__ import annotations

import numpy as np

from climbplan.arrays import Array
from climbplan.climb.plan.climb_plan import ClimbPlan
from climbplan.climb.plan.played import START
from climbplan.climb.simulation.control.feedforward import compute_gravity_torques
from climbplan.climb.simulation.control.regulator import build_regulator_tables, compute_zero_pose
from climbplan.climb.simulation.executive.measured_contacts import MeasuredContacts
from climbplan.climb.simulation.executive.schedule import Gate, build_schedule
from climbplan.climb.simulation.executive.settings import (
    EventKind,
    ExecutiveEvent,
    ExecutiveSettings,
)
from climbplan.climb.simulation.executive.stance_forces import StanceSolution, solve_stance_forces
from climbplan.control.joint_regulator import DECAY_RATE, Corrections
from climbplan.errors import UsageError
from climbplan.mechanics.stiffness import joint_softness
from climbplan.simulation.conditions import NOMINAL
from climbplan.simulation.motors import compute_assumed_stiffness

_BEFORE_TOUCH = 1e-6  # [s] at which the clock waits: until it has touched, a limb is in the air
_RETURN_WINDOW = 0.2  # [s] after a lift, in which a returning limb may meet its surface
_RETURN_FRACTION = 0.6  # of a swing, after which its limb goes on in spite of a slip
_BLEND_FRACTION = 0.8  # of the time to the next gate, in which forces change after a touch
_LEAST_WAIT = 0.05  # [s] that is worth telling


class ClimbExecutive:
    """A plan in execution, from joint angles and motor torques to joint commands.

    N limbs of J joints. No simulator is involved: call `step` at 100 Hz or more until `finished`
    and send `motor_command`; go on as long as the robot is to hold itself.
    """

    def __init__(
        self,
        plan: ClimbPlan,
        toes: Array | None = None,
        settings: ExecutiveSettings | None = None,
    ) -> None:
        """Start at the beginning of a plan.

        Args:
            plan: The plan.
            toes: (N, 3) where toes stand, as far as is known [m]; None: as planned.
            settings: Thresholds; None for the defaults.

        Raises:
            UsageError: The robot has grippers, flat feet or five-bar legs, or the plan is timed by
                its dynamics.
        """
        _require_executable(plan)
        robot = plan.robot
        self._plan, self.robot = plan, robot
        self._settings = settings or ExecutiveSettings()
        self._tables = build_regulator_tables(plan)
        self._schedule = build_schedule(plan, self._settings.search_range)
        self.gravity_torque = compute_gravity_torques(plan, NOMINAL)  # (T, N, J) of links [N m]
        self._carrying = self.gravity_torque / compute_assumed_stiffness(robot, NOMINAL)
        self.contacts = MeasuredContacts(plan, self._tables, self._schedule, self._settings, toes)
        self._corrections = Corrections(self._tables)
        if toes is not None:
            self._corrections.offset[:] = toes - plan.rounds.toes[0]
        self._softness = joint_softness(robot)
        n = robot.limb_count
        self.clock, self.time = float(plan.trajectory.time[0]), 0.0  # [s] of the plan; since start
        self.events: list[ExecutiveEvent] = []
        self.stopped = ""  # why the robot has stopped, if it has
        self._next_gate = 0
        self._waited, self._pause = 0.0, 0.0  # [s] at the gate; to wait wherever the clock is
        self._is_returning = False
        self._retreat = ""  # why limbs return to stay there, if they do
        self._returns: dict[int, int] = {}  # by gate
        self._touched = np.ones(n, bool)  # on their surfaces
        self._landed = np.zeros(n, bool)  # since their last swing, before the plan says so
        self._landing = np.zeros((n, 3))  # where commands of these were then [m]
        self._search = np.zeros((n, 3))  # of toes that search or are drawn back [m]
        self._stance = START  # instant whose forces are sought
        self._force_before, self._force_after = self._schedule.force[[0, 0]].copy()
        self._blend, self._blend_time = 1.0, 1.0
        # Offset from commands that held the robot before, and the fraction of it that is left
        self._handover_offset = np.zeros_like(self._tables.command[0])  # [rad]
        self._handover_fraction = 0.0
        start = self._solve_forces(START)
        if start is not None:  # otherwise as planned
            self._change_forces(start.force, 0.0)
            self._blend = 1.0
        self.command = self._compute_command(0, 0.0, 0.0)

    @property
    def plan(self) -> ClimbPlan:
        """Return the plan in execution."""
        return self._plan

    @property
    def finished(self) -> bool:
        """Return whether the plan has ended, or the robot has stopped."""
        return bool(self.stopped) or self.clock >= self._schedule.time[-1]

    def replan(self) -> ClimbExecutive:
        """Return the executive of a plan from the measured stance to the same goal.

        It begins with the commands that hold the robot now. Planning takes seconds: go on with
        `step`, or with constant commands, until then.

        Raises:
            UsageError: A limb is in the air, or the plan does not carry what its spec names.
            Unresolved: No plan was found that passes its verification.
        """
        from climbplan.climb.simulation.executive import replanning

        if not self._touched.all():
            name = self.robot.limb_names[int(np.argmin(self._touched))]
            raise UsageError(f"{name} is in the air: a plan begins on all toes")
        plan, schedule, contacts = self._plan, self._schedule, self.contacts
        lifts = [g for g in schedule.gates[self._next_gate :] if g.kind == "lift"]
        if not lifts:
            raise UsageError("no limb is left to move: the plan is at its end")
        measured = replanning.MeasuredStance(
            com=contacts.pose.com.copy(),
            rotation=contacts.pose.rotation.copy(),
            toes=contacts.pose.places.copy(),
            friction=contacts.friction.copy(),
            load=contacts.load.copy(),
            instant=int(schedule.instant[self.sample]),
            next_instant=int(schedule.instant[lifts[0].sample]),
        )
        stance = replanning.correct_drift(plan, measured)
        tail = ClimbExecutive(replanning.replan_climb(plan, stance), stance.toes, self._settings)
        tail.take_over(self.motor_command, contacts.force)
        return tail

    def take_over(self, motor_command: Array, force: Array) -> None:
        """Begin with other commands than the plan's, which hold the robot, and fade them out.

        Args:
            motor_command: (N, J) in the sense of `motor_command` [rad].
            force: (N, 3) on the toes [N].
        """
        self.contacts.force[:] = force
        self._change_forces(self._force_after, self._settings.pause)
        self._force_before = force.copy()
        self.command = motor_command - self._carrying[0]
        self._handover_offset = self.command - self._compute_command(0, 0.0, 0.0)
        self._handover_fraction = 1.0
        self.pause(2.0 * self._settings.pause)

    def pause(self, seconds: float) -> None:
        """Let the clock stand for a time [s], as at the start, until the robot is at rest."""
        self._pause = seconds

    @property
    def sample(self) -> int:
        """Sample of the plan at or before the clock."""
        return self._schedule.locate(self.clock)[0]

    @property
    def motor_command(self) -> Array:
        """Joint commands (N, J) with what carries the links [rad]: what motors are to be told."""
        return np.asarray(self.command + self._carrying[self.sample])

    @property
    def target_force(self) -> Array:
        """Forces (N, 3) that toes are to have now [N]."""
        change = self._force_after - self._force_before
        return np.asarray(self._force_before + self._blend * change)

    def step(self, seconds: float, angles: Array, torque: Array) -> Array:
        """Return joint commands (N, J) [rad], without what carries the links.

        Args:
            seconds: Since the last step [s].
            angles: (N, J) of the joints [rad].
            torque: (N, J) of the motors [N m].

        Raises:
            ValueError: An angle or torque is no number, or no time has passed.
        """
        if not (seconds > 0 and np.isfinite(angles).all() and np.isfinite(torque).all()):
            raise ValueError(f"expected finite angles and torques, and a time step > 0: {seconds}")
        self.time += seconds
        index = self.sample
        self.contacts.measure_forces(index, torque - self.gravity_torque[index], seconds)
        self._react_to_slips(index)
        self._blend = min(self._blend + seconds / self._blend_time, 1.0)
        self._advance_clock(seconds)
        index, fraction = self._schedule.locate(self.clock)
        after = min(index + 1, len(self._schedule.time) - 1)
        self.contacts.measure_pose(index, after if fraction > 0 else index, angles, self._touched)
        self._handover_fraction = max(self._handover_fraction - seconds / self._settings.pause, 0.0)
        self.command = self._compute_command(index, fraction, seconds)
        self.command += self._handover_fraction * self._handover_offset
        return self.command

    def _compute_command(self, index: int, fraction: float, seconds: float) -> Array:
        """Compute joint commands (N, J) at the clock, with corrections."""
        schedule, tables, offset = self._schedule, self._tables, self._corrections.offset
        added_force = self.target_force - schedule.interpolate(schedule.force, index, fraction)
        jacobian = tables.jacobian[index]
        deflection = self._softness * np.einsum("nij,ni->nj", jacobian, added_force)
        # Limbs that have not left yet keep their offset, which others lose in the air
        leaving = (tables.contact[index] < 0.5) & self._touched & ~self._landed
        frozen = offset[leaving]
        pose = self.contacts.pose
        self._corrections.update(
            index + fraction,
            seconds,
            pose.com,
            pose.rotation,
            self.contacts.deflection,
            deflection,
        )
        offset[leaving] = frozen
        added = self._search.copy()
        early = self._landed & (tables.contact[index] < 0.5)
        path = schedule.interpolate(schedule.path, index, fraction)
        added[early] += (self._landing - path - offset)[early]
        correction = np.einsum("nji,ni->nj", tables.turning[index], offset + added) - deflection
        return schedule.interpolate(tables.command, index, fraction) + correction

    # The clock and its gates

    def _advance_clock(self, seconds: float) -> None:
        if self.finished:
            return
        if self._is_returning:
            self._return_limbs(seconds)
            return
        if self._pause > 0.0:
            self._pause -= seconds
            return
        time, gates = self._schedule.time, self._schedule.gates
        target = self.clock + seconds
        while self._next_gate < len(gates):
            gate = gates[self._next_gate]
            gate_time = float(time[gate.sample])
            if gate.kind == "touch":
                self._watch_swing(gate)
                if self._touched[gate.limbs].all():
                    target = max(target, gate_time)
                    self._pass_gate(gate)
                    continue
                gate_time -= _BEFORE_TOUCH
            if target < gate_time:
                break
            if gate.kind == "unload" or (gate.kind == "lift" and not self._find_objection(gate)):
                self._pass_gate(gate)
                if self.stopped:
                    return
                continue
            self.clock = gate_time
            self._wait(gate, seconds)
            return
        self.clock = min(target, float(time[-1]))

    def _pass_gate(self, gate: Gate) -> None:
        schedule, limbs = self._schedule, gate.limbs
        if self._waited > _LEAST_WAIT:
            self._note_event("waited", -1, self._waited)
        self._waited = 0.0
        self._next_gate += 1
        if gate.kind == "touch":
            following = schedule.gates[self._next_gate : self._next_gate + 1]
            end = schedule.time[following[0].sample if following else -1]
            seconds = _BLEND_FRACTION * float(end - schedule.time[gate.sample])
            self._seek_forces(int(schedule.instant[gate.sample]), seconds)
        elif gate.kind == "unload":
            self._stop_after_slide(gate.sample)
            if self.stopped:
                return
            lift = schedule.gates[self._next_gate]
            self._landed[limbs] = False
            self.contacts.measure_load(self.sample, self._touched)
            seconds = float(schedule.time[lift.sample] - schedule.time[gate.sample])
            self._seek_forces(int(schedule.instant[lift.sample]), seconds)
        else:
            self._touched[limbs] = self._landed[limbs] = False
            self._corrections.offset[limbs] += self._search[limbs]
            self._search[limbs] = 0.0

    def _wait(self, gate: Gate, seconds: float) -> None:
        """Let limbs search their surface, or draw back those that still carry."""
        settings, schedule = self._settings, self._schedule
        self._waited += seconds
        if gate.kind == "touch":
            for limb in gate.limbs[~self._touched[gate.limbs]]:
                normal = schedule.normal[gate.sample, limb]
                deflection = (
                    self._tables.jacobian[self.sample, limb] @ (self.contacts.deflection[limb])
                )  # of a toe that presses already
                if -(self._search[limb] + deflection) @ normal > settings.search_range:
                    name = self._plan.robot.limb_names[limb]
                    distance = 1e3 * settings.search_range
                    self._retreat = f"{name} finds no surface within {distance:.0f} mm"
                    self._is_returning = True
                    self._note_event("retreated", int(limb), settings.search_range)
                    return
                self._search[limb] -= settings.search_speed * seconds * normal
            return
        if self._waited > settings.patience:
            self._stop(int(gate.limbs[0]), f"no limb can lift: {self._find_objection(gate)}")
            return
        for limb in gate.limbs:
            if not self.contacts.is_unloaded(int(limb)):
                step = settings.retraction_speed * seconds
                self._search[limb] += step * schedule.left_normal[gate.sample, limb]

    def _find_objection(self, gate: Gate) -> str:
        """Return why the limbs of a gate must not lift now; "" if they may."""
        return self.contacts.find_objection(gate, np.flatnonzero(self._touched))

    def _stop(self, limb: int, reason: str) -> None:
        self.stopped = reason
        self._note_event("stopped", limb, 0.0)
        instant = self._stance
        is_unloading = instant != START and not self._plan.instants.contact[instant].all()
        if is_unloading and self._touched.all():  # back to the stance before
            before = self._solve_forces(instant - 1)
            if before is not None:
                self._change_forces(before.force, self._settings.blend_time)

    def _stop_after_slide(self, sample: int) -> None:
        """Stop if a toe has slid so far that the plan's stance is no longer that of the robot."""
        slide = self.contacts.pose.places - self._plan.instants.toes[self._schedule.instant[sample]]
        normal = self._schedule.normal[sample]
        slide -= (slide * normal).sum(axis=1, keepdims=True) * normal
        distance = np.linalg.norm(slide, axis=1)
        limb = int(np.argmax(distance))
        if distance[limb] > self._settings.max_slide:
            name = self._plan.robot.limb_names[limb]
            self._stop(limb, f"{name} has slid {1e3 * distance[limb]:.0f} mm off its foothold")

    def _note_event(self, kind: EventKind, limb: int, value: float) -> None:
        self.events.append(ExecutiveEvent(self.time, self.clock, kind, limb, value))

    # Touch-down

    def _watch_swing(self, gate: Gate) -> None:
        """Let limbs of a gate land that have met their surface."""
        index, fraction = self._schedule.locate(self.clock)
        for limb in gate.limbs[~self._touched[gate.limbs]]:
            if index < self._schedule.approach[gate.sample, limb]:
                continue
            normal = self._schedule.normal[gate.sample, limb]
            if self.contacts.split_force(int(limb), normal)[0] > self.contacts.touch_force:
                self._land(int(limb), index, fraction, gate.sample)

    def _land(self, limb: int, index: int, fraction: float, sample: int) -> None:
        """Let a limb stay where it has met its surface, as its foothold at a sample of the plan."""
        schedule, offset = self._schedule, self._corrections.offset
        self._touched[limb] = self._landed[limb] = True
        path = schedule.interpolate(schedule.path, index, fraction)[limb]
        self._landing[limb] = path + offset[limb] + self._search[limb]
        offset[limb] = self._landing[limb] - schedule.path[sample, limb]
        self._search[limb] = 0.0
        deflection = self._tables.jacobian[index, limb] @ self.contacts.deflection[limb]
        self.contacts.pose.places[limb] = self._landing[limb] + deflection
        depth = -(offset[limb] + deflection) @ schedule.normal[sample, limb]
        self._note_event("touched", limb, float(depth))

    def _start_return(self, gate: Gate) -> None:
        """Let the limbs of a swing return, unless they are nearer to where they go."""
        lift = self._schedule.gates[self._next_gate - 1]
        if lift.kind != "lift":
            return
        start, end = (float(self._schedule.time[g.sample]) for g in (lift, gate))
        if self.clock > start + _RETURN_FRACTION * (end - start):
            return
        self._is_returning = True
        self._note_event("returned", int(gate.limbs[0]), 0.0)
        firmer = self._solve_forces(self._stance)
        if firmer is not None:
            self._change_forces(firmer.force, self._settings.reaction_time)

    def _return_limbs(self, seconds: float) -> None:
        """Let limbs in the air return to where they stood, backwards along the plan."""
        schedule, settings = self._schedule, self._settings
        lift = schedule.gates[self._next_gate - 1]
        lift_time = float(schedule.time[lift.sample])
        self.clock = max(self.clock - settings.return_speed * seconds, lift_time)
        if self.clock > lift_time + _RETURN_WINDOW:
            self._search[lift.limbs] *= max(0.0, 1.0 - DECAY_RATE * seconds)
            return
        index, fraction = schedule.locate(self.clock)
        for limb in lift.limbs[~self._touched[lift.limbs]]:
            normal = schedule.left_normal[lift.sample, limb]
            if self.contacts.split_force(int(limb), normal)[0] > self.contacts.touch_force:
                self._land(int(limb), index, fraction, lift.sample - 1)
            elif self.clock <= lift_time:
                self._search[limb] -= settings.search_speed * seconds * normal
        if not self._touched[lift.limbs].all():
            return
        self._is_returning = False
        self._restart_unloading(self._next_gate - 2)
        if self._retreat and not self.stopped:
            self._stop(int(lift.limbs[0]), self._retreat)

    def _restart_unloading(self, number: int) -> None:
        """Let limbs that return take their load again, before the gate of their unloading."""
        schedule = self._schedule
        gate = schedule.gates[number]
        self._next_gate = number
        self._waited = 0.0
        self.clock = float(schedule.time[gate.sample])
        lift = schedule.gates[number + 1]
        self._seek_forces(int(schedule.instant[lift.sample]) - 1, self._settings.reaction_time)
        self._pause = self._settings.pause
        self._returns[number] = self._returns.get(number, 0) + 1
        if self._returns[number] > self._settings.max_returns and not self.stopped:
            name = self._plan.robot.limb_names[gate.limbs[0]]
            self._stop(int(gate.limbs[0]), f"toes slip whenever {name} is to lift")

    # Forces

    def _seek_forces(self, instant: int, seconds: float) -> None:
        """Let forces change to those of an instant, for what was measured, in a time [s]."""
        contacts = self.contacts
        solution = self._solve_forces(instant)
        is_poor = (
            solution is not None
            and contacts.friction.min() < 1.0
            and solution.margin_fraction < self._settings.min_margin_fraction
        )
        if solution is None or is_poor:
            name = "the start"
            if instant != START:
                name = self._plan.instants.label(instant, self._plan.robot.limb_names)
            self._stop(-1, f"no forces hold {name} on the friction and load that were measured")
            return
        self._note_event("forces", -1, solution.margin_fraction)
        self._change_forces(solution.force, seconds)
        self._stance = instant

    def _solve_forces(self, instant: int) -> StanceSolution | None:
        plan, contacts = self._plan, self.contacts
        row = max(instant, 0)
        mu = plan.instants.mu[row] * contacts.friction[plan.instants.region[row]]
        return solve_stance_forces(plan, instant, contacts.pose.places, mu, contacts.load)

    def _change_forces(self, force: Array, seconds: float) -> None:
        self._force_before, self._force_after = self.target_force, force
        self._blend, self._blend_time = 0.0, max(seconds, 1e-3)

    def _react_to_slips(self, index: int) -> None:
        """Return limbs in the air if a toe slips; otherwise press as less friction requires."""
        for limb in self.contacts.find_slips():
            self._note_event("slipped", limb, float(self.contacts.pose.errors[limb]))
            shows_less = self.contacts.notice_slip(limb, index, self.time)
            if self.finished or self._is_returning:
                continue
            gates = self._schedule.gates
            gate = gates[min(self._next_gate, len(gates) - 1)]
            if gate.kind == "touch" and not self._touched[gate.limbs].all():
                self._start_return(gate)
            elif gate.kind == "lift":  # the limb takes its load again
                self._restart_unloading(self._next_gate - 1)
            elif shows_less:
                self._seek_forces(self._stance, self._settings.blend_time)
                self._pause = self._settings.blend_time


def _require_executable(plan: ClimbPlan) -> None:
    """Raise UsageError for plans that closed-loop execution does not know."""
    robot = plan.robot
    if plan.trajectory.is_paced:
        raise UsageError(
            f"{plan.name} is timed by its dynamics (trajectory.pace): closed-loop execution "
            "measures forces at rest and needs a plan without a pace"
        )
    if robot.gripper is not None or robot.sole is not None or compute_zero_pose(robot) is None:
        raise UsageError(
            f"{robot.name} has five-bar legs, grippers or flat feet: closed-loop execution "
            "knows limbs whose joints move one after the other and toes that press"
        )
