"""Why a robot with grippers cannot hold itself: which pull is missing where, and what would do.

The exact cones once more, with a pull towards the surface at every grip for free: its least sum is
what grippers lack, in newtons at named limbs. Each remedy is the exact optimum of one more program.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from climbplan.arrays import Array, IntArray
from climbplan.climb.forces.cones import ConicAnswer, ConicProgram
from climbplan.climb.forces.explanation import CHOSEN, most_fragile
from climbplan.climb.forces.grips.program import (
    GripInstant,
    conic_program,
    grip_instant,
    linear_blocks,
)
from climbplan.climb.forces.grips.statement import GripStatement
from climbplan.climb.plan.climb_plan import Instants
from climbplan.climb.scene.climb_scene import MotionScene
from climbplan.errors import Conflict, LimitReached, NotProved, Remedy
from climbplan.robots.rotations import rotation_world_body

LISTED = 5  # instants described one by one
_LEAST_PULL = 0.05  # [N] less is not told
_ANY_COMMAND = 100.0  # [rad] beyond all bounds
_LARGEST = 1e4  # [N] a gripping force beyond is no remedy
_SAFE = 1e-3  # relative, added to what is said to be enough
_BISECTIONS = 30


def explain_grips(
    scene: MotionScene, instants: Instants, statement: GripStatement, missing: IntArray
) -> NotProved:
    """The error that says what is missing at instants without admissible forces.

    Raises LimitReached if an instant turns out feasible after all.
    """
    names = scene.robot.limb_names
    conflicts: list[Conflict] = []
    worst: _Remedies | None = None
    for k in missing:
        instant = grip_instant(statement, int(k))
        where = instants.label(int(k), names)
        pull = missing_pull(instant)
        if pull is not None and pull.sum() * statement.unit <= _LEAST_PULL:
            raise LimitReached(f"{where}: grips are feasible only just; no solver found forces")
        remedies = _remedies(scene, instants, statement, instant, int(k))
        worst = remedies if worst is None else worst.and_also(remedies)
        if len(conflicts) < LISTED:
            lacking = _lacking(instant, pull, statement.unit, names)
            conflicts.append(replace(lacking, where=where, remedies=remedies.remedies()))
    message = f"{len(missing)} of {instants.count} instants have no admissible grips"
    if len(missing) > 1 and worst is not None and (cures := worst.remedies()):
        message += f"; all have with {' or '.join(map(str, cures))}"
    if len(missing) > LISTED:
        message += f"; the first {LISTED}:"
    return NotProved(message, conflicts, because=CHOSEN, stage="force")


def fragile_grips(
    scene: MotionScene, instants: Instants, asked: GripStatement, share: Array
) -> tuple[str, ...]:
    """Which instants keep less than their margins, and what would help at the worst.

    asked: the problems with all of their margins; share: (K,) of them that grips keep.
    """
    if (worst := most_fragile(instants, share, scene.robot.limb_names)) is None:
        return ()
    k, text = worst
    instant = grip_instant(asked, k)
    pull = asked.pull[k]
    text += f": not every grip has a pull-out reserve of {pull:.1f} N" if pull > 0 else ""
    # Less S_mu is no remedy: what holds may lack of their friction asks for its own
    cures = replace(_remedies(scene, instants, asked, instant, k), friction=None).remedies()
    return (f"{text}; all margins are kept with {' or '.join(map(str, cures))}" if cures else text,)


def _lacking(
    instant: GripInstant, pull: Array | None, unit: float, names: tuple[str, ...]
) -> Conflict:
    """What is missing, without place and remedies."""
    checks: tuple[str, ...] = ("grip.press", "grip.shear")
    if pull is None:
        free = replace(instant, room=np.full_like(instant.room, _ANY_COMMAND))
        if missing_pull(free) is None:
            checks = ("torque.limit", "wrist.torque")
            words = "no pull would do: joint or wrist torques are too small for the load"
        else:
            checks = ("kinematics.joint_bounds",)
            words = "no pull would do: joint commands would leave their bounds, the joints are too "
            words += "soft"
    else:
        parts = [
            f"{value * unit:.1f} N at {names[i]}"
            for i, value in zip(instant.limb, pull, strict=True)
            if value * unit > _LEAST_PULL
        ]
        gripped = (
            f"with {instant.max_grip * unit:.4g} N of gripping force"
            if instant.closed
            else "with open grippers"
        )
        words = f"{gripped} pull towards the surface is missing: {', '.join(parts)}"
    return Conflict("", (words,), in_words=True, names=checks)


def missing_pull(instant: GripInstant) -> Array | None:
    """(n,) least further pull towards the surface, of least sum, in units of the load.

    None if no pull would do.
    """
    n = instant.contacts
    program = conic_program(instant, extra=n)
    start = instant.size + 1
    pulls = np.zeros((instant.size, n))
    for i in range(n):
        # A pull acts as a palm force along -n that no surface has to push back.
        pulls[:, i] = -instant.part_rows(i, 0)[0]
    linear = _linear(instant)
    rows = {name: linear[own] for name, own in linear_blocks(n).items()}
    _add_columns(program, {"force.equilibrium": instant.grasp, **rows}, pulls, start)
    least = np.zeros((n, program.size))
    least[:, start:] = -np.eye(n)
    program.below("pull", least, np.zeros(n))
    cost = np.zeros(program.size)
    cost[start:] = 1.0
    answer = program.minimise(cost)
    return None if answer is None else np.maximum(answer.x[start:], 0.0)


def _linear(instant: GripInstant) -> Array:
    """Rows of torque, gripping force and commands; pressure is the palm's own."""
    n = instant.contacts
    return np.concatenate(
        [
            instant.torque,
            -instant.torque,
            instant.grip,
            -instant.grip,
            np.zeros((3 * n, instant.size)),
            instant.bending,
            -instant.bending,
        ]
    )


def _add_columns(program: ConicProgram, rows: dict[str, Array], forces: Array, start: int) -> None:
    """Let variables from `start` on add `forces` (9 n, m) in the named blocks."""
    blocks = []
    for name, cone, A, b in program.blocks:
        wider = A
        if name in rows:
            wider = A.copy()
            wider[:, start : start + forces.shape[1]] = rows[name] @ forces
        blocks.append((name, cone, wider, b))
    program.blocks = blocks


@dataclass(frozen=True)
class _Remedies:
    """What would make instants feasible, each on its own; None where it would not."""

    grip: float | None  # [N]
    mass_name: str
    mass: float | None  # [kg]
    torque: float | None  # factor on all torque limits, wrists and grippers included
    friction: float | None  # S_mu

    def and_also(self, other: _Remedies) -> _Remedies:
        """What makes both feasible."""

        def both(
            a: float | None, b: float | None, of: Callable[[float, float], float]
        ) -> float | None:
            return None if a is None or b is None else of(a, b)

        same = self.mass_name == other.mass_name
        return _Remedies(
            both(self.grip, other.grip, max),
            other.mass_name,
            both(self.mass, other.mass, min) if same else None,
            both(self.torque, other.torque, max),
            both(self.friction, other.friction, min),
        )

    def remedies(self) -> tuple[Remedy, ...]:
        """As remedies, with three digits to the safe side."""
        out = []
        if self.grip is not None:
            out.append(Remedy(f"gripping force >= {_rounded(self.grip, np.ceil):.4g} N a finger"))
        if self.mass is not None:
            most = _rounded(self.mass, np.floor)
            key = "task.payload.mass" if self.mass_name == "payload" else ""
            out.append(Remedy(f"{self.mass_name} <= {most:.4g} kg", key, most))
        if self.torque is not None:
            out.append(Remedy(f"all motors {_rounded(self.torque, np.ceil):.4g} times as strong"))
        if self.friction is not None:
            most = _rounded(self.friction, np.floor)
            out.append(Remedy(f"S_mu <= {most:.4g}", "force.safety_friction", most))
        return tuple(out)


def _rounded(value: float, way: Callable[[float], float]) -> float:
    safe = value * (1 + _SAFE) if way is np.ceil else value * (1 - _SAFE)
    step = 10.0 ** (np.floor(np.log10(max(safe, 1e-9))) - 2)
    return float(way(safe / step) * step)


def _remedies(
    scene: MotionScene, instants: Instants, statement: GripStatement, instant: GripInstant, k: int
) -> _Remedies:
    mass_name, mass = _mass(scene, instants, statement, instant, k)
    return _Remedies(
        grip=_least_grip(instant, statement),
        mass_name=mass_name,
        mass=mass,
        torque=_torque_factor(instant),
        friction=_largest_safety(instant),
    )


def _least_grip(instant: GripInstant, statement: GripStatement) -> float | None:
    """Least limit of the gripping force with which the instant is feasible [N]."""
    ready = replace(instant, max_grip=1.0)  # closed; the limit itself is a variable
    program = conic_program(ready, extra=1, fixed_s=True)
    n = instant.contacts
    blocks = []
    for name, cone, A, b in program.blocks:
        wider = A.copy()
        if name == "grip.force":
            wider[:n, instant.size], wider[:n, -1] = 0.0, -1.0
        blocks.append((name, cone, wider, b))
    program.blocks = blocks
    cost = np.zeros(program.size)
    cost[-1] = 1.0
    answer = program.minimise(cost)
    if answer is None:
        return None
    limit = answer.value * statement.unit / instant.largest_s
    return limit if limit <= _LARGEST else None


def _torque_factor(instant: GripInstant) -> float | None:
    """Factor on joint, wrist and gripper limits that makes the instant feasible."""
    if not instant.closed:
        return None
    free = replace(instant, largest_s=100.0 * instant.largest_s)
    program = conic_program(free)
    cost = np.zeros(program.size)
    cost[instant.size] = 1.0
    answer = program.minimise(cost)
    if answer is None or answer.value >= free.largest_s * (1 - 1e-6):
        return None
    return answer.value / instant.largest_s


def _largest_safety(instant: GripInstant) -> float | None:
    """Largest S_mu >= 1 with which the instant is feasible."""
    if instant.safety_friction <= 1 or not _feasible(replace(instant, safety_friction=1.0)):
        return None
    low, high = 1.0, instant.safety_friction
    for _ in range(_BISECTIONS):
        if high - low < 1e-4:
            break
        middle = (low + high) / 2
        if _feasible(replace(instant, safety_friction=middle)):
            low = middle
        else:
            high = middle
    return low


def _feasible(instant: GripInstant) -> bool:
    return _least_s(instant) is not None


def _least_s(instant: GripInstant) -> ConicAnswer | None:
    program = conic_program(instant)
    cost = np.zeros(program.size)
    cost[instant.size] = 1.0
    return program.minimise(cost)


def _mass(
    scene: MotionScene, instants: Instants, statement: GripStatement, instant: GripInstant, k: int
) -> tuple[str, float | None]:
    """Payload, or the robot's own mass if less payload does not do, and its largest value [kg]."""
    gravity, payload = scene.robot.gravity, scene.spec.task.payload
    weight = np.array([0.0, 0.0, -gravity])
    scale = np.array([1.0] * 3 + [1 / statement.length] * 3) / statement.unit
    arm = rotation_world_body(instants.rpy[k]) @ np.array(payload.offset, float)
    carried = np.concatenate([weight, np.cross(arm, weight)]) * scale
    if payload.mass > 0 and (most := _largest_mass(instant, carried, payload.mass)) is not None:
        return "payload", most
    own = np.concatenate([weight, np.zeros(3)]) * scale
    return "mass", _largest_mass(instant, own, scene.robot.mass)


def _largest_mass(instant: GripInstant, per_kg: Array, now: float) -> float | None:
    """Largest mass up to `now` that the instant holds [kg]; None if even none is too much."""
    program = conic_program(instant, extra=1)
    blocks = []
    for name, cone, A, b in program.blocks:
        wider, right = A, b
        if name == "force.equilibrium":
            wider = A.copy()
            wider[:, -1] = now * per_kg
            right = b + now * per_kg
        blocks.append((name, cone, wider, right))
    program.blocks = blocks
    last = np.zeros((1, program.size))
    last[0, -1] = 1.0
    program.below("most", last, np.ones(1))
    program.below("least", -last, np.zeros(1))
    answer = program.minimise(-last[0])
    if answer is None or answer.x[-1] < 1e-3:
        return None
    return float(answer.x[-1]) * now
