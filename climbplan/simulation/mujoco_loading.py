"""The package `mujoco`, an extra."""

from __future__ import annotations

import os
from ctypes.util import find_library
from importlib import import_module
from types import ModuleType

from climbplan.errors import MissingSolver


def load_mujoco(purpose: str = "simulation", extra: str = "simulate") -> ModuleType:
    """Return the package `mujoco`.

    Without a display it is told to draw off screen, which it wants to know before it is loaded; a
    choice that the environment names (MUJOCO_GL) stands.

    Args:
        purpose: What needs it, for the error.
        extra: The extra of climbplan that installs what the purpose needs.

    Raises:
        MissingSolver: It is not installed.
    """
    if not {"MUJOCO_GL", "DISPLAY", "WAYLAND_DISPLAY"} & set(os.environ):
        for library, backend in (("EGL", "egl"), ("OSMesa", "osmesa")):
            if find_library(library) is not None:
                os.environ["MUJOCO_GL"] = backend
                break
    try:
        return import_module("mujoco")
    except ImportError as error:
        raise MissingSolver(f"{purpose} needs MuJoCo: pip install 'climbplan[{extra}]'") from error
