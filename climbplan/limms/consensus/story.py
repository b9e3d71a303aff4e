"""What a consensus tells: its record for the plan's file, and the lines of its summary."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from climbplan.limms.consensus.iteration import Iterate, Step
from climbplan.limms.plan.convergence import Convergence
from climbplan.limms.plan.limms_plan import LimmsPlan
from climbplan.limms.plan.summary import motion_line, refused_lines


def convergence_of(runs: Sequence[Sequence[Step]]) -> Convergence:
    """The record of all iterations, those of one choice of modes after those of another."""
    steps = [step for run in runs for step in run]
    residuals = [step.residual for step in steps]
    return Convergence(
        attempt=np.concatenate([np.full(len(run), i) for i, run in enumerate(runs)]),
        frozen=np.array([int(step.frozen) for step in steps]),
        box_mean=np.array([r.box[0] for r in residuals]),
        box_max=np.array([r.box[1] for r in residuals]),
        points_mean=np.array([r.points[0] for r in residuals]),
        points_max=np.array([r.points[1] for r in residuals]),
        axes_mean=np.array([r.axes[0] for r in residuals]),
        axes_max=np.array([r.axes[1] for r in residuals]),
        missed=np.array([step.missed for step in steps]),
        violation=np.array([max(step.violation, step.penetration) for step in steps]),
        mixed_integer_seconds=np.array([step.mixed_integer_seconds for step in steps]),
        nonlinear_seconds=np.array([step.nonlinear_seconds for step in steps]),
    )


def consensus_lines(plan: LimmsPlan, best: Iterate, notes: Sequence[str]) -> tuple[str, ...]:
    """Head, blocks, agreement, program and motion lines as shown on a terminal."""
    sizes, times, r = plan.sizes, plan.timings, best.residual
    mass = float(plan.box_mass[0])
    head = f"{plan.name:<16} {sizes['modules']} modules, box {mass:g} kg, method {plan.method}"
    blocks = (
        f"{'blocks':<9} {'built':<9} {times['build_mixed_integer'] + times['build_nonlinear']:.2f}"
        f" s   mixed-integer {sizes['mip_variables']} variables ({sizes['mip_binaries']} binary), "
        f"nonlinear {sizes['nlp_variables']}"
    )
    modes = f"{'modes':<9} {'found':<9} {times['first_integers']:.2f} s   {plan.sequence}"
    if best.off is not None:
        off = f"{best.off.residual:.1g} {best.off.unit}".rstrip()
        modes += f"; rows hold within {off} [{best.off.name}]"
    agreed = (
        f"{'consensus':<9} {'agreed' if r.good else 'apart':<9} "
        f"{times['mixed_integer'] + times['nonlinear']:.2f} s   {sizes['iterations']} iterations, "
        f"mean residuals {1e3 * r.box[0]:.1f} mm (box), {1e3 * r.points[0]:.1f} mm (modules), "
        f"{r.axes[0]:.3f} rad"
    )
    programs = (
        f"{'programs':<9} {sizes['programs']} solved  {times['build'] + times['solve']:.2f} s   "
        f"last one {sizes['variables']} variables, {sizes['constraints']} constraints"
    )
    return (head, blocks, modes, agreed, *refused_lines(notes), programs, motion_line(plan))
