"""Why instants have no admissible forces, and what would help, in the robot's terms."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from climbplan.arrays import Array
from climbplan.climb.forces.cones import InstantCones, Name, instant_cones
from climbplan.climb.forces.solving import SolvedForces
from climbplan.climb.forces.statement import ForceStatement
from climbplan.climb.plan.climb_plan import Instants
from climbplan.climb.scene.climb_scene import MotionScene
from climbplan.errors import Conflict, LimitReached, NotProved, Remedy
from climbplan.mechanics.flat_contact import beyond_sole, centre_of_pressure
from climbplan.robots.rotations import rotation_world_body

if TYPE_CHECKING:
    from climbplan.climb.forces.amounts import Interval, LoadDirection
    from climbplan.climb.forces.conflict import Member

LISTED = 5  # instants described one by one
_NAMED = 3  # constraints of one kind named before "and 2 more"
_SAFE = 1e-4  # relative distance from the exact amount before it is rounded


CHOSEN = "these are the forces of postures that the planner chose; others may hold"


@dataclass(frozen=True)
class Amounts:
    """What would make instants feasible, each on its own; None where it would not."""

    friction_factor: float | None
    torque_factor: float | None
    stiffness_factor: float | None
    load_name: str
    masses: Interval | None


class NoForces(NotProved):
    """Instants of postures that the planner chose have no admissible contact forces."""

    def __init__(
        self,
        message: str,
        conflicts: list[Conflict],
        unsteady: bool,
        whole: tuple[Remedy, ...] | None = None,
    ) -> None:
        """whole: remedies of all instants together; None where one instant alone has no forces."""
        self.unsteady = unsteady  # the stability of the braced body takes part in every conflict
        self._whole = whole
        super().__init__(message, conflicts, because=CHOSEN, stage="force")

    @property
    def remedies(self) -> tuple[Remedy, ...]:
        """Those with which all instants have forces: what mends one of them is not enough."""
        return super().remedies if self._whole is None else self._whole


def explain(
    scene: MotionScene,
    instants: Instants,
    statement: ForceStatement,
    solved: SolvedForces,
) -> NoForces:
    """The error that says which constraints of which instants conflict and what would help.

    Raises LimitReached if an instant turns out feasible after all, which means that no solver could
    be trusted with it.
    """
    from climbplan.climb.forces.conflict import conflicting_members
    from climbplan.climb.forces.tried_remedies import tried

    infeasible, unbalanced = solved.missing, solved.unbalanced
    names = scene.robot.limb_names
    conflicts: list[Conflict] = []
    worst: Amounts | None = None
    unsteady = len(unbalanced) == 0
    for k in np.sort(np.concatenate([infeasible, unbalanced])):
        where = instants.label(int(k), names)
        if k in unbalanced:
            limbs = [names[i] for i in np.flatnonzero(statement.standing[k])]
            alone = f"balance on {_listed(limbs, len(limbs))} alone" if limbs else "balance"
            alone += _pressed_beyond(statement, int(k))
            conflicts.append(Conflict(where, (alone,), names=("force.equilibrium",)))
            worst = Amounts(None, None, None, "mass", None)
            continue
        cones = instant_cones(statement, int(k))
        load = _load(scene, instants, statement, int(k), cones)
        if len(conflicts) < LISTED:
            members = conflicting_members(cones)
            if members is None:
                raise LimitReached(
                    f"{where}: contact forces are feasible only just; no solver found them"
                )
            unsteady &= any(member.name == "static.stability" for member in members)
            amounts = _amounts(cones, load, None)
            remedies = _remedies(scene, statement, amounts)
            if len(infeasible) == 1 and not len(unbalanced):
                remedies = tried(scene, instants, remedies)
            words = _constraints(members, cones, statement, int(k))
            found = Conflict(where, tuple(words.values()), remedies, names=tuple(words))
            conflicts.append(found)
            worst = _worse(worst, amounts)
        else:
            # The conflicts that are not listed are not looked into: taken to be like the others
            worst = _worse(worst, _amounts(cones, load, worst))
    count = len(infeasible) + len(unbalanced)
    message = f"{count} of {instants.count} instants have no admissible contact forces"
    whole: tuple[Remedy, ...] | None = None
    if count > 1:
        whole = ()
        if worst is not None:
            whole = tried(scene, instants, _remedies(scene, statement, worst))
        if whole:
            message += f"; all have with {' or '.join(map(str, whole))}"
    if count > len(conflicts[:LISTED]):
        message += f"; the first {LISTED}:"
    return NoForces(message, conflicts[:LISTED], unsteady, whole)


def fragile_notes(
    scene: MotionScene, instants: Instants, asked: ForceStatement, share: Array
) -> tuple[str, ...]:
    """Which instants keep less than their margins, and at the worst what conflicts and helps.

    asked: the problems with all of their margins; share: (K,) of them that forces keep.
    """
    from climbplan.climb.forces.conflict import conflicting_members

    if (worst := most_fragile(instants, share, scene.robot.limb_names)) is None:
        return ()
    k, text = worst
    cones = instant_cones(asked, k)
    members = conflicting_members(cones)
    if not members:
        text += ": joints deflect so far that toes are commanded outside their surfaces"
    else:
        words = _constraints(members, cones, asked, k)
        text += f": {' and '.join(words.values())} cannot all be satisfied"
        amounts = _amounts(cones, _load(scene, instants, asked, k, cones), None)
        if cures := _remedies(scene, asked, amounts):
            text += f"; all margins are kept with {' or '.join(map(str, cures))}"
    return (text,)


def most_fragile(
    instants: Instants, share: Array, limbs: tuple[str, ...]
) -> tuple[int, str] | None:
    """The instant that keeps the least share (K,) of its margins, and words; None if all do."""
    short = np.flatnonzero(share < 1.0)
    if not len(short):
        return None
    k = int(short[np.argmin(share[short])])
    kept = f"{share[k]:.0%} of its margins" if share[k] > 0 else "none of its margins"
    among = f"{len(short)} of {len(share)} instants, " if len(short) > 1 else ""
    return k, f"fragile: {among}{instants.label(k, limbs)} keeps {kept}"


def _one_friction(scene: MotionScene) -> bool:
    """Whether every surface has the terrain's own coefficient, so that its key changes all."""
    friction = scene.spec.terrain.friction
    return all(surface.friction == friction for surface in scene.terrain.surfaces)


def _load(
    scene: MotionScene, instants: Instants, statement: ForceStatement, k: int, cones: InstantCones
) -> LoadDirection:
    """The payload if there is one and less of it would help, else the robot's own mass."""
    from climbplan.climb.forces.amounts import LoadDirection, feasible_masses

    gravity, payload = scene.robot.gravity, scene.spec.task.payload
    weight = np.array([0.0, 0.0, -gravity])
    arm = rotation_world_body(instants.rpy[k]) @ np.array(payload.offset, float)
    scale = np.array([1.0] * 3 + [1 / statement.length] * 3) / statement.unit
    carried = LoadDirection(
        "payload", payload.mass, np.concatenate([weight, np.cross(arm, weight)]) * scale
    )
    if feasible_masses(cones, carried) is not None:
        return carried
    # Of a robot whose links weigh what they do, no one number is its mass
    mass = scene.robot.mass if scene.robot.links is None else 0.0
    return LoadDirection("mass", mass, np.concatenate([weight, np.zeros(3)]) * scale)


def _amounts(cones: InstantCones, load: LoadDirection, worst: Amounts | None) -> Amounts:
    """Exact amounts for one instant; of friction only what exceeds the worst so far."""
    from climbplan.climb.forces.amounts import (
        feasible_masses,
        least_friction_factor,
        least_stiffness_factor,
        least_torque_factor,
    )

    if worst is None:
        friction = least_friction_factor(cones)
    elif worst.friction_factor is None:
        friction = None
    else:
        friction = least_friction_factor(cones, worst.friction_factor)
    torque, stiffness = least_torque_factor(cones), least_stiffness_factor(cones)
    return Amounts(friction, torque, stiffness, load.name, feasible_masses(cones, load))


def _worse(a: Amounts | None, b: Amounts) -> Amounts:
    """What makes both instants feasible."""
    from climbplan.climb.forces.amounts import Interval

    if a is None:
        return b

    def larger(x: float | None, y: float | None) -> float | None:
        return None if x is None or y is None else max(x, y)

    masses = None
    if a.masses and b.masses and a.load_name == b.load_name:
        masses = Interval(max(a.masses.low, b.masses.low), min(a.masses.high, b.masses.high))
        masses = masses if masses.low < masses.high else None
    return Amounts(
        larger(a.friction_factor, b.friction_factor),
        larger(a.torque_factor, b.torque_factor),
        larger(a.stiffness_factor, b.stiffness_factor),
        b.load_name,
        masses,
    )


def _up(value: float) -> float:
    """Slightly more than `value`, in three digits."""
    step = 10.0 ** (np.floor(np.log10(value)) - 2)
    return float(np.ceil(value * (1 + _SAFE) / step) * step)


def _down(value: float) -> float:
    """Slightly less than `value`, in three digits."""
    step = 10.0 ** (np.floor(np.log10(value)) - 2)
    return float(np.floor(value * (1 - _SAFE) / step) * step)


def _remedies(
    scene: MotionScene, statement: ForceStatement, amounts: Amounts
) -> tuple[Remedy, ...]:
    """What helps, each sufficient on its own."""
    out: list[Remedy] = []
    mu = statement.mu[statement.contact]
    factor = amounts.friction_factor
    if factor is not None:
        same = np.ptp(mu) <= 1e-12 * mu.max()
        if same:
            least = _up(factor * float(mu[0]))
            key = "terrain.friction" if _one_friction(scene) else ""
            out.append(Remedy(f"mu >= {least:.4g}", key, least))
        else:
            out.append(Remedy(f"friction coefficients {_up(factor):.4g} times as high"))
    if amounts.masses is not None:
        low, high = amounts.masses.low, amounts.masses.high
        key = "task.payload.mass" if amounts.load_name == "payload" else ""
        words = None
        if low <= 1e-6 * high:
            words = f"{amounts.load_name} <= {_down(high):.4g} kg"
        elif _up(low) < _down(high):
            words = f"{amounts.load_name} from {_up(low):.4g} to {_down(high):.4g} kg"
        if words is not None:
            out.append(Remedy(words, key, _down(high)))
    if amounts.torque_factor is not None:
        limit = scene.robot.max_torque
        factor_up = amounts.torque_factor
        out.append(
            Remedy(f"torque limit >= {_up(factor_up * float(limit[0, 0])):.4g} N m")
            if np.ptp(limit) <= 1e-12 * limit.max() and not scene.robot.slides.any()
            else Remedy(f"torque limits {_up(factor_up):.4g} times as high")
        )
        # Where a margin has motors keep more than S_tau does, less of that is no help
        bounds = (statement.largest_s * statement.least_safety_torque).min() > 1 - _SAFE
        safety = statement.least_safety_torque / factor_up
        if bounds and safety * (1 - _SAFE) >= 1:
            out.append(
                Remedy(f"S_tau <= {_down(safety):.4g}", "force.safety_torque", _down(safety))
            )
    if amounts.stiffness_factor is not None:
        out.append(Remedy(f"{_up(amounts.stiffness_factor):.4g} times the joint stiffness"))
    if factor is not None and (safety := statement.safety_friction / factor) * (1 - _SAFE) >= 1:
        out.append(Remedy(f"S_mu <= {_down(safety):.4g}", "force.safety_friction", _down(safety)))
    return tuple(out)


def _constraints(
    members: list[Member], cones: InstantCones, statement: ForceStatement, k: int
) -> dict[str, str]:
    """Members of instant k in words, one phrase for each check that judges them."""
    robot, unit = statement.robot, statement.unit
    limb = [robot.limb_names[i] for i in cones.limb]
    points = cones.contacts // max(len(limb), 1)
    depth = float(cones.least_depth.max(initial=0.0))
    pressed = f"pressure of {points * cones.least_pressure * unit:.3g} N at"
    kinds: dict[Name, str] = {
        "force.friction": "friction at",
        "torque.limit": "torque of",
        "force.unilateral": pressed if cones.least_pressure > 0 else "push-only contact at",
        "force.inward": f"command {1e3 * depth:.3g} mm inside its surface of",
        "kinematics.joint_bounds": "command within bounds of",
        "static.stability": "stability of the braced body",
    }
    phrases: dict[str, str] = {}
    for name, words in kinds.items():
        chosen = [m for m in members if m.name == name]
        if not chosen:
            continue
        if name == "static.stability":
            phrases[name] = words
            continue
        if chosen[0].joint >= 0:
            joints = [robot.joint_name(int(cones.limb[m.contact]), m.joint) for m in chosen]
            said = [f"{limb[m.contact]} {joint}" for m, joint in zip(chosen, joints, strict=True)]
            listed = _listed(said, _NAMED)
        elif len(chosen) == len(limb) > _NAMED:
            listed = f"all {len(limb)} limbs"
        else:
            places = [m.contact for m in chosen]
            if name != "force.inward":
                places = [int(cones.limb_of[i]) for i in places]
            listed = _listed([limb[i] for i in dict.fromkeys(places)], _NAMED)
            if name == "force.unilateral":
                listed += _pressed_beyond(statement, k)
        phrases[name] = f"{words} {listed}"
    return phrases


def _pressed_beyond(statement: ForceStatement, k: int) -> str:
    """How far beyond its sole the load has the centre of pressure of the one foot that stands.

    Nothing where several do, or none is flat.
    """
    sole, standing = statement.robot.sole, statement.standing[k]
    if sole is None or standing.sum() != 1:
        return ""
    point = np.flatnonzero(statement.contact[k])
    middle, force = statement.arms[k, point].mean(axis=0), -statement.load[k, :3]
    moment = -statement.load[k, 3:] - np.cross(middle, force)
    centre = centre_of_pressure(sole, statement.normal[k, point[0]], force, moment)
    beyond = 1e3 * float(beyond_sole(sole, centre))
    if not beyond > 0:
        return ""
    return f" (its centre of pressure {beyond:.0f} mm beyond the edge of its sole)"


def _listed(names: list[str], most: int) -> str:
    if len(names) > most + 1:
        return f"{', '.join(names[:most])} and {len(names) - most} more"
    return ", ".join(names)
