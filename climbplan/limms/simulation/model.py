"""The MuJoCo model of modules and boxes: chains of seven links with a servo in every joint.

Ends of modules are attached by equality constraints (welds), which exist from the start and are
switched on and off. A box stands on the ground by contact and friction.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from climbplan.limms.modules.chain import ROLLS
from climbplan.limms.modules.inertia import build_link_bodies
from climbplan.limms.plan.limms_plan import LimmsPlan
from climbplan.limms.scene.limms_scene import GRAVITY
from climbplan.limms.schema.module import JOINTS, LINKS, ModuleSpec
from climbplan.simulation.attributes import format_numbers
from climbplan.simulation.conditions import Conditions

TIME_STEP = 5e-4  # [s] at most
LIGHT_FRACTION = 0.03  # of the mass of the box, for a module of a massless plan
LIGHT_LEG_FRACTION = 5e-4  # the same for legs, whose speed jumps would turn a box in the air
_LEGS = (4, 5)  # modes of modules
STIFFNESS = 200.0  # [N m/rad] of a joint's servo
DAMPING = 5.0  # [N m s/rad]
ARMATURE = 2e-3  # [kg m^2] of a drive, at its joint
_SOLID, _BOX = 1, 2
_COLOURS = ("0.22 0.46 0.72", "0.85 0.45 0.15", "0.25 0.60 0.35", "0.60 0.35 0.65")


class Weld(NamedTuple):
    """A weld: the end (0 first, 1 last) of a module on another body, by its name in the model."""

    module: int
    end: int
    body: str


def build_simulated_module(plan: LimmsPlan) -> ModuleSpec:
    """Return the module as it is simulated, nearly massless for a massless plan."""
    module = ModuleSpec.model_validate(plan.module)
    if not plan.massless:
        return module
    factor = (
        compute_mass_fraction(plan) * float(plan.box_mass[: plan.deliveries].min()) / module.mass
    )
    lighter = {name: factor * vars(module)[name] for name in ("mass", "joint_mass", "latch_mass")}
    return module.model_copy(update=lighter)


def compute_mass_fraction(plan: LimmsPlan) -> float:
    """Return the mass of a module of a massless plan, as a fraction of the mass of the box."""
    return LIGHT_LEG_FRACTION if np.isin(plan.motion.mode, _LEGS).any() else LIGHT_FRACTION


def link_name(module: int, link: int) -> str:
    """Return the name of a link's body in the model."""
    return f"module{module}link{link}"


def box_name(box: int) -> str:
    """Return the name of a delivered box's body in the model."""
    return f"box{box}" if box else "box"


def end_link(end: int) -> int:
    """Return the link that an end belongs to."""
    return (LINKS - 1) * end


def build_mjcf(
    plan: LimmsPlan, module: ModuleSpec, welds_of_modules: Sequence[Weld], conditions: Conditions
) -> str:
    """Build the model; box and modules start anywhere."""
    friction = max(plan.friction * conditions.friction, 1e-5)
    welds = "\n".join(_build_weld(k, hold) for k, hold in enumerate(welds_of_modules))
    count = len(plan.module_names)
    servos = "\n".join(_build_servos(m, plan, module, conditions) for m in range(count))
    return f"""
<mujoco model="climbplan modules">
<option timestep="{TIME_STEP}" gravity="0 0 {-GRAVITY}" cone="elliptic" impratio="20"
 integrator="implicitfast" jacobian="dense"/>
<compiler angle="radian" autolimits="true"/>
<visual><global offwidth="1280" offheight="960"/>
<headlight ambient=".5 .5 .5" diffuse=".5 .5 .5"/></visual>
<default><geom condim="3" solref="0.004 1" solimp="0.98 0.999 0.0005"
 friction="{friction:.6g} 0 0"/>
<equality solref="0.002 1" solimp="0.9999 0.9999 0.001"/></default>
<asset>
<texture type="skybox" builtin="flat" rgb1="1 1 1" rgb2="1 1 1" width="8" height="48"/>
</asset>
<worldbody>
<light pos="0 -2 3" dir="0 0.5 -1" directional="true"/>
{_build_surroundings(plan)}
{"".join(_build_box(plan, b, conditions) for b in range(plan.deliveries))}
{"".join(_build_chain(m, module) for m in range(count))}
</worldbody>
<equality>
{welds}
</equality>
<actuator>
{servos}
</actuator>
</mujoco>"""


def _build_surroundings(plan: LimmsPlan) -> str:
    """Return ground, walls and static boxes; what is above the lowest ground is transparent."""
    solids = [(block[0], block[1], block[1, 2] <= 1e-6) for block in plan.solids]
    first = plan.deliveries
    places = plan.motion.box_position[0, first:]
    for size, centre in zip(plan.box_size[first:], places, strict=True):
        solids.append((centre - size / 2, centre + size / 2, True))
    geoms = []
    for lower, upper, opaque in solids:
        colour = "0.60 0.62 0.65 1" if opaque else "0.60 0.62 0.65 0.15"
        geoms.append(
            f'<geom type="box" pos="{format_numbers((lower + upper) / 2)}"'
            f' size="{format_numbers((upper - lower) / 2)}" rgba="{colour}"'
            f' contype="{_SOLID}" conaffinity="0"/>'
        )
    return "\n".join(geoms)


def _build_box(plan: LimmsPlan, b: int, conditions: Conditions) -> str:
    """Return a homogeneous box to deliver."""
    size, name = plan.box_size[b], box_name(b)
    mass = float(plan.box_mass[b]) + conditions.payload
    inertia = mass / 12 * ((size**2).sum() - size**2)
    return (
        f'<body name="{name}" pos="{format_numbers(plan.motion.box_position[0, b])}"'
        f' euler="0 0 {plan.motion.box_yaw[0, b]:.9g}"><freejoint/>'
        f'<inertial pos="0 0 0" mass="{mass:.9g}" diaginertia="{format_numbers(inertia)}"/>'
        f'<geom name="{name}" type="box" size="{format_numbers(size / 2)}" rgba="0.80 0.62 0.38 1"'
        f' contype="{_BOX}" conaffinity="{_SOLID | _BOX}"/></body>'
    )


def _build_chain(m: int, module: ModuleSpec) -> str:
    """Return one module: links along their z axes, each rotating relative to the last."""
    bodies = build_link_bodies(module)
    colour = _COLOURS[m % len(_COLOURS)]
    text = ""
    for k in range(LINKS):
        position = f"0 0 {module.link_lengths[k - 1]:.9g}" if k else "0 0 0"
        axis = "0 0 1" if k and ROLLS[k - 1] else "0 1 0"
        joint = f'<joint name="{link_name(m, k)}" axis="{axis}" armature="{ARMATURE}"/>'
        inertia = (
            bodies.transverse_inertia[k],
            bodies.transverse_inertia[k],
            bodies.axial_inertia[k],
        )
        text += (
            f'<body name="{link_name(m, k)}" pos="{position}">{joint if k else "<freejoint/>"}'
            f'<inertial pos="0 0 {bodies.com[k]:.9g}" mass="{bodies.mass[k]:.9g}"'
            f' diaginertia="{format_numbers(inertia)}"/>'
            f'<geom type="capsule" fromto="0 0 0 0 0 {module.link_lengths[k]:.9g}"'
            f' size="{module.radius:.9g}" rgba="{colour} 1" contype="0" conaffinity="0"/>'
        )
    return text + LINKS * "</body>" + "\n"


def _build_weld(number: int, hold: Weld) -> str:
    """Return the constraint of a weld, inactive at first."""
    link = link_name(hold.module, end_link(hold.end))
    return f'<weld name="hold{number}" body1="{hold.body}" body2="{link}" active="false"/>'


def _build_servos(m: int, plan: LimmsPlan, module: ModuleSpec, conditions: Conditions) -> str:
    """Return the servos of a module; a massless plan has no torque limits."""
    limit = module.max_torque
    range_ = "" if plan.massless else f' forcerange="{-limit:.9g} {limit:.9g}"'
    gain = STIFFNESS * conditions.gain
    return "".join(
        f'<position joint="{link_name(m, k + 1)}" kp="{gain:.9g}" kv="{DAMPING}"{range_}/>'
        for k in range(JOINTS)
    )
