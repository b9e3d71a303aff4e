"""Convert a compiled MJCF file to a URDF, which is read, checked and stored in plans like any
other.

Links are bodies, with their origin moved into the joint that carries them, as URDF has it; a body
of several joints has a link without mass for each but the last. Named sites are links without mass.
Angles count from the pose of the file, as a URDF's zero is: `ref` is taken off the bounds.
"""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any
from xml.sax.saxutils import quoteattr

import numpy as np

from climbplan.arrays import Array
from climbplan.schema.robots.mjcf.compiled import Mjcf, compile_mjcf
from climbplan.schema.robots.mjcf.places import (
    convert_quaternion,
    format_numbers,
    write_line_attribute,
    write_origin,
)
from climbplan.schema.robots.mjcf.shapes import Shapes
from climbplan.schema.robots.xml import Element, UrdfFault

_WORLD = "world"


def convert_mjcf_to_urdf(path: Path, root: Element) -> str:
    """Return the URDF text of the robot in an MJCF file; `from_line` of an element is its line
    there.

    Raises MissingSolver without MuJoCo and UrdfFault for what has no counterpart in a URDF.
    """
    return _UrdfWriter(compile_mjcf(path, root), path).text()


class _UrdfWriter:
    def __init__(self, compiled_model: Mjcf, path: Path) -> None:
        self.found, self.path = compiled_model, path
        self.library, self.spec, self.model = (
            compiled_model.library,
            compiled_model.spec,
            compiled_model.model,
        )
        self.name = str(self.spec.modelname) or path.stem
        self.shapes = Shapes(compiled_model, path)
        model = self.model
        self.bodies = [
            b for b in range(1, model.nbody) if model.body_rootid[b] == compiled_model.robot
        ]
        used_names = {model.body(body).name for body in self.bodies}
        self.links = {
            b: model.body(b).name or _choose_free_name(f"body_{b}", used_names) for b in self.bodies
        }
        self.taken = used_names | set(self.links.values())
        self.joint_names = {model.joint(j).name for j in range(model.njnt)}
        self.origin = {body: self._origin(body) for body in self.bodies}
        self.efforts = self._efforts()
        self.follows = self._follows()

    def text(self) -> str:
        """Return the whole document."""
        elements = [element for body in self.bodies for element in self._body(body)]
        return "\n".join([f"<robot name={quoteattr(self.name)}>", *elements, "</robot>", ""])

    # Bodies

    def _joints(self, body: int) -> list[int]:
        """Return joints of a body, the free one left out."""
        model, free = self.model, self.library.mjtJoint.mjJNT_FREE
        first = int(model.body_jntadr[body])
        indices = range(first, first + int(model.body_jntnum[body]))
        return [joint for joint in indices if model.jnt_type[joint] != free]

    def _origin(self, body: int) -> Array:
        """Return the link's origin in the body's frame: its last joint [m]."""
        joints = self._joints(body)
        return np.array(self.model.jnt_pos[joints[-1]]) if joints else np.zeros(3)

    def _body(self, body: int) -> list[str]:
        """Return the joints that carry a body, its link and its sites."""
        model, link = self.model, self.links[body]
        elements, joints = [], self._joints(body)
        parent, parent_origin = int(model.body_parentid[body]), np.zeros(3)
        position, axes = (
            np.array(model.body_pos[body]),
            convert_quaternion(self.library, model.body_quat[body]),
        )
        above = _WORLD
        if parent in self.links:
            above, parent_origin = self.links[parent], self.origin[parent]
        elif joints:  # the world carries it by joints
            above = _choose_free_name(_WORLD, self.taken)
            elements.append(f"<link name={quoteattr(above)}/>")
        if not joints and parent in self.links:
            name = _choose_free_name(f"{link}_fixed", self.joint_names)
            elements.append(_write_fixed_joint(name, above, link, position - parent_origin, axes))
        joint_position = position - parent_origin
        for number, joint in enumerate(joints):
            pos = np.array(model.jnt_pos[joint])
            last = number == len(joints) - 1
            below = link if last else _choose_free_name(f"{link}_{number + 1}", self.taken)
            if not last:
                elements.append(f"<link name={quoteattr(below)}/>")
            step = joint_position + axes @ pos if number == 0 else pos - joint_position
            elements.append(self._joint(joint, above, below, step, axes if number == 0 else None))
            above, joint_position = below, pos
        elements.append(self._link(body))
        return elements + self._sites(body)

    def _link(self, body: int) -> str:
        model = self.model
        line = self.found.line("body", model.body(body).name)
        inertial = ""
        mass = float(model.body_mass[body])
        if mass > 0:
            axes = convert_quaternion(self.library, model.body_iquat[body])
            about = axes @ np.diag(model.body_inertia[body]) @ axes.T
            moments = " ".join(
                f'i{"xyz"[i]}{"xyz"[j]}="{float(about[i, j])!r}"'
                for i in range(3)
                for j in range(i, 3)
            )
            lever = np.array(model.body_ipos[body]) - self.origin[body]
            inertial = (
                f'<inertial><origin xyz="{format_numbers(lever)}"/><mass value="{mass!r}"/>'
                f"<inertia {moments}/></inertial>"
            )
        shapes = self.shapes.of(body, self.origin[body])
        name = quoteattr(self.links[body])
        return f"<link name={name}{write_line_attribute(line)}>{inertial}{shapes}</link>"

    def _sites(self, body: int) -> list[str]:
        """Return named sites, at which toes may be."""
        model, elements = self.model, []
        for site in range(model.nsite):
            name = model.site(site).name
            if not name or int(model.site_bodyid[site]) != body:
                continue
            link_name = _choose_free_name(name, self.taken)
            fixed = _choose_free_name(f"{link_name}_fixed", self.joint_names)
            position = np.array(model.site_pos[site]) - self.origin[body]
            axes = convert_quaternion(self.library, model.site_quat[site])
            elements.append(f"<link name={quoteattr(link_name)}/>")
            elements.append(_write_fixed_joint(fixed, self.links[body], link_name, position, axes))
        return elements

    # Joints

    def _joint(self, joint: int, above: str, below: str, step: Array, axes: Array | None) -> str:
        model, library = self.model, self.library
        name = model.joint(joint).name or _choose_free_name(f"joint_{joint}", self.joint_names)
        line = self.found.line("joint", name)
        kind = int(model.jnt_type[joint])
        limited = bool(model.jnt_limited[joint])
        if kind == library.mjtJoint.mjJNT_HINGE:
            written = "revolute" if limited else "continuous"
        elif kind == library.mjtJoint.mjJNT_SLIDE:
            written = "prismatic"
        elif kind == library.mjtJoint.mjJNT_FREE:  # not of the robot's root
            written = "floating"
        else:
            raise UrdfFault(f"joint {name!r}: a ball joint; expected hinges", line)
        if self.follows.get(joint) == "":
            written = "fixed"
        limit = ""
        if limited:
            zero = float(model.qpos0[model.jnt_qposadr[joint]])
            low, high = (float(bound) - zero for bound in model.jnt_range[joint])
            limit = f' lower="{low!r}" upper="{high!r}"'
        if joint in self.efforts:
            limit += f' effort="{self.efforts[joint]!r}"'
        dof = int(model.jnt_dofadr[joint])
        dynamics = (
            f'<dynamics damping="{float(model.dof_damping[dof])!r}" '
            f'friction="{float(model.dof_frictionloss[dof])!r}" '
            f'armature="{float(model.dof_armature[dof])!r}"/>'
        )
        axis = format_numbers(model.jnt_axis[joint])
        ends = f"<parent link={quoteattr(above)}/><child link={quoteattr(below)}/>"
        return (
            f'<joint name={quoteattr(name)} type="{written}"{write_line_attribute(line)}>{ends}'
            f'{write_origin(step, axes)}<axis xyz="{axis}"/><limit{limit}/>{dynamics}'
            f"{self.follows.get(joint, '')}</joint>"
        )

    def _efforts(self) -> dict[int, float]:
        """Return torque limits [N m]: what the joint lets through of what its strongest motor
        gives.
        """
        model, library = self.model, self.library
        limits: dict[int, float] = {}
        by_joint = (int(library.mjtTrn.mjTRN_JOINT), int(library.mjtTrn.mjTRN_JOINTINPARENT))
        for motor in range(model.nu):
            if int(model.actuator_trntype[motor]) not in by_joint:
                continue
            if model.actuator_forcelimited[motor]:
                force = _symmetric_limit(model.actuator_forcerange[motor])
            elif model.actuator_ctrllimited[motor] and self._is_plain(motor):
                gain = abs(float(model.actuator_gainprm[motor][0]))
                force = gain * _symmetric_limit(model.actuator_ctrlrange[motor])
            else:
                continue
            joint = int(model.actuator_trnid[motor][0])
            torque = force * abs(float(model.actuator_gear[motor][0]))
            limits[joint] = max(limits.get(joint, 0.0), torque)
        for joint in range(model.njnt):
            if model.jnt_actfrclimited[joint]:
                through = _symmetric_limit(model.jnt_actfrcrange[joint])
                limits[joint] = min(limits.get(joint, math.inf), through)
        return limits

    def _is_plain(self, motor: int) -> bool:
        """Return whether its force is a gain times its command, and nothing else."""
        library, model = self.library, self.model
        return bool(
            model.actuator_gaintype[motor] == library.mjtGain.mjGAIN_FIXED
            and model.actuator_biastype[motor] == library.mjtBias.mjBIAS_NONE
            and model.actuator_dyntype[motor] == library.mjtDyn.mjDYN_NONE
        )

    def _follows(self) -> dict[int, str]:
        """Return joints that an equality makes follow another, as URDF has it; empty of one it
        holds.
        """
        model, mimic_elements = self.model, {}
        for equality in range(model.neq):
            if model.eq_type[equality] != self.library.mjtEq.mjEQ_JOINT:
                continue
            if not model.eq_active0[equality]:
                continue
            joint, leader_index = int(model.eq_obj1id[equality]), int(model.eq_obj2id[equality])
            name = model.joint(joint).name
            offset, ratio, *higher_coefficients = (float(a) for a in model.eq_data[equality][:5])
            if any(higher_coefficients) or (leader_index < 0 and offset):
                what = (
                    "by a polynomial"
                    if any(higher_coefficients)
                    else f"{offset:g} off the pose of the file"
                )
                message = f"joint {name!r} is held {what}; expected one that follows in proportion"
                raise UrdfFault(message, self.found.line("joint", name))
            if leader_index < 0:
                mimic_elements[joint] = ""
                continue
            leader = model.joint(leader_index).name
            mimic_elements[joint] = (
                f'<mimic joint={quoteattr(leader or "unnamed")} multiplier="{ratio!r}" '
                f'offset="{offset!r}"/>'
            )
        return mimic_elements


def _write_fixed_joint(name: str, above: str, below: str, position: Array, axes: Array) -> str:
    ends = f"<parent link={quoteattr(above)}/><child link={quoteattr(below)}/>"
    return (
        f'<joint name={quoteattr(name)} type="fixed">{ends}{write_origin(position, axes)}</joint>'
    )


def _symmetric_limit(bounds: Any) -> float:
    """Return the limit that holds in both directions."""
    low, high = (float(bound) for bound in bounds)
    return max(min(-low, high), 0.0)


def _choose_free_name(name: str, used_names: set[str]) -> str:
    """Return a name that is not taken yet, and taken from now on."""
    free, number = name, 2
    while free in used_names:
        free, number = f"{name}_{number}", number + 1
    used_names.add(free)
    return free
