# SPDX-License-Identifier: MIT
"""Keeps needless messages of dependencies off the user's terminal."""

import contextlib
import io
import re
import sys
import threading
from collections.abc import Iterator

import mujoco

_HARMLESS = re.compile("Attaching a spec with an empty prefix")

_one_at_a_time = threading.RLock()
"""MuJoCo has one handler of warnings for all threads, so only one thread may set it at a time."""
_said: set[tuple[str, str]] = set()
"""Models and warnings that were printed: each is printed once, however often a model is read."""


def import_mjx() -> None:
    """Import `mujoco.mjx`, which brax needs too, without its two lines about warp."""
    if "mujoco.mjx" not in sys.modules:
        with contextlib.redirect_stdout(io.StringIO()), contextlib.redirect_stderr(io.StringIO()):
            import mujoco.mjx  # noqa: F401


@contextlib.contextmanager
def engine_messages(name: str) -> Iterator[None]:
    """Context that prints MuJoCo's warnings with the name of their cell, without harmless ones."""
    messages = []
    with _one_at_a_time:
        mujoco.set_mju_user_warning(messages.append)
        try:
            yield
        finally:
            mujoco.set_mju_user_warning(None)
        for text in messages:
            if not _HARMLESS.match(text) and (name, text) not in _said:
                _said.add((name, text))
                print(f"MuJoCo on {name}: {text}", file=sys.stderr)
