"""Explain in the robot's terms why instants have no admissible forces, and what would help."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from climbplan.arrays import Array
from climbplan.climb.forces.cones import ConstraintName, InstantCones, build_instant_cones
from climbplan.climb.forces.solving import SolvedForces
from climbplan.climb.forces.statement import ForceStatement
from climbplan.climb.plan.climb_plan import Instants
from climbplan.climb.scene.climb_scene import MotionScene
from climbplan.errors import Conflict, LimitReached, Remedy, Unresolved
from climbplan.mechanics.flat_contact import beyond_sole, centre_of_pressure
from climbplan.robots.rotations import rotation_world_body

if TYPE_CHECKING:
    from climbplan.climb.forces.conflict import Member
    from climbplan.climb.forces.sufficient_changes import Interval, LoadDirection

MAX_LISTED = 5  # instants described one by one
_MAX_NAMED = 3  # constraints of one kind named before "and 2 more"
_ROUNDING_MARGIN = 1e-4  # relative distance from the exact amount before it is rounded


POSTURES_CHOSEN = "these are the forces of postures that the planner chose; others may hold"


@dataclass(frozen=True)
class SufficientChanges:
    """Changes that make instants feasible, each on its own; None where no such change does."""

    friction_factor: float | None
    torque_factor: float | None
    stiffness_factor: float | None
    load_name: str
    masses: Interval | None


class NoForces(Unresolved):
    """Instants of postures that the planner chose have no admissible contact forces."""

    def __init__(
        self,
        message: str,
        conflicts: list[Conflict],
        is_unstable: bool,
        common_remedies: tuple[Remedy, ...] | None = None,
    ) -> None:
        """Collect the conflicts of the instants.

        Args:
            message: First line of the error.
            conflicts: One conflict per listed instant.
            is_unstable: Whether the stability of the braced body takes part in every conflict.
            common_remedies: Remedies of all instants together; None where a single instant has no
                forces.
        """
        self.is_unstable = (
            is_unstable  # the stability of the braced body takes part in every conflict
        )
        self._whole = common_remedies
        super().__init__(message, conflicts, because=POSTURES_CHOSEN, stage="force")

    @property
    def remedies(self) -> tuple[Remedy, ...]:
        """Return remedies with which all instants have forces; a remedy of one instant is not
        enough.
        """
        return super().remedies if self._whole is None else self._whole


def explain_infeasible_forces(
    scene: MotionScene,
    instants: Instants,
    statement: ForceStatement,
    solved: SolvedForces,
) -> NoForces:
    """Return the error that says which constraints of which instants conflict and what would help.

    Args:
        scene: The scene.
        instants: All instants.
        statement: Their force problems.
        solved: Answers, with the instants that have none.

    Raises:
        LimitReached: An instant is feasible after all, so that no solver could be trusted with it.
    """
    from climbplan.climb.forces.verified_remedies import keep_verified_remedies

    infeasible, unbalanced = solved.missing, solved.unbalanced
    names = scene.robot.limb_names
    conflicts: list[Conflict] = []
    worst: SufficientChanges | None = None
    is_unstable = len(unbalanced) == 0
    for k in np.sort(np.concatenate([infeasible, unbalanced])):
        instant_label = instants.label(int(k), names)
        if k in unbalanced:
            conflicts.append(_explain_imbalance(statement, int(k), instant_label))
            worst = SufficientChanges(None, None, None, "mass", None)
            continue
        cones = build_instant_cones(statement, int(k))
        load = _select_load(scene, instants, statement, int(k), cones)
        if len(conflicts) < MAX_LISTED:
            members = _find_conflict(cones, instant_label)
            is_unstable &= any(member.name == "static.stability" for member in members)
            changes = _compute_changes(cones, load, None)
            remedies = _build_remedies(scene, statement, changes)
            if len(infeasible) == 1 and not len(unbalanced):
                remedies = keep_verified_remedies(scene, instants, remedies)
            phrases = _describe_members(members, cones, statement, int(k))
            texts = tuple(phrases.values())
            conflicts.append(Conflict(instant_label, texts, remedies, names=tuple(phrases)))
            worst = _combine_changes(worst, changes)
        else:
            # The conflicts that are not listed are not looked into: taken to be like the others
            worst = _combine_changes(worst, _compute_changes(cones, load, worst))
    count = len(infeasible) + len(unbalanced)
    message = f"{count} of {instants.count} instants have no admissible contact forces"
    common_remedies: tuple[Remedy, ...] | None = None
    if count > 1:
        common_remedies = ()
        if worst is not None:
            remedies = _build_remedies(scene, statement, worst)
            common_remedies = keep_verified_remedies(scene, instants, remedies)
        if common_remedies:
            message += f"; all have with {' or '.join(map(str, common_remedies))}"
    if count > len(conflicts[:MAX_LISTED]):
        message += f"; the first {MAX_LISTED}:"
    return NoForces(message, conflicts[:MAX_LISTED], is_unstable, common_remedies)


def _explain_imbalance(statement: ForceStatement, k: int, label: str) -> Conflict:
    """Return the conflict of an instant whose limbs cannot balance the load with any forces."""
    names = statement.robot.limb_names
    limbs = [names[i] for i in np.flatnonzero(statement.standing[k])]
    text = f"balance on {_join_names(limbs, len(limbs))} alone" if limbs else "balance"
    text += _describe_cop_excess(statement, k)
    return Conflict(label, (text,), names=("force.equilibrium",))


def _find_conflict(cones: InstantCones, label: str) -> list[Member]:
    """Return the constraints of an instant that conflict.

    Raises:
        LimitReached: They are feasible after all.
    """
    from climbplan.climb.forces.conflict import find_irreducible_conflict

    members = find_irreducible_conflict(cones)
    if members is None:
        raise LimitReached(f"{label}: contact forces are feasible only just; no solver found them")
    return members


def describe_fragile_instants(
    scene: MotionScene, instants: Instants, statement: ForceStatement, margin_fraction: Array
) -> tuple[str, ...]:
    """Describe instants that do not reach their margins, with conflict and remedies of the worst
    one.

    Args:
        scene: The scene.
        instants: All instants.
        statement: The force problems with all of their margins.
        margin_fraction: (K,) fraction of the margins that forces reach.
    """
    from climbplan.climb.forces.conflict import find_irreducible_conflict

    if (worst := find_most_fragile(instants, margin_fraction, scene.robot.limb_names)) is None:
        return ()
    k, text = worst
    cones = build_instant_cones(statement, k)
    members = find_irreducible_conflict(cones)
    if not members:
        text += ": joints deflect so far that toes are commanded outside their surfaces"
    else:
        phrases = _describe_members(members, cones, statement, k)
        text += f": {' and '.join(phrases.values())} cannot all be satisfied"
        changes = _compute_changes(cones, _select_load(scene, instants, statement, k, cones), None)
        if remedies := _build_remedies(scene, statement, changes):
            text += f"; all margins are kept with {' or '.join(map(str, remedies))}"
    return (text,)


def find_most_fragile(
    instants: Instants, margin_fraction: Array, limb_names: tuple[str, ...]
) -> tuple[int, str] | None:
    """Return the instant with the smallest fraction (K,) of its margins, with a text; None if all
    keep 1.
    """
    fragile = np.flatnonzero(margin_fraction < 1.0)
    if not len(fragile):
        return None
    k = int(fragile[np.argmin(margin_fraction[fragile])])
    kept_text = (
        f"{margin_fraction[k]:.0%} of its margins"
        if margin_fraction[k] > 0
        else "none of its margins"
    )
    count_text = f"{len(fragile)} of {len(margin_fraction)} instants, " if len(fragile) > 1 else ""
    return k, f"fragile: {count_text}{instants.label(k, limb_names)} keeps {kept_text}"


def _has_common_friction(scene: MotionScene) -> bool:
    """Return whether every surface has the terrain's coefficient, so that one key changes all."""
    friction = scene.spec.terrain.friction
    return all(surface.friction == friction for surface in scene.terrain.surfaces)


def _select_load(
    scene: MotionScene, instants: Instants, statement: ForceStatement, k: int, cones: InstantCones
) -> LoadDirection:
    """Return the payload if there is one and less of it would help, else the robot's own mass."""
    from climbplan.climb.forces.sufficient_changes import LoadDirection, find_feasible_masses

    gravity, payload = scene.robot.gravity, scene.spec.task.payload
    weight = np.array([0.0, 0.0, -gravity])
    lever_arm = rotation_world_body(instants.rpy[k]) @ np.array(payload.offset, float)
    scale = np.array([1.0] * 3 + [1 / statement.length] * 3) / statement.unit
    payload_load = LoadDirection(
        "payload", payload.mass, np.concatenate([weight, np.cross(lever_arm, weight)]) * scale
    )
    if find_feasible_masses(cones, payload_load) is not None:
        return payload_load
    # Of a robot whose links weigh what they do, no one number is its mass
    mass = scene.robot.mass if scene.robot.links is None else 0.0
    return LoadDirection("mass", mass, np.concatenate([weight, np.zeros(3)]) * scale)


def _compute_changes(
    cones: InstantCones, load: LoadDirection, previous: SufficientChanges | None
) -> SufficientChanges:
    """Return exact amounts for one instant; of friction only what exceeds the worst so far."""
    from climbplan.climb.forces.sufficient_changes import (
        find_feasible_masses,
        find_min_friction_factor,
        minimise_stiffness_factor,
        minimise_torque_factor,
    )

    if previous is None:
        friction = find_min_friction_factor(cones)
    elif previous.friction_factor is None:
        friction = None
    else:
        friction = find_min_friction_factor(cones, previous.friction_factor)
    torque, stiffness = minimise_torque_factor(cones), minimise_stiffness_factor(cones)
    return SufficientChanges(
        friction, torque, stiffness, load.name, find_feasible_masses(cones, load)
    )


def _combine_changes(a: SufficientChanges | None, b: SufficientChanges) -> SufficientChanges:
    """Return the changes that make both instants feasible."""
    from climbplan.climb.forces.sufficient_changes import Interval

    if a is None:
        return b

    def larger(x: float | None, y: float | None) -> float | None:
        return None if x is None or y is None else max(x, y)

    masses = None
    if a.masses and b.masses and a.load_name == b.load_name:
        masses = Interval(
            max(a.masses.min_mass, b.masses.min_mass), min(a.masses.max_mass, b.masses.max_mass)
        )
        masses = masses if masses.min_mass < masses.max_mass else None
    return SufficientChanges(
        larger(a.friction_factor, b.friction_factor),
        larger(a.torque_factor, b.torque_factor),
        larger(a.stiffness_factor, b.stiffness_factor),
        b.load_name,
        masses,
    )


def _round_up(value: float) -> float:
    """Return slightly more than `value`, in three digits."""
    digit = 10.0 ** (np.floor(np.log10(value)) - 2)
    return float(np.ceil(value * (1 + _ROUNDING_MARGIN) / digit) * digit)


def _round_down(value: float) -> float:
    """Return slightly less than `value`, in three digits."""
    digit = 10.0 ** (np.floor(np.log10(value)) - 2)
    return float(np.floor(value * (1 - _ROUNDING_MARGIN) / digit) * digit)


def _build_remedies(
    scene: MotionScene, statement: ForceStatement, changes: SufficientChanges
) -> tuple[Remedy, ...]:
    """Return remedies, each sufficient on its own."""
    remedies: list[Remedy] = []
    mu = statement.mu[statement.contact]
    factor = changes.friction_factor
    if factor is not None:
        has_common_mu = np.ptp(mu) <= 1e-12 * mu.max()
        if has_common_mu:
            min_mu = _round_up(factor * float(mu[0]))
            key = "terrain.friction" if _has_common_friction(scene) else ""
            remedies.append(Remedy(f"mu >= {min_mu:.4g}", key, min_mu))
        else:
            remedies.append(Remedy(f"friction coefficients {_round_up(factor):.4g} times as high"))
    remedies += _build_mass_remedies(changes)
    remedies += _build_torque_remedies(scene, statement, changes.torque_factor)
    if changes.stiffness_factor is not None:
        remedies.append(
            Remedy(f"{_round_up(changes.stiffness_factor):.4g} times the joint stiffness")
        )
    if factor is not None:
        remedies += _reduce_safety_factor("friction", "S_mu", statement.safety_friction / factor)
    return tuple(remedies)


def _build_mass_remedies(changes: SufficientChanges) -> Iterator[Remedy]:
    """Yield the remedy of another mass of the payload or the robot, if one suffices."""
    if changes.masses is None:
        return
    low, high = changes.masses.min_mass, changes.masses.max_mass
    key = "task.payload.mass" if changes.load_name == "payload" else ""
    max_mass = _round_down(high)
    if low <= 1e-6 * high:
        yield Remedy(f"{changes.load_name} <= {max_mass:.4g} kg", key, max_mass)
    elif _round_up(low) < max_mass:
        text = f"{changes.load_name} from {_round_up(low):.4g} to {max_mass:.4g} kg"
        yield Remedy(text, key, max_mass)


def _build_torque_remedies(
    scene: MotionScene, statement: ForceStatement, factor: float | None
) -> Iterator[Remedy]:
    """Yield remedies equivalent to torque limits multiplied by a factor; None for no such one."""
    if factor is None:
        return
    max_torque = scene.robot.max_torque
    if np.ptp(max_torque) <= 1e-12 * max_torque.max() and not scene.robot.slides.any():
        yield Remedy(f"torque limit >= {_round_up(factor * float(max_torque[0, 0])):.4g} N m")
    else:
        yield Remedy(f"torque limits {_round_up(factor):.4g} times as high")
    # Where a margin has motors keep more than S_tau does, less of that is no help
    if (statement.max_s * statement.min_safety_torque).min() > 1 - _ROUNDING_MARGIN:
        yield from _reduce_safety_factor("torque", "S_tau", statement.min_safety_torque / factor)


def _reduce_safety_factor(name: str, symbol: str, value: float) -> Iterator[Remedy]:
    """Yield the remedy of a smaller safety factor, where it stays above 1."""
    if value * (1 - _ROUNDING_MARGIN) >= 1:
        rounded = _round_down(value)
        yield Remedy(f"{symbol} <= {rounded:.4g}", f"force.safety_{name}", rounded)


def _describe_members(
    members: list[Member], cones: InstantCones, statement: ForceStatement, k: int
) -> dict[str, str]:
    """Describe the members of instant k, one phrase for each check that judges them."""
    robot, unit = statement.robot, statement.unit
    limb_names = [robot.limb_names[i] for i in cones.limb]
    points = cones.num_contacts // max(len(limb_names), 1)
    min_penetration = float(cones.min_penetration.max(initial=0.0))
    pressure_text = f"pressure of {points * cones.min_normal_force * unit:.3g} N at"
    kinds: dict[ConstraintName, str] = {
        "force.friction": "friction at",
        "torque.limit": "torque of",
        "force.unilateral": pressure_text if cones.min_normal_force > 0 else "push-only contact at",
        "force.penetration": f"command {1e3 * min_penetration:.3g} mm inside its surface of",
        "kinematics.joint_bounds": "command within bounds of",
        "static.stability": "stability of the braced body",
    }
    phrases: dict[str, str] = {}
    for name, phrase in kinds.items():
        matching = [m for m in members if m.name == name]
        if not matching:
            continue
        if name == "static.stability":
            phrases[name] = phrase
            continue
        if matching[0].joint >= 0:
            joints = [robot.joint_name(int(cones.limb[m.contact]), m.joint) for m in matching]
            joint_labels = [
                f"{limb_names[m.contact]} {joint}"
                for m, joint in zip(matching, joints, strict=True)
            ]
            place_list = _join_names(joint_labels, _MAX_NAMED)
        elif len(matching) == len(limb_names) > _MAX_NAMED:
            place_list = f"all {len(limb_names)} limbs"
        else:
            indices = [m.contact for m in matching]
            if name != "force.penetration":
                indices = [int(cones.limb_of[i]) for i in indices]
            place_list = _join_names([limb_names[i] for i in dict.fromkeys(indices)], _MAX_NAMED)
            if name == "force.unilateral":
                place_list += _describe_cop_excess(statement, k)
        phrases[name] = f"{phrase} {place_list}"
    return phrases


def _describe_cop_excess(statement: ForceStatement, k: int) -> str:
    """Describe how far the load's centre of pressure is beyond the sole of the only standing foot.

    The result is empty where several feet stand, or none is flat.
    """
    sole, standing = statement.robot.sole, statement.standing[k]
    if sole is None or standing.sum() != 1:
        return ""
    point = np.flatnonzero(statement.contact[k])
    sole_centre, force = statement.arms[k, point].mean(axis=0), -statement.load[k, :3]
    moment = -statement.load[k, 3:] - np.cross(sole_centre, force)
    pressure_centre = centre_of_pressure(sole, statement.normal[k, point[0]], force, moment)
    excess_mm = 1e3 * float(beyond_sole(sole, pressure_centre))
    if not excess_mm > 0:
        return ""
    return f" (its centre of pressure {excess_mm:.0f} mm beyond the edge of its sole)"


def _join_names(names: list[str], max_names: int) -> str:
    """Join names with commas, at most `max_names` of them and a count of the others."""
    if len(names) > max_names + 1:
        return f"{', '.join(names[:max_names])} and {len(names) - max_names} more"
    return ", ".join(names)
