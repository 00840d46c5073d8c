# SPDX-License-Identifier: MIT
"""Progress on the terminal: stage, steps, rate, time left. It goes to stderr."""

import contextlib
import sys
import threading
import time
from collections.abc import Callable, Iterator

LIVE, DEAD = 0.2, 10.0
"""Time between two lines: on a terminal, where one overwrites the other, and elsewhere [s]."""


class Progress:
    """Progress line of a stage: overwritten on a terminal, printed now and then elsewhere."""

    def __init__(self, stage: str, unit: str, quiet: bool = False):
        self.stage, self.unit, self.quiet = stage, unit, quiet
        self.began = self.printed = time.monotonic()
        self.first: tuple[float, int] | None = None
        self.live = sys.stderr.isatty()

    def __call__(self, done: int, total: int, note: str = "") -> None:
        """Report `done` of `total` units."""
        time_now = time.monotonic()
        if self.first is None:  # the rate counts from the first report, without compilation
            self.first = (time_now, done)
        finished = done >= total
        if self.quiet or (time_now - self.printed < (LIVE if self.live else DEAD) and not finished):
            return
        self.printed = time_now
        first_time, first_done = self.first
        rate = (
            (done - first_done) / (time_now - first_time)
            if done > first_done and time_now > first_time
            else 0.0
        )
        elapsed = f"{time_now - self.began:.0f} s"
        if finished or rate == 0:  # without a rate there is no time left to state
            timing = elapsed if finished else f"{elapsed} so far"
        else:
            speed = f"{rate:,.0f}/s" if rate >= 10 else f"{rate:.2g}/s"
            timing = f"{speed}  {(total - done) / rate:.0f} s left"
        text = f"{self.stage:8s} {done:>9,}/{total:,} {self.unit}  {timing}  {note}"
        _write(text.rstrip(), self.live, finished)


@contextlib.contextmanager
def working(
    stage: str, what: str, quiet: bool = False, waits_for: Callable[[], str] = str
) -> Iterator[None]:
    """Context that shows the time elapsed so far of work whose duration is unknown.

    Args:
        stage: first word of the line.
        what: is being done.
        quiet: show nothing.
        waits_for: says what is waited for at the moment; nothing if empty.
    """
    began, live, quit_event = time.monotonic(), sys.stderr.isatty(), threading.Event()

    def tell():
        while not quit_event.wait(LIVE if live else DEAD):
            elapsed = f"{stage:8s} {what}, {time.monotonic() - began:.0f} s"
            _write("; ".join(filter(None, [elapsed, waits_for()])), live, False)

    teller = threading.Thread(target=tell, daemon=True)
    if not quiet:
        teller.start()
    try:
        yield
    finally:
        quit_event.set()
        if not quiet:
            teller.join()
            _write(f"{stage:8s} {what}, {time.monotonic() - began:.1f} s", live, True)


def _write(text: str, live: bool, finished: bool) -> None:
    if live:
        print(f"\r{text[:118]:<118}", end="\n" if finished else "", file=sys.stderr, flush=True)
    else:
        print(text, file=sys.stderr, flush=True)
