"""Explain why a robot with grippers cannot hold itself: where pull is missing, and what would help.

The exact conic program gets a free pull towards the surface at every grip. The smallest sum of
these pulls is what grippers lack, in newtons at named limbs. Each remedy is the exact optimum of
one further program.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from climbplan.arrays import Array, IntArray
from climbplan.climb.forces.cones import ConicAnswer, ConicProgram
from climbplan.climb.forces.explanation import POSTURES_CHOSEN, find_most_fragile
from climbplan.climb.forces.grips.program import (
    GripInstant,
    build_conic_program,
    build_grip_instant,
    map_linear_blocks,
)
from climbplan.climb.forces.grips.statement import GripStatement
from climbplan.climb.plan.climb_plan import Instants
from climbplan.climb.scene.climb_scene import MotionScene
from climbplan.errors import Conflict, LimitReached, Remedy, Unresolved
from climbplan.robots.rotations import rotation_world_body

MAX_LISTED = 5  # instants described one by one
_MIN_PULL = 0.05  # [N] less is not told
_UNBOUNDED_COMMAND = 100.0  # [rad] beyond all bounds
_MAX_GRIP_FORCE = 1e4  # [N] a gripping force beyond is no remedy
_ROUNDING_MARGIN = 1e-3  # relative, added to what is said to be enough
_MAX_BISECTIONS = 30


def explain_grips(
    scene: MotionScene, instants: Instants, statement: GripStatement, missing: IntArray
) -> Unresolved:
    """Return the error that says what is missing at instants without admissible forces.

    Args:
        scene: The scene.
        instants: All instants.
        statement: Their force problems.
        missing: Numbers of the instants without admissible forces.

    Raises:
        LimitReached: An instant is feasible after all.
    """
    names = scene.robot.limb_names
    conflicts: list[Conflict] = []
    worst: _SufficientGripChanges | None = None
    for k in missing:
        instant = build_grip_instant(statement, int(k))
        instant_label = instants.label(int(k), names)
        pull = minimise_missing_pull(instant)
        if pull is not None and pull.sum() * statement.unit <= _MIN_PULL:
            raise LimitReached(
                f"{instant_label}: grips are feasible only just; no solver found forces"
            )
        changes = _compute_changes(scene, instants, statement, instant, int(k))
        worst = changes if worst is None else worst.combine_with(changes)
        if len(conflicts) < MAX_LISTED:
            conflict = _describe_missing_pull(instant, pull, statement.unit, names)
            conflicts.append(
                replace(conflict, where=instant_label, remedies=changes.build_remedies())
            )
    message = f"{len(missing)} of {instants.count} instants have no admissible grips"
    if len(missing) > 1 and worst is not None and (remedies := worst.build_remedies()):
        message += f"; all have with {' or '.join(map(str, remedies))}"
    if len(missing) > MAX_LISTED:
        message += f"; the first {MAX_LISTED}:"
    return Unresolved(message, conflicts, because=POSTURES_CHOSEN, stage="force")


def describe_fragile_grips(
    scene: MotionScene, instants: Instants, statement: GripStatement, margin_fraction: Array
) -> tuple[str, ...]:
    """Describe instants that do not reach their margins, with remedies of the worst one.

    Args:
        scene: The scene.
        instants: All instants.
        statement: The force problems with all of their margins.
        margin_fraction: (K,) fraction of the margins that grips reach.
    """
    if (worst := find_most_fragile(instants, margin_fraction, scene.robot.limb_names)) is None:
        return ()
    k, text = worst
    instant = build_grip_instant(statement, k)
    pull = statement.pull[k]
    text += f": not every grip has a pull-out reserve of {pull:.1f} N" if pull > 0 else ""
    # A smaller S_mu is no remedy: the margin of friction has a safety factor of its own
    changes = _compute_changes(scene, instants, statement, instant, k)
    remedies = replace(changes, safety_friction=None).build_remedies()
    return (
        f"{text}; all margins are kept with {' or '.join(map(str, remedies))}"
        if remedies
        else text,
    )


def _describe_missing_pull(
    instant: GripInstant, pull: Array | None, unit: float, names: tuple[str, ...]
) -> Conflict:
    """Describe what is missing, without place and remedies."""
    check_names: tuple[str, ...] = ("grip.unilateral", "grip.shear")
    if pull is None:
        unbounded = replace(
            instant, command_margin=np.full_like(instant.command_margin, _UNBOUNDED_COMMAND)
        )
        if minimise_missing_pull(unbounded) is None:
            check_names = ("torque.limit", "wrist.torque")
            description = "no pull would do: joint or wrist torques are too small for the load"
        else:
            check_names = ("kinematics.joint_bounds",)
            description = (
                "no pull would do: joint commands would leave their bounds, the joints are too "
            )
            description += "soft"
    else:
        pulls_by_limb = [
            f"{value * unit:.1f} N at {names[i]}"
            for i, value in zip(instant.limb, pull, strict=True)
            if value * unit > _MIN_PULL
        ]
        grip_text = (
            f"with {instant.max_grip * unit:.4g} N of gripping force"
            if instant.can_grip
            else "with open grippers"
        )
        description = f"{grip_text} pull towards the surface is missing: {', '.join(pulls_by_limb)}"
    return Conflict("", (description,), in_words=True, names=check_names)


def minimise_missing_pull(instant: GripInstant) -> Array | None:
    """Return the additional pulls (n,) of smallest sum towards the surfaces, in units of the load.

    The result is None if no pull is sufficient.
    """
    n = instant.num_contacts
    program = build_conic_program(instant, extra=n)
    start = instant.size + 1
    pull_columns = np.zeros((instant.size, n))
    for i in range(n):
        # A pull acts as a palm force along -n that no surface has to push back.
        pull_columns[:, i] = -instant.build_part_rows(i, 0)[0]
    linear = _build_linear_rows(instant)
    rows = {name: linear[block_rows] for name, block_rows in map_linear_blocks(n).items()}
    _add_columns(program, {"force.equilibrium": instant.grasp, **rows}, pull_columns, start)
    lower_rows = np.zeros((n, program.size))
    lower_rows[:, start:] = -np.eye(n)
    program.add_inequality("pull", lower_rows, np.zeros(n))
    cost = np.zeros(program.size)
    cost[start:] = 1.0
    solution = program.minimise(cost)
    return None if solution is None else np.maximum(solution.x[start:], 0.0)


def _build_linear_rows(instant: GripInstant) -> Array:
    """Return the rows of torque, gripping force and commands; pressure rows are zero.

    An additional pull needs no pressure of the palm.
    """
    n = instant.num_contacts
    return np.concatenate(
        [
            instant.torque,
            -instant.torque,
            instant.grip,
            -instant.grip,
            np.zeros((3 * n, instant.size)),
            instant.deflection_per_force,
            -instant.deflection_per_force,
        ]
    )


def _add_columns(program: ConicProgram, rows: dict[str, Array], forces: Array, start: int) -> None:
    """Let the variables from `start` on add `forces` (9 n, m) in the named blocks."""
    blocks = []
    for name, cone, A, b in program.blocks:
        widened = A
        if name in rows:
            widened = A.copy()
            widened[:, start : start + forces.shape[1]] = rows[name] @ forces
        blocks.append((name, cone, widened, b))
    program.blocks = blocks


@dataclass(frozen=True)
class _SufficientGripChanges:
    """Changes that make instants feasible, each on its own; None where no such change does."""

    grip_force: float | None  # [N]
    mass_name: str
    max_mass: float | None  # [kg]
    torque_factor: float | None  # factor on all torque limits, wrists and grippers included
    safety_friction: float | None  # S_mu

    def combine_with(self, following: _SufficientGripChanges) -> _SufficientGripChanges:
        """Return the changes that make the instants of both feasible."""

        def both(
            a: float | None, b: float | None, combine: Callable[[float, float], float]
        ) -> float | None:
            return None if a is None or b is None else combine(a, b)

        has_same_mass = self.mass_name == following.mass_name
        return _SufficientGripChanges(
            both(self.grip_force, following.grip_force, max),
            following.mass_name,
            both(self.max_mass, following.max_mass, min) if has_same_mass else None,
            both(self.torque_factor, following.torque_factor, max),
            both(self.safety_friction, following.safety_friction, min),
        )

    def build_remedies(self) -> tuple[Remedy, ...]:
        """Return the changes as remedies, rounded to three digits on the safe side."""
        suggestions = []
        if self.grip_force is not None:
            suggestions.append(
                Remedy(
                    f"gripping force >= {_round_to_digits(self.grip_force, np.ceil):.4g} N a finger"
                )
            )
        if self.max_mass is not None:
            limit = _round_to_digits(self.max_mass, np.floor)
            key = "task.payload.mass" if self.mass_name == "payload" else ""
            suggestions.append(Remedy(f"{self.mass_name} <= {limit:.4g} kg", key, limit))
        if self.torque_factor is not None:
            factor = _round_to_digits(self.torque_factor, np.ceil)
            suggestions.append(Remedy(f"all motors {factor:.4g} times as strong"))
        if self.safety_friction is not None:
            limit = _round_to_digits(self.safety_friction, np.floor)
            suggestions.append(Remedy(f"S_mu <= {limit:.4g}", "force.safety_friction", limit))
        return tuple(suggestions)


def _round_to_digits(value: float, rounding: Callable[[float], float]) -> float:
    """Round a value with a safety margin to three digits, by `np.ceil` or `np.floor`."""
    with_margin = (
        value * (1 + _ROUNDING_MARGIN) if rounding is np.ceil else value * (1 - _ROUNDING_MARGIN)
    )
    digit = 10.0 ** (np.floor(np.log10(max(with_margin, 1e-9))) - 2)
    return float(rounding(with_margin / digit) * digit)


def _compute_changes(
    scene: MotionScene, instants: Instants, statement: GripStatement, instant: GripInstant, k: int
) -> _SufficientGripChanges:
    """Return the exact sufficient changes of one instant."""
    mass_name, mass = _select_mass(scene, instants, statement, instant, k)
    return _SufficientGripChanges(
        grip_force=_minimise_grip_limit(instant, statement),
        mass_name=mass_name,
        max_mass=mass,
        torque_factor=_minimise_torque_factor(instant),
        safety_friction=_maximise_safety_friction(instant),
    )


def _minimise_grip_limit(instant: GripInstant, statement: GripStatement) -> float | None:
    """Return the smallest limit of the gripping force with which the instant is feasible [N]."""
    closed_instant = replace(instant, max_grip=1.0)  # closed; the limit itself is a variable
    program = build_conic_program(closed_instant, extra=1, fixed_s=True)
    n = instant.num_contacts
    blocks = []
    for name, cone, A, b in program.blocks:
        widened = A.copy()
        if name == "grip.force":
            widened[:n, instant.size], widened[:n, -1] = 0.0, -1.0
        blocks.append((name, cone, widened, b))
    program.blocks = blocks
    cost = np.zeros(program.size)
    cost[-1] = 1.0
    solution = program.minimise(cost)
    if solution is None:
        return None
    limit = solution.value * statement.unit / instant.max_s
    return limit if limit <= _MAX_GRIP_FORCE else None


def _minimise_torque_factor(instant: GripInstant) -> float | None:
    """Return the smallest sufficient factor on the limits of joints, wrists and grippers."""
    if not instant.can_grip:
        return None
    unlimited = replace(instant, max_s=100.0 * instant.max_s)
    program = build_conic_program(unlimited)
    cost = np.zeros(program.size)
    cost[instant.size] = 1.0
    solution = program.minimise(cost)
    if solution is None or solution.value >= unlimited.max_s * (1 - 1e-6):
        return None
    return solution.value / instant.max_s


def _maximise_safety_friction(instant: GripInstant) -> float | None:
    """Return the largest S_mu >= 1 with which the instant is feasible."""
    if instant.safety_friction <= 1 or not _is_feasible(replace(instant, safety_friction=1.0)):
        return None
    low, high = 1.0, instant.safety_friction
    for _ in range(_MAX_BISECTIONS):
        if high - low < 1e-4:
            break
        middle = (low + high) / 2
        if _is_feasible(replace(instant, safety_friction=middle)):
            low = middle
        else:
            high = middle
    return low


def _is_feasible(instant: GripInstant) -> bool:
    """Return whether the instant is feasible on the exact cones."""
    return _minimise_s(instant) is not None


def _minimise_s(instant: GripInstant) -> ConicAnswer | None:
    """Solve the exact program of an instant for the smallest s."""
    program = build_conic_program(instant)
    cost = np.zeros(program.size)
    cost[instant.size] = 1.0
    return program.minimise(cost)


def _select_mass(
    scene: MotionScene, instants: Instants, statement: GripStatement, instant: GripInstant, k: int
) -> tuple[str, float | None]:
    """Return the payload, or the robot's own mass if less payload is not enough, with its maximum
    [kg].
    """
    gravity, payload = scene.robot.gravity, scene.spec.task.payload
    weight = np.array([0.0, 0.0, -gravity])
    scale = np.array([1.0] * 3 + [1 / statement.length] * 3) / statement.unit
    lever_arm = rotation_world_body(instants.rpy[k]) @ np.array(payload.offset, float)
    payload_per_kg = np.concatenate([weight, np.cross(lever_arm, weight)]) * scale
    if (
        payload.mass > 0
        and (max_payload := _maximise_mass(instant, payload_per_kg, payload.mass)) is not None
    ):
        return "payload", max_payload
    mass_per_kg = np.concatenate([weight, np.zeros(3)]) * scale
    return "mass", _maximise_mass(instant, mass_per_kg, scene.robot.mass)


def _maximise_mass(instant: GripInstant, per_kg: Array, current_mass: float) -> float | None:
    """Return the largest mass up to the present one that the instant holds [kg]; None if none."""
    program = build_conic_program(instant, extra=1)
    blocks = []
    for name, cone, A, b in program.blocks:
        widened, right_hand_side = A, b
        if name == "force.equilibrium":
            widened = A.copy()
            widened[:, -1] = current_mass * per_kg
            right_hand_side = b + current_mass * per_kg
        blocks.append((name, cone, widened, right_hand_side))
    program.blocks = blocks
    mass_row = np.zeros((1, program.size))
    mass_row[0, -1] = 1.0
    program.add_inequality("most", mass_row, np.ones(1))
    program.add_inequality("least", -mass_row, np.zeros(1))
    solution = program.minimise(-mass_row[0])
    if solution is None or solution.x[-1] < 1e-3:
        return None
    return float(solution.x[-1]) * current_mass
