"""One instant's force problem as matrices on the forces of palms and fingers."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from climbplan.arrays import Array, IntArray
from climbplan.climb.forces.cones import ConicProgram
from climbplan.climb.forces.grips.statement import GripStatement
from climbplan.mechanics.friction import contact_frame, pyramid_rows, regular_corners

PARTS = 3  # palm and two fingers
SIZE = 3 * PARTS  # unknowns of a limb in contact


@dataclass(frozen=True)
class GripInstant:
    """One instant with n limbs in contact; forces in units of the load, x their 9 n unknowns."""

    limb: IntArray  # (n,)
    to_wrench: Array  # (n, 7, 9) force, moment and gripping force of each limb
    grasp: Array  # (6, 9 n) moments divided by the lever arm scale
    load: Array  # (6,) likewise
    torque: Array  # (6 n, 9 n) joints and wrists by limb: torque / limit
    links: Array  # (6 n,) likewise, of the links' own weight
    grip: Array  # (n, 9 n) gripping force
    max_grip: float
    axes: Array  # (n, 3, 3, 3) by part: rows normal, tangent, bitangent
    mu: Array  # (n,)
    spines: Array  # (n, 3) by part
    safety_friction: float
    pulled: Array  # (n, 3, 3) normal and tangential share of each part in the further pull it holds
    largest_s: float
    bending: Array  # (3 n, 9 n) joint angles less commands [rad]
    room: Array  # (3 n, 2) for them above and below

    @property
    def contacts(self) -> int:
        """n."""
        return len(self.limb)

    @property
    def size(self) -> int:
        """9 n."""
        return SIZE * self.contacts

    @property
    def closed(self) -> bool:
        """Whether fingers grip at all."""
        return self.max_grip > 0

    def part_rows(self, i: int, part: int) -> Array:
        """(3, 9 n) normal and tangential components of a part's force."""
        out = np.zeros((3, self.size))
        start = SIZE * i + 3 * part
        out[:, start : start + 3] = self.axes[i, part]
        return out


def grip_instant(statement: GripStatement, k: int) -> GripInstant:
    """The matrices of instant k."""
    limb = np.flatnonzero(statement.contact[k])
    n, unit = len(limb), statement.unit
    scale = np.array([1.0] * 3 + [1 / statement.length] * 3)
    to_wrench = np.array([statement.parts_to_wrench(k, int(i)) for i in limb]).reshape(n, 7, SIZE)
    grasp = np.zeros((6, n, SIZE))
    torque, bending = np.zeros((n, 6, n, SIZE)), np.zeros((n, 3, n, SIZE))
    grip = np.zeros((n, n, SIZE))
    links = np.zeros((n, 6))
    links[:, :3] = (statement.link_torques[k] / statement.max_torque)[limb]
    for place, i in enumerate(limb):
        force, moment = to_wrench[place, :3], to_wrench[place, 3:6]
        grasp[:3, place] = force
        grasp[3:, place] = moment + np.cross(statement.arms[k, i], force, axisb=0, axisc=0)
        joints = statement.torque[k, i] @ to_wrench[place, :6]
        wrist = statement.wrist[k, i] @ to_wrench[place, :6]
        torque[place, :3, place] = joints / statement.max_torque[i][:, None]
        torque[place, 3:, place] = wrist / statement.gripper.wrist_max_torque[:, None]
        bending[place, :, place] = joints * statement.softness[i][:, None]
        grip[place, place] = to_wrench[place, 6]
    size = n * SIZE
    axes = contact_frame(statement.cones.normal[k, limb]).axes
    room = np.stack([statement.room_below[k, limb], statement.room_above[k, limb]], axis=-1)
    return GripInstant(
        limb=limb,
        to_wrench=to_wrench,
        grasp=grasp.reshape(6, size) * scale[:, None],
        load=statement.load[k] * scale / unit,
        torque=torque.reshape(6 * n, size) * unit,
        links=links.ravel(),
        grip=grip.reshape(n, size),
        max_grip=statement.gripper.max_force / unit,
        axes=axes,
        mu=statement.cones.mu[k, limb],
        spines=statement.cones.spines[k, limb] / unit,
        safety_friction=float(statement.safety_friction[k]),
        pulled=_pulled(axes, statement.normal[k, limb], statement.pull[k] / unit),
        largest_s=statement.largest_s,
        bending=bending.reshape(3 * n, size) * unit,
        room=room.reshape(3 * n, 2),
    )


def _pulled(axes: Array, normal: Array, pull: float) -> Array:
    """(n, 3, 3) what a pull along normals (n, 3) takes from parts: an even half of each finger."""
    taken = np.einsum("npij,nj->npi", axes, normal) * pull / 2
    taken[:, 0] = 0.0
    return taken


def open_fingers(instant: GripInstant) -> Array:
    """(6 n, 9 n) rows of all finger forces, which are zero where grippers stay open."""
    rows = np.eye(instant.size).reshape(instant.contacts, PARTS, 3, instant.size)
    return rows[:, 1:].reshape(-1, instant.size)


@dataclass(frozen=True)
class LinearRows:
    """Rows A x - s_column s <= upper."""

    A: Array  # (m, 9 n)
    by_s: Array  # (m,)
    upper: Array  # (m,)


def linear_rows(instant: GripInstant) -> LinearRows:
    """Torque, gripping force, pressure and command rows; friction is apart."""
    n = instant.contacts
    pressure = [-instant.part_rows(i, part)[0] for i in range(n) for part in range(PARTS)]
    A = [instant.torque, -instant.torque, instant.grip, -instant.grip, np.array(pressure)]
    by_s = [np.ones(12 * n), np.full(n, instant.max_grip), np.zeros(n + PARTS * n)]
    upper = [
        -instant.links,
        instant.links,
        np.zeros(2 * n),
        -np.maximum(instant.pulled[..., 0], 0.0).ravel(),
    ]
    A += [instant.bending, -instant.bending]
    by_s.append(np.zeros(6 * n))
    upper += [instant.room[:, 0], instant.room[:, 1]]
    return LinearRows(np.concatenate(A), np.concatenate(by_s), np.concatenate(upper))


def linear_blocks(contacts: int) -> dict[str, slice]:
    """Which of the linear rows each check judges; torques of wrists are among those of joints."""
    counts = {
        "torque.limit": 12,
        "grip.force": 2,
        "grip.press": PARTS,
        "kinematics.joint_bounds": 6,
    }
    ends = contacts * np.cumsum(list(counts.values()))
    starts = [0, *ends[:-1]]
    return {name: slice(a, b) for name, a, b in zip(counts, starts, ends, strict=True)}


def friction_rows(instant: GripInstant, facets: int) -> LinearRows:
    """Pyramids inscribed in the cones, which spines widen; those of fingers pulled further too."""
    corners = regular_corners(facets)
    half = np.pi / facets
    A, upper = [], []
    for i in range(instant.contacts):
        rows = pyramid_rows(np.array(instant.mu[i] / instant.safety_friction), corners)
        for part in range(PARTS):
            A.append(rows @ instant.part_rows(i, part))
            held = instant.spines[i, part] / instant.safety_friction * np.cos(half)
            upper.append(np.full(facets, held))
            if instant.pulled[i, part].any():
                whole = pyramid_rows(np.array(instant.mu[i]), corners)
                A.append(whole @ instant.part_rows(i, part))
                held = instant.spines[i, part] * np.cos(half)
                upper.append(held + whole @ instant.pulled[i, part])
    stacked = np.concatenate(A)
    return LinearRows(stacked, np.zeros(len(stacked)), np.concatenate(upper))


def conic_program(
    instant: GripInstant, extra: int = 0, fixed_s: bool = False, friction: float = 1.0
) -> ConicProgram:
    """The exact problem on x, then s, then `extra` variables that its rows leave alone.

    fixed_s: s is at its upper bound instead; friction: factor on friction and spines. Blocks have
    the names of the checks that judge them, cones with limb and part: `grip.shear.1.0`.
    """
    program = ConicProgram(instant.size + 1 + extra)
    wide = np.zeros((6, program.size))
    wide[:, : instant.size] = instant.grasp
    program.zero("force.equilibrium", wide, -instant.load)
    rows = linear_rows(instant)
    A = np.zeros((len(rows.A), program.size))
    A[:, : instant.size] = rows.A
    A[:, instant.size] = -rows.by_s
    for name, own in linear_blocks(instant.contacts).items():
        program.below(name, A[own], rows.upper[own])
    bounds = np.zeros((2, program.size))
    bounds[0, instant.size], bounds[1, instant.size] = 1.0, -1.0
    least = -instant.largest_s if fixed_s else 0.0
    program.below("s", bounds, np.array([instant.largest_s, least]))
    if not instant.closed:
        opened = np.zeros((2 * SIZE // PARTS * instant.contacts, program.size))
        opened[:, : instant.size] = open_fingers(instant)
        program.zero("grip.open", opened, np.zeros(len(opened)))
    for i in range(instant.contacts):
        for part in range(PARTS):
            cone = np.zeros((3, program.size))
            cone[:, : instant.size] = -instant.part_rows(i, part)
            share = friction / instant.safety_friction
            cone[0] *= instant.mu[i] * share
            b = np.array([instant.spines[i, part] * share, 0.0, 0.0])
            program.cone(f"grip.shear.{i}.{part}", cone, b)
            if instant.pulled[i, part].any():
                taken = instant.pulled[i, part]
                cone = cone.copy()
                cone[0] *= instant.safety_friction
                b = np.array([instant.spines[i, part], -taken[1], -taken[2]])
                b[0] -= instant.mu[i] * taken[0]
                b[0] *= friction
                program.cone(f"grip.pull_out.{i}.{part}", cone, b)
    return program
