# SPDX-License-Identifier: MIT
"""Progress on the terminal: stage, steps, rate, time left. It goes to stderr."""

import contextlib
import sys
import threading
import time
from collections.abc import Iterator

LIVE, DEAD = 0.2, 10.0
"""Time between two lines on a terminal, where one rewrites the other, and elsewhere [s]."""


class Progress:
    """Prints one line that is rewritten on a terminal, and a line now and then elsewhere."""

    def __init__(self, stage: str, unit: str, quiet: bool = False):
        self.stage, self.unit, self.quiet = stage, unit, quiet
        self.began = self.printed = time.monotonic()
        self.first: tuple[float, int] | None = None
        self.live = sys.stderr.isatty()

    def __call__(self, done: int, total: int, note: str = "") -> None:
        """Report `done` of `total` units."""
        now = time.monotonic()
        if self.first is None:  # the rate leaves out compilation
            self.first = (now, done)
        last = done >= total
        if self.quiet or (now - self.printed < (LIVE if self.live else DEAD) and not last):
            return
        self.printed = now
        since, before = self.first
        rate = (done - before) / (now - since) if done > before and now > since else 0.0
        took = f"{now - self.began:.0f} s"
        if last or rate == 0:  # nobody knows how long what has not begun to count will take
            told = took if last else f"{took} so far"
        else:
            speed = f"{rate:,.0f}/s" if rate >= 10 else f"{rate:.2g}/s"
            told = f"{speed}  {(total - done) / rate:.0f} s left"
        text = f"{self.stage:7s} {done:>9,}/{total:,} {self.unit}  {told}  {note}"
        _write(text.rstrip(), self.live, last)


@contextlib.contextmanager
def working(stage: str, what: str, quiet: bool = False) -> Iterator[None]:
    """Say how long something has gone on of which nobody knows how long it takes."""
    began, live, over = time.monotonic(), sys.stderr.isatty(), threading.Event()

    def tell():
        while not over.wait(LIVE if live else DEAD):
            _write(f"{stage:7s} {what}, {time.monotonic() - began:.0f} s", live, False)

    teller = threading.Thread(target=tell, daemon=True)
    if not quiet:
        teller.start()
    try:
        yield
    finally:
        over.set()
        if not quiet:
            teller.join()
            _write(f"{stage:7s} {what}, {time.monotonic() - began:.1f} s", live, True)


def _write(text: str, live: bool, last: bool) -> None:
    if live:
        print(f"\r{text[:118]:<118}", end="\n" if last else "", file=sys.stderr, flush=True)
    else:
        print(text, file=sys.stderr, flush=True)
