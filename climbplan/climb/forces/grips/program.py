"""One instant's force problem as matrices on the forces of palms and fingers."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from climbplan.arrays import Array, IntArray
from climbplan.climb.forces.cones import ConicProgram
from climbplan.climb.forces.grips.statement import GripStatement
from climbplan.mechanics.friction import contact_frame, pyramid_rows, regular_corners

NUM_PARTS = 3  # palm and two fingers
LIMB_SIZE = 3 * NUM_PARTS  # unknowns of a limb in contact


@dataclass(frozen=True)
class GripInstant:
    """One instant with n limbs in contact; forces in units of the load, x their 9 n unknowns."""

    limb: IntArray  # (n,)
    wrench_maps: Array  # (n, 7, 9) force, moment and gripping force of each limb
    grasp: Array  # (6, 9 n) moments divided by the lever arm scale
    load: Array  # (6,) likewise
    torque: Array  # (6 n, 9 n) joints and wrists by limb: torque / limit
    link_torque_ratio: Array  # (6 n,) likewise, of the links' own weight
    grip: Array  # (n, 9 n) gripping force
    max_grip: float
    axes: Array  # (n, 3, 3, 3) by part: rows normal, tangent, bitangent
    mu: Array  # (n,)
    spines: Array  # (n, 3) by part
    safety_friction: float
    pull_components: (
        Array  # (n, 3, 3) normal and tangential share of each part in the further pull it holds
    )
    max_s: float
    deflection_per_force: Array  # (3 n, 9 n) joint angles less commands [rad]
    command_margin: Array  # (3 n, 2) for them above and below

    @property
    def num_contacts(self) -> int:
        """Return the number n of limbs in contact."""
        return len(self.limb)

    @property
    def size(self) -> int:
        """Return the number 9 n of unknowns."""
        return LIMB_SIZE * self.num_contacts

    @property
    def can_grip(self) -> bool:
        """Return whether fingers grip at all."""
        return self.max_grip > 0

    def build_part_rows(self, i: int, part_index: int) -> Array:
        """Return the normal and tangential components (3, 9 n) of a part's force."""
        rows = np.zeros((3, self.size))
        start = LIMB_SIZE * i + 3 * part_index
        rows[:, start : start + 3] = self.axes[i, part_index]
        return rows


def build_grip_instant(statement: GripStatement, k: int) -> GripInstant:
    """Return the matrices of instant k."""
    limb = np.flatnonzero(statement.contact[k])
    n, unit = len(limb), statement.unit
    scale = np.array([1.0] * 3 + [1 / statement.length] * 3)
    to_wrench = np.array([statement.build_wrench_map(k, int(i)) for i in limb]).reshape(
        n, 7, LIMB_SIZE
    )
    grasp = np.zeros((6, n, LIMB_SIZE))
    torque, bending = np.zeros((n, 6, n, LIMB_SIZE)), np.zeros((n, 3, n, LIMB_SIZE))
    grip = np.zeros((n, n, LIMB_SIZE))
    links = np.zeros((n, 6))
    links[:, :3] = (statement.link_torques[k] / statement.max_torque)[limb]
    for row, i in enumerate(limb):
        force, moment = to_wrench[row, :3], to_wrench[row, 3:6]
        grasp[:3, row] = force
        grasp[3:, row] = moment + np.cross(statement.arms[k, i], force, axisb=0, axisc=0)
        joints = statement.torque[k, i] @ to_wrench[row, :6]
        wrist = statement.wrist[k, i] @ to_wrench[row, :6]
        torque[row, :3, row] = joints / statement.max_torque[i][:, None]
        torque[row, 3:, row] = wrist / statement.gripper.wrist_max_torque[:, None]
        bending[row, :, row] = joints * statement.softness[i][:, None]
        grip[row, row] = to_wrench[row, 6]
    size = n * LIMB_SIZE
    axes = contact_frame(statement.cones.normal[k, limb]).axes
    margins = np.stack([statement.margin_below[k, limb], statement.margin_above[k, limb]], axis=-1)
    return GripInstant(
        limb=limb,
        wrench_maps=to_wrench,
        grasp=grasp.reshape(6, size) * scale[:, None],
        load=statement.load[k] * scale / unit,
        torque=torque.reshape(6 * n, size) * unit,
        link_torque_ratio=links.ravel(),
        grip=grip.reshape(n, size),
        max_grip=statement.gripper.max_force / unit,
        axes=axes,
        mu=statement.cones.mu[k, limb],
        spines=statement.cones.spines[k, limb] / unit,
        safety_friction=float(statement.safety_friction[k]),
        pull_components=_compute_pull_components(
            axes, statement.normal[k, limb], statement.pull[k] / unit
        ),
        max_s=statement.max_s,
        deflection_per_force=bending.reshape(3 * n, size) * unit,
        command_margin=margins.reshape(3 * n, 2),
    )


def _compute_pull_components(axes: Array, normal: Array, pull: float) -> Array:
    """Return (n, 3, 3) what a pull along normals (n, 3) takes from parts: half of it from each
    finger.
    """
    components = np.einsum("npij,nj->npi", axes, normal) * pull / 2
    components[:, 0] = 0.0
    return components


def build_open_finger_rows(instant: GripInstant) -> Array:
    """Return rows (6 n, 9 n) of all finger forces, which are zero where grippers stay open."""
    rows = np.eye(instant.size).reshape(instant.num_contacts, NUM_PARTS, 3, instant.size)
    return rows[:, 1:].reshape(-1, instant.size)


@dataclass(frozen=True)
class EpigraphRows:
    """Rows A x - s_coefficients s <= upper."""

    A: Array  # (m, 9 n)
    s_coefficients: Array  # (m,)
    upper: Array  # (m,)


def build_linear_rows(instant: GripInstant) -> EpigraphRows:
    """Return the rows of torque, gripping force, pressure and commands, without friction."""
    n = instant.num_contacts
    pressure = [
        -instant.build_part_rows(i, part_index)[0]
        for i in range(n)
        for part_index in range(NUM_PARTS)
    ]
    row_blocks = [instant.torque, -instant.torque, instant.grip, -instant.grip, np.array(pressure)]
    by_s = [np.ones(12 * n), np.full(n, instant.max_grip), np.zeros(n + NUM_PARTS * n)]
    upper = [
        -instant.link_torque_ratio,
        instant.link_torque_ratio,
        np.zeros(2 * n),
        -np.maximum(instant.pull_components[..., 0], 0.0).ravel(),
    ]
    row_blocks += [instant.deflection_per_force, -instant.deflection_per_force]
    by_s.append(np.zeros(6 * n))
    upper += [instant.command_margin[:, 0], instant.command_margin[:, 1]]
    return EpigraphRows(np.concatenate(row_blocks), np.concatenate(by_s), np.concatenate(upper))


def map_linear_blocks(contacts: int) -> dict[str, slice]:
    """Return the slice of linear rows of each check; wrist torques are among those of joints."""
    counts = {
        "torque.limit": 12,
        "grip.force": 2,
        "grip.unilateral": NUM_PARTS,
        "kinematics.joint_bounds": 6,
    }
    ends = contacts * np.cumsum(list(counts.values()))
    starts = [0, *ends[:-1]]
    return {name: slice(a, b) for name, a, b in zip(counts, starts, ends, strict=True)}


def build_friction_rows(instant: GripInstant, facets: int) -> EpigraphRows:
    """Return pyramids inscribed in the friction cones, which spines widen.

    Fingers with an additional pull have a second pyramid, without the safety factor.
    """
    corners = regular_corners(facets)
    half = np.pi / facets
    A, upper = [], []
    for i in range(instant.num_contacts):
        rows = pyramid_rows(np.array(instant.mu[i] / instant.safety_friction), corners)
        for part_index in range(NUM_PARTS):
            A.append(rows @ instant.build_part_rows(i, part_index))
            spine_force = instant.spines[i, part_index] / instant.safety_friction * np.cos(half)
            upper.append(np.full(facets, spine_force))
            if instant.pull_components[i, part_index].any():
                full_cone_rows = pyramid_rows(np.array(instant.mu[i]), corners)
                A.append(full_cone_rows @ instant.build_part_rows(i, part_index))
                spine_force = instant.spines[i, part_index] * np.cos(half)
                upper.append(spine_force + full_cone_rows @ instant.pull_components[i, part_index])
    stacked = np.concatenate(A)
    return EpigraphRows(stacked, np.zeros(len(stacked)), np.concatenate(upper))


def build_conic_program(
    instant: GripInstant, extra: int = 0, fixed_s: bool = False, friction: float = 1.0
) -> ConicProgram:
    """Return the exact problem on x, then s, then `extra` variables with zero columns.

    Blocks have the names of the checks that judge them, cones with limb and part: `grip.shear.1.0`.

    Args:
        instant: The instant.
        extra: Number of further variables.
        fixed_s: Whether s is fixed at its upper bound.
        friction: Factor on friction and spines.
    """
    program = ConicProgram(instant.size + 1 + extra)
    grasp_rows = np.zeros((6, program.size))
    grasp_rows[:, : instant.size] = instant.grasp
    program.add_equality("force.equilibrium", grasp_rows, -instant.load)
    rows = build_linear_rows(instant)
    A = np.zeros((len(rows.A), program.size))
    A[:, : instant.size] = rows.A
    A[:, instant.size] = -rows.s_coefficients
    for name, block_rows in map_linear_blocks(instant.num_contacts).items():
        program.add_inequality(name, A[block_rows], rows.upper[block_rows])
    bounds = np.zeros((2, program.size))
    bounds[0, instant.size], bounds[1, instant.size] = 1.0, -1.0
    lower_s = -instant.max_s if fixed_s else 0.0
    program.add_inequality("s", bounds, np.array([instant.max_s, lower_s]))
    if not instant.can_grip:
        finger_rows = np.zeros((2 * LIMB_SIZE // NUM_PARTS * instant.num_contacts, program.size))
        finger_rows[:, : instant.size] = build_open_finger_rows(instant)
        program.add_equality("grip.open", finger_rows, np.zeros(len(finger_rows)))
    for i in range(instant.num_contacts):
        for part_index in range(NUM_PARTS):
            cone = np.zeros((3, program.size))
            cone[:, : instant.size] = -instant.build_part_rows(i, part_index)
            friction_factor = friction / instant.safety_friction
            cone[0] *= instant.mu[i] * friction_factor
            b = np.array([instant.spines[i, part_index] * friction_factor, 0.0, 0.0])
            program.add_second_order_cone(f"grip.shear.{i}.{part_index}", cone, b)
            if instant.pull_components[i, part_index].any():
                pull_components = instant.pull_components[i, part_index]
                cone = cone.copy()
                cone[0] *= instant.safety_friction
                b = np.array(
                    [instant.spines[i, part_index], -pull_components[1], -pull_components[2]]
                )
                b[0] -= instant.mu[i] * pull_components[0]
                b[0] *= friction
                program.add_second_order_cone(f"grip.pull_out.{i}.{part_index}", cone, b)
    return program
