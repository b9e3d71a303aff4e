"""A complete identification: matrices, all models that the data allow, and the findings."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from climbplan.errors import UsageError
from climbplan.mechanics.identification.fit import Fit, FitModel, fit_stiffness
from climbplan.mechanics.identification.limb_model import MeasuredLimb, angle_columns
from climbplan.mechanics.identification.measurements import Matrix, Measurements, read_measurements
from climbplan.mechanics.identification.slopes import Reduced, matrices_from
from climbplan.robots.model import Robot

_MAX_ERROR = 0.2  # relative, of a model that describes the limb


@dataclass(frozen=True)
class Identification:
    """The results of a file of measurements on a limb."""

    limb: MeasuredLimb
    measurements: Measurements
    matrices: tuple[Matrix, ...]
    reduced: Reduced | None  # tests the matrices were taken from
    fits: tuple[Fit, ...]  # best first
    reference_gain: float | None  # that the joint stiffnesses are for
    findings: tuple[str, ...]  # what the data determine and what not, in sentences

    @property
    def robot_file(self) -> dict[str, Any]:
        """The keys of a robot file of a URDF: stiffness by joint, and the structural share."""
        joints = zip(self.limb.felt, self.best.joint_stiffness, strict=True)
        keys: dict[str, Any] = {
            "joints": {name: {"stiffness": round(estimate.value, 2)} for name, estimate in joints}
        }
        if self.best.share is not None:
            keys["structural_compliance_share"] = round(self.best.share.value, 4)
        return keys

    @property
    def best(self) -> Fit:
        """The model that explains most for its unknowns (BIC)."""
        return self.fits[0]


def identify(
    path: Path,
    robot: Robot,
    seed: int = 0,
    progress: Callable[[float], None] | None = None,
    number: int = 0,
) -> Identification:
    """Identify joint stiffness and structure from a file, with the geometry of a robot's limb.

    Args:
        path: CSV file of measurements.
        robot: The robot.
        seed: Of the resampling.
        progress: Called with the fraction that is done; None for none.
        number: Of the limb.

    Raises:
        UsageError: The file cannot be used.
        SpecError: Its columns are wrong.
    """
    measured = read_measurements(path, angle_columns(robot, number))
    limb = MeasuredLimb(robot, measured.axes, number)
    reduced = matrices_from(measured.series, measured.axes) if measured.series else None
    matrices = reduced.matrices if reduced is not None else measured.matrices
    if not matrices:
        why = (*measured.skipped, *(reduced.skipped if reduced is not None else ()))
        raise UsageError(f"{path}: no stiffness matrix in it{': ' + why[0] if why else ''}")
    models = _list_models(matrices)
    fits = []
    for index, model in enumerate(models):
        if progress is not None:
            progress(index / len(models))
        try:
            fits.append(fit_stiffness(limb, matrices, model, seed))
        except UsageError:
            if index == 0:  # the smallest model: with fewer numbers nothing can be said
                raise
    fits.sort(key=_compute_bic)
    gains = [m.gain for m in matrices if m.gain is not None]
    reference = float(np.median(gains)) if gains else None
    findings = _describe_findings(fits, limb, matrices, reference)
    return Identification(limb, measured, matrices, reduced, tuple(fits), reference, findings)


def _list_models(matrices: tuple[Matrix, ...]) -> list[FitModel]:
    """Return the models that the matrices can distinguish, the smallest first."""
    are_known = all(m.posture.angles is not None for m in matrices)
    gains = {m.gain for m in matrices}
    by_gain = [False, True] if len(gains) > 1 and None not in gains else [False]
    feet = ["known"] if are_known else ["horizontal", "radial"]
    return [FitModel(s, g, f) for f in feet for g in by_gain for s in (False, True)]


def _compute_bic(fit: Fit) -> float:
    """Return the Bayesian information criterion per measured number, comparable between fits."""
    entries = sum(len(m.stiffness) * (len(m.stiffness) + 1) // 2 for m in fit.matrices)
    unknowns = max(entries - fit.freedom, 0)
    return float(np.log(max(fit.cost, 1e-9) / entries) + unknowns * np.log(entries) / entries)


def _describe_findings(
    fits: list[Fit], limb: MeasuredLimb, matrices: tuple[Matrix, ...], gain: float | None
) -> tuple[str, ...]:
    """Return what the data determine and what not, in sentences."""
    best = fits[0]
    names = limb.felt
    findings = []
    suffix = f" at P gain {gain:g}" if gain is not None else ""
    for name, estimate in zip(names, best.joint_stiffness, strict=True):
        verdict = "told" if estimate.is_determined else "not told apart from much softer or stiffer"
        unit = "N/m" if name in limb.angles.slides else "N m/rad"
        findings.append(
            f"{name}: {estimate.value:.1f} {unit}, 95 % interval {estimate.lower:.1f} to "
            f"{estimate.upper:.1f}{suffix} ({verdict})"
        )
    if 0 not in limb.joints:
        findings.append("the coxa cannot be identified: it turns across the plane of these tests")
    findings.append(_describe_structure(best, fits))
    if best.model.feet != "known":
        radial = [f for f in fits if f.model.feet != best.model.feet]
        against = (
            f", taken as {radial[0].model.feet} {radial[0].relative_error:.0%}" if radial else ""
        )
        findings.append(
            f"postures are not in the file but for the foot distance; taken as {best.model.feet} "
            f"distance from the femur joint the fit misses the matrices by "
            f"{best.relative_error:.0%} (median){against}"
        )
    if best.relative_error > _MAX_ERROR:
        findings.append(
            f"the model misses the matrices by {best.relative_error:.0%} (median): joints and "
            "structure of this kind do not describe the limb"
        )
    if len(best.matrices) < len(matrices):
        findings.append(f"{len(matrices) - len(best.matrices)} matrices were left out")
    return tuple(findings)


def _describe_structure(best: Fit, fits: list[Fit]) -> str:
    """Return what the data say about the structure."""
    if best.share is not None and best.share.lower > 0.002:
        finding = f"the structure makes up {best.share.value:.1%} of the compliance"
        finding += f" ({best.share.lower:.1%} to {best.share.upper:.1%})"
        if best.model.by_gain:
            return finding
        return finding + "; what gives in the shape of a joint's motion is counted to that joint"
    tried = [f.share for f in fits if f.share is not None and f.model.feet == best.model.feet]
    even = f" (at most {max(s.upper for s in tried):.1%})" if tried else ""
    return (
        f"a structure that gives alike in all directions is not seen{even}; one that gives in the "
        "shape of a joint's motion cannot be told from that joint by these data: the stiffnesses "
        "above contain it, k (1 - share). Repeating the tests at a second P gain tells them apart"
    )
