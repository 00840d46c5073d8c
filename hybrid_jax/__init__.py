# SPDX-License-Identifier: MIT
"""Hybrid robot learning for motion planning in manufacturing work cells, on JAX."""

import ctypes.util as _ctypes_util
import os as _os
import sys as _sys

if "MUJOCO_GL" not in _os.environ and _sys.platform == "linux" and not _os.environ.get("DISPLAY"):
    # MuJoCo picks its off-screen renderer when it is first imported
    _found = [name for name in ("EGL", "OSMesa") if _ctypes_util.find_library(name)]
    if _found:
        _os.environ["MUJOCO_GL"] = _found[0].lower()

__version__ = "0.1.0"
