# SPDX-License-Identifier: MIT
"""Which programs are being made, and how long they took last time: what somebody waits for."""

import contextlib
import time
from collections.abc import Iterator
from pathlib import Path

from hybrid_jax.runtime.compile_cache import cache_folder
from hybrid_jax.runtime.program_files import LIST, add_to_list

WORTH_SAYING = 1.0
"""Time that a program may take before it is said what is waited for [s]."""

_since: dict[str, float] = {}
"""Programs that are being made, and since when."""


@contextlib.contextmanager
def making(name: str) -> Iterator[None]:
    """Context in which a program is made; its duration is kept, where it is worth waiting for."""
    _since[name] = began = time.monotonic()
    try:
        yield
    finally:
        _since.pop(name, None)
        if time.monotonic() - began > WORTH_SAYING:
            note_duration(name, time.monotonic() - began)


def being_made() -> str:
    """Which programs are being made and for how long, as words; empty if there is none.

    It says how long a program took last time, where that is known.
    """
    words, time_now = [], time.monotonic()
    for name, began in list(_since.items()):
        if time_now - began > WORTH_SAYING:
            last = last_duration(name)
            usual = f" of {last:.0f} last time" if last else ""
            words.append(f"{name.strip('_')} for {time_now - began:.0f} s{usual}")
    return f"compiling {' and '.join(words)}" if words else ""


def _durations_file() -> Path | None:
    folder = cache_folder()
    return folder and folder / "programs" / f"durations{LIST}"


def note_duration(name: str, seconds: float) -> None:
    """Note how long a program took to make [s]."""
    path = _durations_file()
    if path:
        add_to_list(path, f"{name} {seconds:.1f}")


def last_duration(name: str) -> float | None:
    """How long a program of that name took to make last time [s]; None if that is not known."""
    path = _durations_file()
    try:
        lines = path.read_text().splitlines() if path else []
        return next(float(row.split()[1]) for row in reversed(lines) if row.split()[0] == name)
    except (OSError, ValueError, IndexError, StopIteration):
        return None
