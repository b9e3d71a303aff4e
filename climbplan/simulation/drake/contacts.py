"""What touches what: toes, their forces and slips, and every other link."""

from __future__ import annotations

from dataclasses import dataclass
from math import hypot
from typing import Any

import numpy as np

from climbplan.arrays import Array
from climbplan.simulation.drake.exported import ExportedMotion
from climbplan.simulation.drake.plant import LAYERS, Plant

NEAR_TOE = 0.03  # [m] about the sphere of a toe, within which its link's contacts are the toe's
SLIP = 5e-3  # [m] that a standing toe may slide
LET_GO = 0.25  # [s] before a toe is lifted, in which it may
LOST = 0.5  # [s] for which a toe that should press does not touch
PRESSES = 0.1  # [N] from which a toe touches


@dataclass
class LinkContact:
    """A link that touches terrain with another part than its toe, or another link."""

    link: str
    other: str
    first_time: float  # [s]
    seconds: float = 0.0
    max_force: float = 0.0  # [N]
    max_force_time: float = 0.0  # [s]
    max_depth: float = 0.0  # [m]


@dataclass(frozen=True)
class Slip:
    """A standing toe that slid."""

    limb: str
    time: float  # [s] when it had slid by `SLIP`
    distance: float  # [m] in all of that stance


@dataclass(frozen=True)
class LostContact:
    """A toe that should press and did not touch."""

    limb: str
    time: float  # [s] from which on
    duration: float  # [s]


class ContactLog:
    """Contacts of a run, step by step."""

    def __init__(self, plant: Plant, motion: ExportedMotion) -> None:
        self._plant, self._motion = plant, motion
        count = len(motion.contacts)
        self._world = int(plant.plant.world_body().index())
        self._limb_of = {b: c for c, group in enumerate(plant.toe_bodies) for b in group}
        self.force = np.zeros((count, 3))  # on the robot at toes, at the last step [N]
        self.links: dict[tuple[str, str], LinkContact] = {}
        self.slips: list[Slip] = []
        self.lost: list[LostContact] = []
        self._slid = np.zeros((count, 3))
        self._max_slid, self._slid_time = np.zeros(count), np.full(count, np.nan)
        self._away = np.zeros(count)
        self._lifts = _compute_lift_times(motion)

    def update(self, context: Any, time: float, seconds: float) -> None:
        """Read the contacts of the last step, which count for so many seconds."""
        motion = self._motion
        self.force[:] = 0.0
        results = self._plant.plant.get_contact_results_output_port().Eval(context)
        touching = motion.touching[motion.index_at(time)]
        toes = [
            toe.EvalPoseInWorld(context).multiply(np.array(contact.offset))
            for toe, contact in zip(self._plant.toes, motion.contacts, strict=True)
        ]
        moved_limbs: set[int] = set()
        pairs: dict[tuple[str, str], tuple[Array, float]] = {}
        for number in range(results.num_point_pair_contacts()):
            info = results.point_pair_contact_info(number)
            first, second = int(info.bodyA_index()), int(info.bodyB_index())
            pair = info.point_pair()
            force = info.contact_force()  # on the second
            if self._world in (first, second):
                if not {pair.id_A, pair.id_B} & self._plant.first_layer:
                    continue  # every layer of the terrain bears the same
                force = LAYERS * force
                body, sign = (second, 1.0) if first == self._world else (first, -1.0)
                limb = self._limb_of.get(body)
                if limb is not None and self._is_near_toe(limb, toes[limb], info):
                    self.force[limb] += sign * force
                    if touching[limb] and limb not in moved_limbs:
                        moved_limbs.add(limb)
                        self._slide(context, limb, info, body, seconds)
                    continue
            names = self._name(second, pair.id_B), self._name(first, pair.id_A)
            if second == self._world:
                names, force = (names[1], names[0]), -force
            total, depth = pairs.get(names, (np.zeros(3), 0.0))
            pairs[names] = total + force, max(depth, float(pair.depth))
        for (link, touched), (total, depth) in pairs.items():
            self._touch(link, touched, total, depth, time, seconds)
        self._judge_stances(time, seconds, touching)

    def finish(self, time: float) -> None:
        """Close the stances that last to the end of the run."""
        for limb in range(len(self._away)):
            self._end_stance(limb, time)

    def _is_near_toe(self, limb: int, toe: Array, info: Any) -> bool:
        away = (info.contact_point() - toe).tolist()
        return hypot(*away) < self._motion.contacts[limb].radius + NEAR_TOE

    def _slide(self, context: Any, limb: int, info: Any, body: int, seconds: float) -> None:
        """Add how far the body's point that touches has moved along the surface."""
        index = info.bodyB_index() if int(info.bodyB_index()) == body else info.bodyA_index()
        moving = self._plant.plant.get_body(index)
        velocity = moving.EvalSpatialVelocityInWorld(context)
        arm = info.contact_point() - moving.EvalPoseInWorld(context).translation()
        turning = _compute_cross(velocity.rotational().tolist(), arm.tolist())
        point_velocity = velocity.translational() + turning
        normal = info.point_pair().nhat_BA_W
        point_velocity -= (point_velocity @ normal) * normal
        self._slid[limb] += seconds * point_velocity

    def _touch(
        self, link: str, touched: str, force: Array, depth: float, time: float, seconds: float
    ) -> None:
        link_contact = self.links.setdefault((link, touched), LinkContact(link, touched, time))
        link_contact.seconds += seconds
        link_contact.max_depth = max(link_contact.max_depth, depth)
        size = float(np.linalg.norm(force))
        if size > link_contact.max_force:
            link_contact.max_force, link_contact.max_force_time = size, time

    def _name(self, body: int, geometry: Any) -> str:
        if body == self._world:
            return self._plant.terrain[geometry]
        index = type(self._plant.plant.world_body().index())(body)
        return str(self._plant.plant.get_body(index).name())

    def _judge_stances(self, time: float, seconds: float, touching: Array) -> None:
        presses = np.linalg.norm(self.force, axis=1) > PRESSES
        slid = np.linalg.norm(self._slid, axis=1)
        for limb in range(len(slid)):
            letting_go = time > self._lifts[limb][self._motion.index_at(time)] - LET_GO
            if not touching[limb]:
                self._end_stance(limb, time)
                continue
            if not letting_go:
                self._max_slid[limb] = max(self._max_slid[limb], slid[limb])
                if slid[limb] > SLIP and np.isnan(self._slid_time[limb]):
                    self._slid_time[limb] = time
            if presses[limb]:
                self._end_loss(limb, time)
            elif not letting_go:
                self._away[limb] += seconds

    def _end_stance(self, limb: int, time: float) -> None:
        name = self._motion.contacts[limb].name
        if not np.isnan(self._slid_time[limb]):
            self.slips.append(Slip(name, float(self._slid_time[limb]), float(self._max_slid[limb])))
        self._slid[limb], self._max_slid[limb], self._slid_time[limb] = 0.0, 0.0, np.nan
        self._end_loss(limb, time)

    def _end_loss(self, limb: int, time: float) -> None:
        if self._away[limb] > LOST:
            duration = float(self._away[limb])
            name = self._motion.contacts[limb].name
            self.lost.append(LostContact(name, time - duration, duration))
        self._away[limb] = 0.0


def _compute_cross(first: list[float], second: list[float]) -> Array:
    """Return the cross product of two vectors, without NumPy's overhead for many."""
    (a, b, c), (x, y, z) = first, second
    return np.array([b * z - c * y, c * x - a * z, a * y - b * x])


def _compute_lift_times(motion: ExportedMotion) -> Array:
    """Return (C, T) time at which a toe is next lifted [s]; infinite if never."""
    count = len(motion.time)
    out = np.full((len(motion.contacts), count), np.inf)
    for limb, touching in enumerate(motion.touching.T):
        following = np.inf
        for sample in range(count - 1, -1, -1):
            if not touching[sample]:
                following = motion.time[sample]
            out[limb, sample] = following
    return out
