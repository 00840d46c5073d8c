# SPDX-License-Identifier: MIT
"""Keep what dependencies print without need off the user's terminal."""

import contextlib
import io
import re
import sys
import threading
from collections.abc import Iterator

import mujoco

_HARMLESS = re.compile("Attaching a spec with an empty prefix")

_one_at_a_time = threading.RLock()
"""MuJoCo has one handler of warnings for all threads, and its compiler is one at a time too."""
_said: set[tuple[str, str]] = set()
"""Names of models and warnings: each is printed once, however often a model is read."""


def import_mjx() -> None:
    """Import `mujoco.mjx` (and what brax takes of it) without its two lines about warp."""
    if "mujoco.mjx" not in sys.modules:
        with contextlib.redirect_stdout(io.StringIO()), contextlib.redirect_stderr(io.StringIO()):
            import mujoco.mjx  # noqa: F401, PLC0415


@contextlib.contextmanager
def engine_messages(name: str) -> Iterator[None]:
    """Print MuJoCo's warnings with the name of the cell they are about; drop the harmless ones."""
    heard = []
    with _one_at_a_time:
        mujoco.set_mju_user_warning(heard.append)
        try:
            yield
        finally:
            mujoco.set_mju_user_warning(None)
        for text in heard:
            if not _HARMLESS.match(text) and (name, text) not in _said:
                _said.add((name, text))
                print(f"MuJoCo on {name}: {text}", file=sys.stderr)
