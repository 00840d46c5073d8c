# SPDX-License-Identifier: MIT
"""Keep what dependencies print while they are imported off the user's terminal."""

import contextlib
import io
import sys


def import_mjx() -> None:
    """Import `mujoco.mjx` (and what brax takes of it) without its two lines about warp."""
    if "mujoco.mjx" not in sys.modules:
        with contextlib.redirect_stdout(io.StringIO()), contextlib.redirect_stderr(io.StringIO()):
            import mujoco.mjx  # noqa: F401, PLC0415
