"""Forces of single limbs: those that are nearly straight give way at the toe."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.optimize import minimize

from climbplan.arrays import Array
from climbplan.climb.simulation.implicit_dynamics import memory_rows as rows
from climbplan.climb.simulation.implicit_dynamics.compiling import compiled
from climbplan.climb.simulation.implicit_dynamics.initial_state import create_memory
from climbplan.climb.simulation.implicit_dynamics.limb_equilibrium import _solve_limb
from climbplan.climb.simulation.implicit_dynamics.limb_kinematics import (
    MAX_TOE_COMPLIANCE,
    _compute_jacobian_volume,
    _compute_kinematics,
    _compute_toe_compliance,
)
from climbplan.climb.simulation.implicit_dynamics.state import JointSprings, ScratchMemory

STIFF, COMMAND = 50.0, np.array([0.1, 0.2, -0.1])  # [N m/rad], [rad]


@compiled
def chain(zero: Array, angles: Array, columns: Array, axes: Array, out: Array) -> None:
    """`_chain`."""
    _compute_kinematics(zero, angles, columns, axes, out)


@compiled
def softness(zero: Array, angles: Array, work: ScratchMemory) -> float:
    """`_softness`."""
    _compute_kinematics(zero, angles, work.jacobian, work.joint_axes, work.vectors[rows.TOE])
    return _compute_toe_compliance(
        zero, len(work.jacobian), _compute_jacobian_volume(work.jacobian)
    )


@compiled
def hold(
    zero: Array,
    place: Array,
    springs: JointSprings,
    angles: Array,
    force: Array,
    slope: Array,
    work: ScratchMemory,
) -> bool:
    """`_held` of the first limb."""
    return _solve_limb(zero, 0, place, springs, angles, force, slope, work)


def limb() -> Array:
    """(7, 3) of one that lies stretched along x at zero angles."""
    axes = [[0, 0, 1], [0, -1, 0], [0, -1, 0]]
    return np.array([*axes, [0, 0, 0], [0.05, 0, 0], [0.25, 0, 0], [0.5, 0, 0]], float)


def work(joints: int = 3) -> ScratchMemory:
    return create_memory(joints)


def held(place: Array, soft: float, start: Array) -> tuple[Array, Array]:
    """Force and slope of a toe at a place."""
    springs = JointSprings(
        command=COMMAND[None].copy(), gravity_torque=np.zeros((1, 3)),
        stiffness=np.full((1, 3), STIFF),
        half_backlash=np.zeros((1, 3)), backlash_stiffness=np.full((1, 3), STIFF),
        jacobian_volume=np.zeros(1),
        toe_compliance=np.array([soft]),
    )  # fmt: skip
    force, slope, angles = np.zeros(3), np.zeros((3, 3)), start.copy()
    assert hold(limb(), place, springs, angles, force, slope, work())
    return force, slope


def toe(angles: Array) -> Array:
    out = np.zeros(3)
    chain(limb(), angles, np.zeros((3, 3)), np.zeros((3, 3)), out)
    return out


def test_only_limbs_that_are_nearly_straight_give_way() -> None:
    bent, straight = np.array([0.0, 0.6, -1.2]), np.array([0.0, 0.3, 0.0])
    assert softness(limb(), bent, work()) == 0.0
    assert softness(limb(), straight, work()) == pytest.approx(MAX_TOE_COMPLIANCE)


@pytest.mark.parametrize("knee", [-1.2, -0.6])
def test_a_toe_that_hardly_gives_way_is_held_as_one_that_does_not(knee: float) -> None:
    angles = np.array([0.05, 0.3, knee])
    rigid, firm = held(toe(angles), 0.0, angles)
    given, soft = held(toe(angles), 1e-8, angles)
    np.testing.assert_allclose(given, rigid, rtol=1e-3, atol=1e-2)
    np.testing.assert_allclose(soft, firm, rtol=1e-3, atol=1e-2 * np.abs(firm).max())


@pytest.mark.parametrize("knee", [-0.2, -0.02, 0.0])
def test_a_straight_limb_has_a_force_that_changes_steadily(knee: float) -> None:
    place = toe(np.array([0.08, 0.22, knee])) + np.array([1e-4, 0.0, 2e-4])
    start = np.array([0.08, 0.22, knee])
    force, slope = held(place, MAX_TOE_COMPLIANCE, start)
    step = 1e-7
    for a in range(3):
        moved = place + step * np.eye(3)[a]
        change = (held(moved, MAX_TOE_COMPLIANCE, start)[0] - force) / step
        np.testing.assert_allclose(change, slope[:, a], rtol=2e-2, atol=2e-3 / MAX_TOE_COMPLIANCE)
    assert np.linalg.eigvalsh((slope + slope.T) / 2).max() <= 1.0001 / MAX_TOE_COMPLIANCE


JOINTS = 5


def long_limb() -> Array:
    """(11, 3) of five joints about axes of all directions."""
    axes = [[0, 0, 1], [0, 1, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]]
    joints = [[0, 0, 0], [0.05, 0, 0], [0.1, 0, -0.05], [0.25, 0, 0], [0.4, 0, 0.05]]
    return np.array([*axes, *joints, [0.5, 0, 0]], float)


def long_springs(soft: float = 0.0) -> JointSprings:
    shape = (1, JOINTS)
    command = np.array([[0.1, 0.5, -0.2, -0.9, 0.3]])
    weight = np.array([[0.0, 0.4, 0.1, 0.2, 0.0]])
    return JointSprings(
        command=command, gravity_torque=weight, stiffness=np.full(shape, STIFF),
        half_backlash=np.full(shape, 0.002), backlash_stiffness=np.full(shape, 0.2 * STIFF),
        jacobian_volume=np.zeros(1),
        toe_compliance=np.array([soft]),
    )  # fmt: skip


def held_long(place: Array, soft: float = 0.0) -> tuple[Array, Array, Array]:
    """Force, slope and angles of the long limb with its toe at a place."""
    springs = long_springs(soft)
    angles, force, slope = springs.command[0].copy(), np.zeros(3), np.zeros((3, 3))
    assert hold(long_limb(), place, springs, angles, force, slope, work(JOINTS))
    return force, slope, angles


def energy(angles: Array) -> float:
    """Of the joints' springs, play in them, and of the links' weight [J]."""
    springs = long_springs()
    bend = np.abs(angles - springs.command[0])
    beyond = np.maximum(bend - 0.002, 0.0)
    most = np.minimum(bend, 0.002)
    loose = 0.2 * STIFF
    stored = loose * most**2 / 2 + loose * 0.002 * beyond + STIFF * beyond**2 / 2
    return float(stored.sum() - springs.gravity_torque[0] @ (angles - springs.command[0]))


def long_toe(angles: Array) -> Array:
    out = np.zeros(3)
    chain(long_limb(), angles, np.zeros((JOINTS, 3)), np.zeros((JOINTS, 3)), out)
    return out


@pytest.mark.parametrize("off", [[0.01, 0.0, -0.02], [-0.03, 0.02, 0.01], [0.0, 0.0, 0.0]])
def test_a_limb_of_five_joints_bends_where_its_springs_hold_least(off: list[float]) -> None:
    place = long_toe(long_springs().command[0]) + off
    _, _, angles = held_long(place)
    np.testing.assert_allclose(long_toe(angles), place, atol=1e-8)
    found = minimize(
        energy, long_springs().command[0], method="SLSQP", options={"ftol": 1e-12, "maxiter": 500},
        constraints={"type": "eq", "fun": lambda x: long_toe(x) - place},
    )  # fmt: skip
    assert energy(angles) <= found.fun + 1e-7
    np.testing.assert_allclose(angles, found.x, atol=2e-3)


@pytest.mark.parametrize("soft", [0.0, MAX_TOE_COMPLIANCE])
def test_the_force_on_five_joints_is_the_slope_of_their_energy(soft: float) -> None:
    place = long_toe(long_springs().command[0]) + np.array([0.02, -0.015, 0.02])
    force, slope, angles = held_long(place, soft)
    step = 1e-5
    for a in range(3):
        there, back = place.copy(), place.copy()
        there[a] += step
        back[a] -= step
        ahead, behind = held_long(there, soft), held_long(back, soft)
        turned = (ahead[0] - behind[0]) / (2 * step)
        np.testing.assert_allclose(slope[:, a], turned, rtol=1e-4, atol=1e-3 * np.abs(slope).max())
        if soft == 0.0:
            gained = (energy(ahead[2]) - energy(behind[2])) / (2 * step)
            assert force[a] == pytest.approx(gained, abs=1e-3 * np.abs(force).max())
    np.testing.assert_allclose(long_toe(angles), place - soft * force, atol=1e-8)


def test_a_place_out_of_reach_of_five_joints_is_told() -> None:
    springs = long_springs()
    angles = springs.command[0].copy()
    far = np.array([1.0, 0.0, 0.0])
    assert not hold(long_limb(), far, springs, angles, np.zeros(3), np.zeros((3, 3)), work(JOINTS))
