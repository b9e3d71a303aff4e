"""`climbplan robot`: what a robot's file amounts to, before anything is planned."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from climbplan.cli.console import print_json, print_result
from climbplan.cli.options import Force, Json, Quiet, Verbose
from climbplan.errors import UsageError

if TYPE_CHECKING:
    from climbplan.robots.facts import RobotFacts

_TRIANGLES = 800  # of one shape in a picture
_COLUMNS = "joint bounds [deg], torque [N m], stiffness [N m/rad]"
_SLIDING = "; of joints that slide [m], [N], [N/m]"


def robot(
    name: Annotated[
        str,
        typer.Argument(
            metavar="ROBOT", help="Built-in robot, robot file, or a spec that names one."
        ),
    ],
    picture: Annotated[
        Path | None,
        typer.Option(
            "--out", "-o", metavar="FILE", help="Picture of stance and reach to write (.png)."
        ),
    ] = None,
    as_json: Json = False,
    quiet: Quiet = False,
    verbose: Verbose = False,
    force: Force = False,
) -> None:
    """Print mass, stance, standing height, reach and limits of a robot.

    Torques of standing are those in its stance with vertical contact forces.
    """
    if picture is not None:
        if picture.suffix != ".png":
            raise UsageError(f"{picture}: expected a .png file")
        if picture.exists() and not force:
            raise UsageError(f"{picture}: already exists; --force replaces it")
    from climbplan.robots.facts import measure_robot

    spec, robot, notes = _load_robot(name)
    facts = measure_robot(robot)
    if picture is not None:
        from climbplan.climb.planner.visual_geometry import load_visual_geometry
        from climbplan.reports.robot_picture import draw_robot_picture
        from climbplan.reports.sheet import render_png
        from climbplan.store.atomic_file import replace_atomically

        image = render_png(
            draw_robot_picture(facts, geometry=load_visual_geometry(spec, robot, _TRIANGLES))
        )
        with replace_atomically(picture) as temporary:
            temporary.write_bytes(image)
    if as_json:
        print_json(_collect_values(facts, notes, picture))
    else:
        print_result("\n".join(_format_lines(facts, notes)))


def _load_robot(name: str) -> tuple[Any, Any, tuple[str, ...]]:
    """Return the spec of a robot, the robot built from it, and the assumptions made."""
    from climbplan.robots.any_robot import build_robot, list_assumptions
    from climbplan.schema.loading import load_spec
    from climbplan.schema.robots.source import UnknownRobot, load_any_robot

    spec: Any
    try:
        if Path(name).suffix in (".yaml", ".yml") and not _is_robot_file(name):
            loaded: Any = load_spec(name)
            spec = getattr(loaded, "robot", None)
            if spec is None or (not hasattr(spec, "limbs") and not hasattr(spec, "tree")):
                raise UsageError(f"{name}: names no robot with limbs")
        else:
            spec = load_any_robot(name)
    except UnknownRobot as error:
        raise UsageError(str(error)) from error
    robot = build_robot(spec)
    return spec, robot, list_assumptions(spec, robot)


def _is_robot_file(name: str) -> bool:
    """Return whether a YAML file is of kind `robot`; raises SpecError if it is not YAML."""
    from climbplan.schema.source import read_source
    from climbplan.schema.yaml_source import parse_yaml

    source = read_source(name)
    stated = parse_yaml(source.text, source.shown).value
    return isinstance(stated, dict) and stated.get("kind") == "robot"


def _collect_values(
    facts: RobotFacts, notes: tuple[str, ...], picture: Path | None
) -> dict[str, Any]:
    from climbplan.robots.model import dynamics_of

    robot_model = facts.robot
    names, force, torque = (
        robot_model.limbs.joint_names,
        facts.standing_force,
        facts.standing_torque,
    )
    limbs, drives = [], dynamics_of(robot_model)
    for n, name in enumerate(robot_model.limb_names):
        has_joint = robot_model.has_joint[n]
        limbs.append(
            {
                "name": name,
                "side": robot_model.sides[n],
                "joints": [joint for joint in names[n] if joint],
                "lower": robot_model.joint_lower[n, has_joint].tolist(),
                "upper": robot_model.joint_upper[n, has_joint].tolist(),
                "max_torque": robot_model.max_torque[n, has_joint].tolist(),
                "joint_stiffness": robot_model.joint_stiffness[n, has_joint].tolist(),
                "max_joint_speed": robot_model.max_joint_speed[n, has_joint].tolist(),
                "rotor_inertia": drives.rotor_inertia[n, has_joint].tolist(),
                "joint_damping": drives.damping[n, has_joint].tolist(),
                "stance": robot_model.stance_body[n].tolist(),
                "reach": float(facts.reach[n]),
                "standing_force": None if force is None else float(force[n]),
                "standing_torque": None if torque is None else torque[n, has_joint].tolist(),
            }
        )
    return {
        "robot": robot_model.name,
        "mass": robot_model.mass,
        "gravity": robot_model.gravity,
        "structural_compliance_share": robot_model.structural_compliance_share,
        "standing_height": facts.standing_height,
        "standing_safety": facts.standing_safety,
        "reach": robot_model.reach,
        "stance_radius": robot_model.stance_radius,
        "limb_radius": robot_model.limb_radius,
        "limbs": limbs,
        "notes": list(notes),
        **({} if picture is None else {"picture": str(picture)}),
    }


def _format_lines(facts: RobotFacts, notes: tuple[str, ...]) -> list[str]:
    import numpy as np

    robot_model = facts.robot
    has_joint = robot_model.has_joint
    body = np.ptp(robot_model.body_hull, axis=0)
    joints = int(has_joint.sum())
    lines = [
        (
            f"{robot_model.name}: {robot_model.mass:.4g} kg, {robot_model.limb_count} limbs, "
            f"{joints} joints"
        ),
        f"body      {' x '.join(f'{side:.3f}' for side in body)} m",
        f"stance    body {facts.standing_height:.3f} m above its toes"
        + (f", which differ by {facts.uneven:.3f} m in height" if facts.uneven > 1e-3 else ""),
        (
            f"planner   toes within {robot_model.reach:.3f} m of their shoulders and "
            f"{robot_model.stance_radius:.3f} m of their stance"
        ),
        _format_standing(facts),
        f"{'limb':<10}{'toe of the stance [m]':<26}{'reach [m]':>9}  {_COLUMNS}"
        + (_SLIDING if robot_model.slides.any() else ""),
    ]
    for n, name in enumerate(robot_model.limb_names):
        limb_joints = has_joint[n]
        toe = ", ".join(f"{value:.3f}" for value in robot_model.stance_body[n])
        if not np.isfinite(facts.stance_angles[n, limb_joints]).all():
            toe += " (out of reach)"
        bounds = ", ".join(
            f"{low:.2f}..{high:.2f} m"
            if slides
            else f"{np.rad2deg(low):.0f}..{np.rad2deg(high):.0f}"
            for low, high, slides in zip(
                robot_model.joint_lower[n, limb_joints],
                robot_model.joint_upper[n, limb_joints],
                robot_model.slides[n, limb_joints],
                strict=True,
            )
        )
        torque = "/".join(f"{value:g}" for value in robot_model.max_torque[n, limb_joints])
        stiffness = "/".join(f"{value:g}" for value in robot_model.joint_stiffness[n, limb_joints])
        lines.append(f"{name:<10}{toe:<26}{facts.reach[n]:>9.3f}  {bounds}; {torque}; {stiffness}")
    return [*lines, *notes]


def _format_standing(facts: RobotFacts) -> str:
    import numpy as np

    from climbplan.robots.joint_units import torque_unit

    robot_model = facts.robot
    if facts.standing_force is None or facts.standing_torque is None:
        return "standing  not on these toes: the body is not above them, or some are out of reach"
    utilisation = np.abs(facts.standing_torque) / np.where(
        robot_model.has_joint, robot_model.max_torque, np.inf
    )
    n, j = np.unravel_index(int(np.argmax(utilisation)), utilisation.shape)
    lowest, highest = facts.standing_force.min(), facts.standing_force.max()
    span = f"{highest:.1f}" if highest - lowest < 0.05 else f"{lowest:.1f} to {highest:.1f}"
    return (
        f"standing  {span} N a toe, straight up; nearest to its limit is "
        f"{robot_model.limb_names[n]} {robot_model.joint_name(int(n), int(j))}: "
        f"{abs(facts.standing_torque[n, j]):.2f} of {robot_model.max_torque[n, j]:g} "
        f"{torque_unit(robot_model, int(n), int(j))}"
    )
