# SPDX-License-Identifier: MIT
"""Progress on the terminal: stage, steps, rate, time left."""

import sys
import time


class Progress:
    """Prints one line that is rewritten on a terminal, and a line now and then elsewhere."""

    def __init__(self, stage: str, unit: str, quiet: bool = False):
        self.stage, self.unit, self.quiet = stage, unit, quiet
        self.began = self.printed = time.monotonic()
        self.first: tuple[float, int] | None = None
        self.live = sys.stdout.isatty()

    def __call__(self, done: int, total: int, note: str = "") -> None:
        """Report `done` of `total` units."""
        now = time.monotonic()
        if self.first is None:  # the rate leaves out compilation
            self.first = (now, done)
        last = done >= total
        if self.quiet or (now - self.printed < (0.2 if self.live else 10.0) and not last):
            return
        self.printed = now
        since, before = self.first
        rate = (done - before) / (now - since) if done > before and now > since else 0.0
        left = f"{(total - done) / rate:.0f} s left" if rate > 0 else "compiling"
        ending = f"{now - self.began:.0f} s" if last else left
        text = f"{self.stage:7s} {done:>9,}/{total:,} {self.unit}  {rate:,.0f}/s  {ending}  {note}"
        if self.live:
            print(f"\r{text[:118]:<118}", end="\n" if last else "", flush=True)
        else:
            print(text, flush=True)
