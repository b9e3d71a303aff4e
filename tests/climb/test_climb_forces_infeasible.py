"""What the force planner says where no forces are admissible, and whether it is right."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import replace
from typing import Any, get_args

import numpy as np
import pytest

from climbplan.climb.forces.cones import FEASIBLE, ConstraintName, build_instant_cones
from climbplan.climb.forces.conflict import find_irreducible_conflict, list_members, relax_members
from climbplan.climb.forces.planner import plan_forces
from climbplan.climb.forces.solving import solve_forces
from climbplan.climb.forces.statement import build_force_statement, check_forces
from climbplan.climb.gait.gait import plan_instants
from climbplan.climb.plan.climb_plan import Instants
from climbplan.climb.scene.climb_scene import ClimbScene
from climbplan.errors import Unresolved
from climbplan.instances.straight_climb import interpolate_rounds
from climbplan.schema.robots.robot import RobotSpec
from climbplan.verification.check import LIMITS

SceneMaker = Callable[..., ClimbScene]
RobotMaker = Callable[..., RobotSpec]
NUMBER = r"([0-9.]+)"


def refused(scene: ClimbScene, instants: Instants | None = None) -> Unresolved:
    if instants is None:
        instants = plan_instants(scene, interpolate_rounds(scene))
    with pytest.raises(Unresolved) as caught:
        plan_forces(scene, instants)
    return caught.value


def stiff(scene: ClimbScene) -> ClimbScene:
    """The scene with limbs that hardly give way: what restricts forces is not their commands."""
    robot = replace(scene.robot, joint_stiffness=100 * scene.robot.joint_stiffness)
    return replace(scene, robot=robot)


def amount(text: str, pattern: str) -> float:
    found = re.search(pattern.replace("#", NUMBER), text)
    assert found, f"{pattern} not in: {text}"
    return float(found[1])


def holds(scene: ClimbScene, rows: list[int] | None = None) -> bool:
    """Whether all instants (or some) have admissible forces."""
    instants = plan_instants(scene, interpolate_rounds(scene))
    missing = solve_forces(build_force_statement(scene, instants), "daqp", 16).missing
    return not len(missing if rows is None else np.intersect1d(missing, rows))


def test_a_conflict_reads_in_the_robots_terms(demo_climb: SceneMaker) -> None:
    error = refused(demo_climb(**{"terrain.friction": 0.45}))
    first = error.conflicts[0]
    assert first.where == "round 1, RF lifted"
    assert re.fullmatch(r"friction at (\w\w(, | and \d more)?)+", first.constraints[0])
    assert re.fullmatch(
        r"torque of (\w\w (coxa|femur|tibia)(, | and \d more)?)+", first.constraints[1]
    )
    assert "conflict; feasible with mu >= 0." in str(first)
    # The names under which the report judges the same constraints
    assert first.names == ("force.friction", "torque.limit", "kinematics.joint_bounds")
    assert set(first.names) <= set(LIMITS)
    assert f"{first.constraints[0]} [force.friction] and torque of" in str(first)
    assert f"{first.constraints[2]} [kinematics.joint_bounds] conflict" in str(first)
    assert len(error.conflicts) == 5
    count = int(amount(str(error), r"# of 36 instants have no admissible contact forces"))
    assert count > 5
    assert "; the first 5:" in str(error)


def test_every_constraint_has_the_name_of_its_check() -> None:
    assert set(get_args(ConstraintName)) <= set(LIMITS)


# Each remedy: what the message says, and the scene that follows it up to a factor
REMEDIES: dict[str, tuple[str, Callable[[float], dict[str, Any]], float]] = {
    "mu": ("mu >= #", lambda v: {"terrain.friction": v}, 0.98),
    "S_mu": ("S_mu <= #", lambda v: {"force": {"safety_friction": v}}, 1.02),
}


@pytest.mark.parametrize("name", REMEDIES)
@pytest.mark.parametrize("one", [True, False], ids=["one instant", "all instants"])
def test_friction_amounts_are_exact(demo_climb: SceneMaker, name: str, one: bool) -> None:
    base = {"terrain.friction": 0.45}
    error = refused(demo_climb(**base))
    pattern, changes, beyond = REMEDIES[name]
    text = str(error.conflicts[0]) if one else str(error).splitlines()[0]
    value = amount(text, pattern)
    rows = [0] if one else None
    assert holds(demo_climb(**base | changes(value)), rows)
    assert not holds(demo_climb(**base | changes(value * beyond)), rows)


@pytest.mark.parametrize("one", [True, False], ids=["one instant", "all instants"])
def test_torque_and_mass_amounts_are_exact(demo_climb: SceneMaker, one: bool) -> None:
    scene = stiff(demo_climb(**{"terrain.friction": 0.45}))
    error = refused(scene)
    text = str(error.conflicts[0]) if one else str(error).splitlines()[0]
    rows = [0] if one else None
    limit, mass = amount(text, r"torque limit >= # N m"), amount(text, r"; .*mass <= # kg")
    for value, expected in ((limit, True), (0.98 * limit, False)):
        stronger = replace(scene.robot, max_torque=np.full((6, 3), value))
        assert holds(replace(scene, robot=stronger), rows) == expected
    for value, expected in ((mass, True), (1.02 * mass, False)):
        assert holds(replace(scene, robot=replace(scene.robot, mass=value)), rows) == expected


def test_safety_torque_amount_is_exact(demo_climb: SceneMaker) -> None:
    base = {"force": {"safety_torque": 4.0}}
    value = amount(str(refused(demo_climb(**base))).splitlines()[0], "S_tau <= #")
    assert 1 < value < 4
    assert holds(demo_climb(force={"safety_torque": value}))
    assert not holds(demo_climb(force={"safety_torque": 1.02 * value}))


def test_payload_is_the_remedy_where_there_is_one(demo_climb: SceneMaker) -> None:
    def loaded(mass: float) -> ClimbScene:
        return demo_climb(**{"task.payload": {"mass": mass, "offset": (0.0, 0.1, 0.2)}})

    error = refused(loaded(40.0))
    assert "mass <=" not in str(error)
    value = amount(str(error).splitlines()[0], "payload <= # kg")
    assert holds(loaded(value))
    assert not holds(loaded(1.02 * value))


def test_a_counterweight_has_two_ends(demo_climb: SceneMaker) -> None:
    """A wind that only a payload's weight holds down: too little fails as well as too much."""

    def loaded(mass: float) -> ClimbScene:
        wind = {"force": (0.0, 0.0, 650.0)}
        return demo_climb(**{"task.payload": {"mass": mass}, "task.external_wrench": wind})

    text = str(refused(loaded(150.0))).splitlines()[0]
    found = re.search(rf"payload from {NUMBER} to {NUMBER} kg", text)
    assert found, text
    low, high = float(found[1]), float(found[2])
    assert holds(loaded(low))
    assert holds(loaded(high))
    assert not holds(loaded(0.98 * low))
    assert not holds(loaded(1.02 * high))


def test_a_remedy_that_cannot_help_is_not_offered(demo_climb: SceneMaker) -> None:
    """Against a wind that only torque can hold, neither friction nor a lighter robot helps."""
    wind = {"task.external_wrench": {"force": (900.0, 0.0, 0.0)}}
    error = refused(stiff(demo_climb(**wind)))
    assert "torque limit >=" in str(error)
    for useless in ("mu >=", "S_mu", "mass", "payload"):
        assert useless not in str(error)


def test_a_pulled_robot_has_no_remedy(demo_climb: SceneMaker) -> None:
    """Blown off a wall, contacts would have to pull; on a wall alone, nothing presses."""
    for wind, kind in ((50.0, "push-only contact at"), (0.0, "friction at")):
        scene = demo_climb(**{"task.external_wrench": {"force": (wind, 0.0, 0.0)}})
        instants = plan_instants(scene, interpolate_rounds(scene))
        one_wall = np.broadcast_to([1.0, 0.0, 0.0], instants.normal.shape)
        error = refused(scene, replace(instants, normal=one_wall))
        (only,) = error.conflicts[0].constraints
        assert only.startswith(kind)
        assert not error.conflicts[0].remedies


def test_conflicts_are_irreducible(demo_climb: SceneMaker) -> None:
    scene = demo_climb(**{"terrain.friction": 0.4})
    statement = build_force_statement(scene, plan_instants(scene, interpolate_rounds(scene)))
    seen = 0
    for k in solve_forces(statement, "clarabel", 16).missing[:6]:
        cones = build_instant_cones(statement, int(k))
        members = find_irreducible_conflict(cones)
        assert members is not None
        together = relax_members(cones, members)
        assert together is not None
        assert together.total_violation > FEASIBLE
        for member in members:
            rest = relax_members(cones, [m for m in members if m != member])
            assert rest is not None
            assert rest.total_violation <= FEASIBLE
        assert len(members) < len(list_members(cones))
        seen += 1
    assert seen == 6


def test_mixed_friction_is_scaled(demo_climb: SceneMaker) -> None:
    scene = demo_climb()
    instants = plan_instants(scene, interpolate_rounds(scene))
    mu = np.where(instants.region == 0, 0.5, 0.4)
    error = refused(scene, replace(instants, mu=mu))
    factor = amount(str(error).splitlines()[0], "friction coefficients # times as high")
    assert not len(
        solve_forces(
            build_force_statement(scene, replace(instants, mu=mu * factor)), "daqp", 16
        ).missing
    )
    less = replace(instants, mu=mu * factor * 0.98)
    assert len(solve_forces(build_force_statement(scene, less), "daqp", 16).missing)


def three_limbs(braced_robot: RobotMaker, demo_climb: SceneMaker) -> tuple[ClimbScene, Instants]:
    scene = demo_climb(
        braced_robot(3), **{"task.rounds": 1, "task.goal": {"com": (0.0, 0.0, 0.05)}}
    )
    return scene, plan_instants(scene, interpolate_rounds(scene))


def test_two_contacts_cannot_balance(braced_robot: RobotMaker, demo_climb: SceneMaker) -> None:
    scene, instants = three_limbs(braced_robot, demo_climb)
    error = refused(scene, instants)
    assert "balance on R2, L1 alone [force.equilibrium] cannot be met" in str(error)
    assert error.conflicts[0].remedies == ()


def test_two_contacts_carry_a_load_above_them(
    braced_robot: RobotMaker, demo_climb: SceneMaker
) -> None:
    """Two contacts opposite each other and the weight in their plane: one free force is left."""
    scene, instants = three_limbs(braced_robot, demo_climb)
    toes, com = instants.toes[:1].copy(), instants.com[:1]
    toes[0, 1:] = [[0.6, 0.0, -0.15], [-0.6, 0.0, -0.15]]
    one = replace(
        instants,
        **{name: value[:1] for name, value in vars(instants).items()} | {"toes": toes, "com": com},
    )
    assert one.contact.tolist() == [[False, True, True]]
    scene = stiff(scene)  # limbs that do not give way out of bounds
    statement = build_force_statement(scene, one)
    for solver in ("daqp", "clarabel"):
        solved = solve_forces(statement, solver, 16)
        assert not len(solved.missing)
        assert not len(solved.unbalanced)
        assert check_forces(statement, solved.force).worst.max() <= 1e-7
    found = plan_forces(scene, one)
    np.testing.assert_allclose(found.force[0].sum(axis=0), [0, 0, scene.robot.weight], atol=1e-5)


def test_no_contact_at_all(demo_scene: ClimbScene, demo_instants: Instants) -> None:
    one = replace(demo_instants, **{name: value[:1] for name, value in vars(demo_instants).items()})
    none = replace(one, contact=np.zeros_like(one.contact))
    assert "balance [force.equilibrium] cannot be met" in str(refused(demo_scene, none))
