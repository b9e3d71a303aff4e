"""A motion as a scene of OpenUSD: body, links and surfaces, with time samples."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from climbplan.arrays import Array
from climbplan.errors import MissingSolver, UsageError
from climbplan.exports.motion import BodyMotion, RobotMotion
from climbplan.store.atomic_file import replace_atomically

_DISK = "the disk may be full"  # where the library gives no reason
_MARKER = 0.02  # [m] half edge of a body of unknown size


def write_usd(motion: RobotMotion, out: Path) -> None:
    """Write a binary or text stage by the file's suffix (.usd, .usdc, .usda); metres, z up.

    Time codes are samples, played at the motion's mean rate. Raises MissingSolver without the extra
    `usd`, UsageError if the file cannot be written.
    """
    try:
        from pxr import Tf, Usd, UsdGeom
    except ImportError as error:
        raise MissingSolver("USD files need usd-core: pip install 'climbplan[usd]'") from error
    stage = Usd.Stage.CreateInMemory()
    UsdGeom.SetStageUpAxis(stage, UsdGeom.Tokens.z)
    UsdGeom.SetStageMetersPerUnit(stage, 1.0)
    samples = len(motion.time)
    span = float(motion.time[-1] - motion.time[0])
    stage.SetTimeCodesPerSecond((samples - 1) / span if span > 0 else 1.0)
    stage.SetStartTimeCode(0)
    stage.SetEndTimeCode(samples - 1)
    root = UsdGeom.Xform.Define(stage, "/motion")
    stage.SetDefaultPrim(root.GetPrim())
    root.GetPrim().SetCustomDataByKey("climbplan", {"name": motion.name, "robot": motion.robot})
    codes = _compute_time_codes(motion.time)
    for number, body in enumerate(motion.bodies):
        half = motion.body_size if number == 0 and motion.body_size is not None else None
        _add_body(UsdGeom, stage, body, half, codes)
    for limb in motion.limbs:
        for link in range(limb.points.shape[1] - 1):
            path = f"/motion/{_format_identifier(limb.name)}/link{link}"
            _add_link(UsdGeom, stage, path, limb.points[:, link : link + 2], limb.radius, codes)
    for number, corners in enumerate(motion.surfaces):
        mesh = UsdGeom.Mesh.Define(stage, f"/motion/surfaces/surface{number}")
        mesh.CreatePointsAttr([tuple(map(float, corner)) for corner in corners])
        mesh.CreateFaceVertexCountsAttr([len(corners)])
        mesh.CreateFaceVertexIndicesAttr(list(range(len(corners))))
        mesh.CreateDoubleSidedAttr(True)
    suffix = out.suffix if out.suffix in (".usd", ".usdc", ".usda") else ".usd"
    with replace_atomically(out) as temporary_path:
        export_path = temporary_path.with_name(
            temporary_path.name + suffix
        )  # USD chooses the format by it
        try:
            try:
                is_written = stage.Export(str(export_path))
            except Tf.ErrorException as error:
                lines = [line.strip() for line in str(error).splitlines()]
                reason = next(filter(None, lines), _DISK)
                raise UsageError(f"{out}: cannot be written: {reason}") from error
            if not is_written:
                raise UsageError(f"{out}: cannot be written: {_DISK}")
            export_path.replace(temporary_path)
        finally:
            export_path.unlink(missing_ok=True)


def _compute_time_codes(time: Array) -> Array:
    """Return time codes of samples, which need not be evenly spaced."""
    span = float(time[-1] - time[0])
    if span <= 0:
        return np.zeros(len(time))
    return np.asarray((time - time[0]) / span * (len(time) - 1))


def _add_body(
    geometry: Any, stage: Any, body: BodyMotion, half_size: Array | None, codes: Array
) -> None:
    path = f"/motion/{_format_identifier(body.name)}"
    geometry.Xform.Define(stage, path)
    cube = geometry.Cube.Define(stage, f"{path}/box")
    cube.CreateSizeAttr(2.0)
    size = np.full(3, _MARKER) if half_size is None else half_size
    cube.AddScaleOp().Set(tuple(map(float, size)))
    _animate(geometry.Xformable(stage.GetPrimAtPath(path)), body.position, body.quaternion, codes)


def _add_link(
    geometry: Any, stage: Any, path: str, ends: Array, radius: float, codes: Array
) -> None:
    """Add a capsule along z from the first to the second of ends (T, 2, 3)."""
    along = ends[:, 1] - ends[:, 0]
    length = np.linalg.norm(along, axis=1)
    capsule = geometry.Capsule.Define(stage, path)
    capsule.CreateAxisAttr("Z")
    capsule.CreateRadiusAttr(float(radius))
    capsule.CreateHeightAttr(float(length.mean()))
    up = along / np.maximum(length, 1e-12)[:, None]
    # Half the turn from z to the link: (1 + cos, z x up), unless it points straight down
    quaternion = np.stack([-up[:, 1], up[:, 0], np.zeros(len(up)), 1 + up[:, 2]], axis=1)
    quaternion[quaternion[:, 3] < 1e-9] = [1.0, 0.0, 0.0, 0.0]
    quaternion /= np.linalg.norm(quaternion, axis=1, keepdims=True)
    _animate(geometry.Xformable(capsule.GetPrim()), ends.mean(axis=1), quaternion, codes)


def _animate(prim: Any, position: Array, quaternion: Array, codes: Array) -> None:
    from pxr import Gf

    translate_op, orient_op = prim.AddTranslateOp(), prim.AddOrientOp()
    for code, sample_position, (x, y, z, w) in zip(codes, position, quaternion, strict=True):
        translate_op.Set(Gf.Vec3d(*map(float, sample_position)), float(code))
        orient_op.Set(Gf.Quatf(float(w), float(x), float(y), float(z)), float(code))


def _format_identifier(text: str) -> str:
    """Return a text as a name of USD: letters, digits and underscores."""
    identifier = "".join(c if c.isascii() and c.isalnum() else "_" for c in text)
    return identifier if identifier and not identifier[0].isdigit() else f"_{identifier}"
