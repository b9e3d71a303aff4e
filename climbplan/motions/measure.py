"""Measures of a motion: slip, penetration, contact distance, limits, friction, power, consistency.

Every measure is computed from the poses of the links, not from the stored contact positions, so
that it holds for files of any origin. Each has a limit that is stated with it; what a file has no
data for is not judged.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from climbplan.arrays import Array, BoolArray, spans_of
from climbplan.errors import UsageError
from climbplan.motions.contact_rule import compute_contact_points
from climbplan.motions.inverse_dynamics import compute_dynamics
from climbplan.motions.link_tree import LinkTree, RobotFile
from climbplan.motions.terrain_distance import FAR, measure_distances
from climbplan.motions.tracked_motion import ContactSamples, TrackedMotion
from climbplan.verification.check import Check

NEAR = 0.02  # [m] from the terrain, within which a point of a foot in contact is in contact
MIN_SAMPLES = 3  # of a motion, for central differences
_MIN_FORCE = 1e-3  # of the largest contact force, below which friction has no direction


@dataclass(frozen=True)
class Measure:
    """What a measure is, and the largest value that passes; an infinite limit judges nothing."""

    limit: float
    unit: str
    meaning: str


MEASURES = {
    "contact.slip": Measure(
        1e-3, "m", "largest way of a foot in contact from where its contact began"
    ),
    "contact.penetration": Measure(2e-3, "m", "largest depth of a foot below the terrain"),
    "contact.distance": Measure(
        2e-3, "m", "largest distance of a foot in contact from the terrain"
    ),
    "contact.friction": Measure(
        1e-3, "of force", "largest excess of tangential forces over mu f_n, by the largest force"
    ),
    "joint.position": Measure(1e-3, "rad, m", "largest excess of positions over joint limits"),
    "joint.speed": Measure(1e-3, "of limit", "largest excess of joint speeds over their limits"),
    "joint.torque": Measure(1e-3, "of limit", "largest excess of torques over their limits"),
    "velocity.joints": Measure(
        0.3, "of speed", "RMS of joint velocities minus differences of positions"
    ),
    "velocity.bodies": Measure(
        0.3, "of speed", "RMS of body velocities minus differences of positions and quaternions"
    ),
    "kinematics.bodies": Measure(
        2e-3, "m", "largest distance of bodies from the robot's links at the joint positions"
    ),
    "dynamics.torque": Measure(
        1e-3, "of limit", "largest excess of torques by inverse dynamics over their limits"
    ),
    "dynamics.stored_torque": Measure(
        np.inf, "of limit", "largest difference of stored torques from those of inverse dynamics"
    ),
    "dynamics.balance": Measure(
        np.inf, "of weight", "largest force that neither contacts nor the links' motion account for"
    ),
    "power.peak": Measure(np.inf, "W", "largest sum over joints of |torque x speed|"),
    "power.mean": Measure(np.inf, "W", "mean of the same"),
}


def measure_motion(
    motion: TrackedMotion, limits: Mapping[str, float], robot: RobotFile | None = None
) -> tuple[Check, ...]:
    """Return all measures of a motion.

    Args:
        motion: The motion; contacts and terrain that its file lacks are filled in before.
        limits: Limits by the names of measures, in place of those of `MEASURES`.
        robot: The robot's file, for kinematics and dynamics; None leaves these unjudged.

    Raises:
        UsageError: A limit has no such measure, or the links of the robot weigh nothing.
    """
    unknown = [name for name in limits if name not in MEASURES]
    if unknown:
        raise UsageError(f"--limit {unknown[0]}: expected one of {', '.join(MEASURES)}")
    judge = _Judge(motion, limits)
    return (
        *_measure_contacts(motion, judge),
        *_measure_joints(motion, judge),
        *_measure_velocities(motion, judge),
        _measure_kinematics(motion, judge, robot),
        *_measure_dynamics(motion, judge, robot),
        *_measure_power(motion, judge),
    )


@dataclass(frozen=True)
class _Judge:
    """Turns the values of measures into checks."""

    motion: TrackedMotion
    limits: Mapping[str, float]

    def skip(self, name: str, reason: str) -> Check:
        """Return a measure for which the file has no data."""
        measure = MEASURES[name]
        return Check(
            name=name,
            residual=0.0,
            limit=self.limits.get(name, measure.limit) if np.isfinite(measure.limit) else 0.0,
            unit=measure.unit,
            passed=True,
            margin=reason,
            worst_at="",
            judged=False,
        )

    def judge_value(self, name: str, value: float, worst_at: str = "", margin: str = "") -> Check:
        """Return a measure of a value; NaN does not pass."""
        measure = MEASURES[name]
        limit = self.limits.get(name, measure.limit)
        is_judged = bool(np.isfinite(limit))
        return Check(
            name=name,
            residual=value,
            limit=limit if is_judged else 0.0,
            unit=measure.unit,
            passed=bool(value <= limit) if is_judged else True,
            margin=margin if is_judged else f"{value:.3g} {measure.unit}",
            worst_at=worst_at,
            judged=is_judged,
        )

    def judge_worst(
        self, name: str, values: Array, describe: Callable[[int, int], str], offset: int = 0
    ) -> Check:
        """Return a measure of its largest value (T, ...) at a sample; zero for no values.

        offset: Sample of the motion at which the values begin.
        """
        if not values.size:
            return self.judge_value(name, 0.0)
        flat = values.reshape(len(values), -1)
        sample, column = (int(i) for i in np.unravel_index(int(flat.argmax()), flat.shape))
        value = float(max(flat[sample, column], 0.0))
        place = f"t = {self.motion.time[sample + offset]:.2f} s, {describe(sample, column)}"
        return self.judge_value(name, value, place if value > 0 else "")


def _measure_contacts(motion: TrackedMotion, judge: _Judge) -> Iterator[Check]:
    """Yield slip, penetration, contact distance and friction."""
    contacts = motion.contacts
    names = ("contact.slip", "contact.penetration", "contact.distance")
    if contacts is None:
        reason = "no contacts in the file; --feet names the bodies that may touch"
        yield from (judge.skip(name, reason) for name in (*names, "contact.friction"))
        return

    def describe(_: int, column: int) -> str:
        return contacts.names[column]

    points = compute_contact_points(motion, contacts)
    touching = np.broadcast_to(contacts.is_touching[..., None], points.shape[:-1])
    if motion.terrain is None:
        yield judge.judge_worst("contact.slip", measure_slip(points, touching), describe)
        reason = "no terrain in the file; --terrain names a mesh"
        yield from (judge.skip(name, reason) for name in names[1:])
    else:
        distances = measure_distances(points.reshape(-1, 3), motion.terrain)
        distances = distances.reshape(points.shape[:-1]) - contacts.radius[:, None]
        slip = measure_slip(points, touching & (distances <= NEAR))
        yield judge.judge_worst("contact.slip", slip, describe)
        distance = distances.min(axis=-1)
        yield judge.judge_worst("contact.penetration", -distance, describe)
        floating = np.where(contacts.is_touching, np.minimum(distance, FAR), 0.0)
        yield judge.judge_worst("contact.distance", floating, describe)
    yield _measure_friction(motion, contacts, judge)


def measure_slip(points: Array, is_touching: BoolArray) -> Array:
    """Return how far contacts (T, C) are from where they were when they began [m].

    Args:
        points: (T, C, K, 3) points of each contact, world frame [m].
        is_touching: (T, C, K) bool; points that do not touch do not count.
    """
    slip = np.zeros(is_touching.shape)
    for contact, point in np.ndindex(*is_touching.shape[1:]):
        for first, after in spans_of(is_touching[:, contact, point]):
            displacement = points[first:after, contact, point] - points[first, contact, point]
            slip[first:after, contact, point] = np.linalg.norm(displacement, axis=-1)
    return np.asarray(slip.max(axis=-1))


def _measure_friction(motion: TrackedMotion, contacts: ContactSamples, judge: _Judge) -> Check:
    """Return the excess of tangential forces over friction, and of pulling forces."""
    name = "contact.friction"
    if contacts.force is None:
        return judge.skip(name, "no contact_force in the file")
    if contacts.is_gripping:
        return judge.skip(name, "grippers hold by more than friction")
    if motion.surfaces is None:
        return judge.skip(name, "no surface_friction in the file")
    touching = contacts.is_touching & (contacts.surface >= 0)
    friction = motion.surfaces.friction[np.maximum(contacts.surface, 0)]
    normal_force = (contacts.force * contacts.normal).sum(axis=-1)
    tangential = np.linalg.norm(contacts.force - normal_force[..., None] * contacts.normal, axis=-1)
    largest = max(float(np.linalg.norm(contacts.force, axis=-1).max()), 1e-300)
    excess = np.where(touching, np.maximum(tangential - friction * normal_force, -normal_force), 0)
    excess = np.where(np.linalg.norm(contacts.force, axis=-1) > _MIN_FORCE * largest, excess, 0)
    return judge.judge_worst(
        name,
        excess / largest,
        lambda t, c: (
            f"{contacts.names[c]}: {tangential[t, c]:.3g} N tangential, "
            f"{normal_force[t, c]:.3g} N normal, mu {friction[t, c]:.3g}"
        ),
    )


def _measure_joints(motion: TrackedMotion, judge: _Judge) -> Iterator[Check]:
    """Yield excess of joint positions, speeds and torques over their limits."""
    bounds = motion.bounds
    if bounds is None:
        reason = "no joint limits in the file; --robot names a URDF"
        yield from (
            judge.skip(name, reason) for name in ("joint.position", "joint.speed", "joint.torque")
        )
        return

    def describe(_: int, column: int) -> str:
        return motion.joint_names[column]

    position = motion.joint_position
    yield judge.judge_worst(
        "joint.position", np.maximum(bounds.lower - position, position - bounds.upper), describe
    )
    speed = np.abs(motion.joint_velocity) / bounds.speed - 1
    yield judge.judge_worst("joint.speed", speed, describe)
    if motion.joint_torque is None:
        yield judge.skip("joint.torque", "no joint_torque in the file")
        return
    torque = np.nan_to_num(np.abs(motion.joint_torque)) / bounds.torque - 1
    yield judge.judge_worst("joint.torque", torque, describe)


def _measure_velocities(motion: TrackedMotion, judge: _Judge) -> Iterator[Check]:
    """Yield deviations of stored velocities from central differences of stored positions.

    A quaternion of another order, or velocities in the frames of the links, show here.
    """
    if len(motion.time) < MIN_SAMPLES:
        yield from (
            judge.skip(name, f"fewer than {MIN_SAMPLES} samples")
            for name in ("velocity.joints", "velocity.bodies")
        )
        return
    span = 2 / motion.fps
    joint = (motion.joint_position[2:] - motion.joint_position[:-2]) / span
    yield judge.judge_value(
        "velocity.joints", _compare_velocities(motion.joint_velocity[1:-1], joint)
    )
    linear = (motion.body_position[2:] - motion.body_position[:-2]) / span
    rotation = motion.body_rotation
    turn = rotation[2:] @ np.swapaxes(rotation[:-2], -1, -2)
    angular = Rotation.from_matrix(turn.reshape(-1, 3, 3)).as_rotvec().reshape(linear.shape) / span
    deviations = (
        _compare_velocities(motion.body_velocity[1:-1], linear),
        _compare_velocities(motion.body_angular_velocity[1:-1], angular),
    )
    kind = ("linear", "angular")[int(np.argmax(deviations))]
    yield judge.judge_value("velocity.bodies", max(deviations), worst_at=f"{kind} velocities")


def _compare_velocities(stored: Array, differences: Array) -> float:
    """Return the RMS of stored velocities minus differences, by that of the larger ones."""
    if not stored.size:
        return 0.0
    size = max(float(np.sqrt((v**2).mean())) for v in (stored, differences))
    return float(np.sqrt(((stored - differences) ** 2).mean())) / size if size > 1e-9 else 0.0


def _find_missing_names(motion: TrackedMotion, robot: LinkTree, links: Sequence[str]) -> str:
    """Return the first joint, or the first of some links, that a motion lacks; "" for none."""
    joints = [f"joint {name}" for name in robot.joint_names if name not in motion.joint_names]
    bodies = [f"body {name}" for name in links if name not in motion.body_names]
    return next(iter(joints + bodies), "")


def _measure_kinematics(motion: TrackedMotion, judge: _Judge, file: RobotFile | None) -> Check:
    """Return how far bodies are from the robot's links at the joint positions."""
    name = "kinematics.bodies"
    if file is None:
        return judge.skip(name, "--robot names a URDF")
    robot = file.links
    root = robot.link_names[0]
    if missing := _find_missing_names(motion, robot, [root]):
        return judge.skip(name, f"the file has no {missing} of the robot")
    columns = [motion.joint_names.index(joint) for joint in robot.joint_names]
    body = motion.body_names.index(root)
    poses = robot.compute_poses(
        motion.body_position[:, body],
        motion.body_rotation[:, body],
        motion.joint_position[:, columns],
    )
    shared = [link for link in robot.link_names if link in motion.body_names]
    places = [motion.body_names.index(link) for link in shared]
    links = [robot.link_names.index(link) for link in shared]
    distance = np.linalg.norm(motion.body_position[:, places] - poses.position[:, links], axis=-1)
    return judge.judge_worst(name, distance, lambda _, column: shared[column])


def _measure_dynamics(
    motion: TrackedMotion, judge: _Judge, file: RobotFile | None
) -> Iterator[Check]:
    """Yield torques by inverse dynamics, their difference from stored ones, and the balance."""
    names = ("dynamics.torque", "dynamics.stored_torque", "dynamics.balance")
    reason = find_dynamics_obstacle(motion, file)
    if reason or file is None:
        yield from (judge.skip(name, reason) for name in names)
        return
    dynamics = compute_dynamics(motion, file.urdf, file.links)
    columns = [motion.joint_names.index(name) for name in file.links.joint_names]
    limit = np.full(len(columns), np.inf)
    if motion.bounds is not None:
        limit = motion.bounds.torque[columns]

    def describe(_: int, column: int) -> str:
        return file.links.joint_names[column]

    yield judge.judge_worst(names[0], np.abs(dynamics.torque) / limit - 1, describe, offset=1)
    if motion.joint_torque is None:
        yield judge.skip(names[1], "no joint_torque in the file")
    else:
        stored = motion.joint_torque[1:-1, columns]
        difference = np.nan_to_num(np.abs(stored - dynamics.torque)) / limit
        yield judge.judge_worst(names[1], difference, describe, offset=1)
    unbalanced = np.linalg.norm(dynamics.unbalanced_force, axis=1) / dynamics.weight
    yield judge.judge_worst(names[2], unbalanced, lambda *_: "sum of all forces", offset=1)


def find_dynamics_obstacle(motion: TrackedMotion, file: RobotFile | None) -> str:
    """Return why a motion has no inverse dynamics; "" if it has."""
    if file is None:
        return "--robot names a URDF"
    if motion.contacts is None or motion.contacts.force is None:
        return "no contact_force in the file"
    has_soles = motion.contacts.offset.shape[1] > 1
    if motion.contacts.is_gripping or (has_soles and motion.contacts.moment is None):
        return "soles and grippers carry moments, which the file lacks"
    if len(motion.time) < MIN_SAMPLES:
        return f"fewer than {MIN_SAMPLES} samples"
    missing = _find_missing_names(motion, file.links, file.links.link_names)
    return f"the file has no {missing} of the robot" if missing else ""


def _measure_power(motion: TrackedMotion, judge: _Judge) -> Iterator[Check]:
    """Yield peak and mean of the mechanical power of all joints."""
    if motion.joint_torque is None:
        reason = "no joint_torque in the file"
        yield from (judge.skip(name, reason) for name in ("power.peak", "power.mean"))
        return
    power = np.abs(np.nan_to_num(motion.joint_torque) * motion.joint_velocity).sum(axis=1)
    sample = int(power.argmax())
    place = f"t = {motion.time[sample]:.2f} s"
    yield judge.judge_value("power.peak", float(power[sample]), place)
    yield judge.judge_value("power.mean", float(power.mean()))
