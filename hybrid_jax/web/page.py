# SPDX-License-Identifier: MIT
"""Base of all pages: server, status line, and a loop at a steady rate beside the buttons."""

import contextlib
import threading
import time
import traceback
from collections.abc import Callable

from hybrid_jax.errors import HybridJaxError, shortened
from hybrid_jax.runtime.terminal import remark
from hybrid_jax.web.server import address_of, close_server, open_server


class WebPage:
    """Base class of a page; derived classes add panels, set `status`, and call `start`."""

    def __init__(self, host: str, port: int, label: str, rate: float):
        """Open the server.

        Args:
            host: address to listen at.
            port: the first one that is tried.
            label: title of the page.
            rate: calls of `tick` per second.
        """
        self.server = open_server(host, port, label)
        self.status = self.server.gui.add_markdown("")
        self._lock, self._closing = threading.Lock(), threading.Event()
        self._rate = rate
        self._thread = threading.Thread(target=self._run, daemon=True)

    @property
    def address(self) -> str:
        """Address of the page for a browser."""
        return address_of(self.server)

    def start(self) -> None:
        """Start the loop that calls `tick`."""
        self._thread.start()

    def tick(self) -> None:
        """Do one step of the loop; derived classes define it."""
        raise NotImplementedError

    def close(self) -> None:
        """Stop the loop and the server."""
        self._closing.set()
        self._thread.join()
        close_server(self.server)

    def guarded(self, action: Callable[[], str]) -> None:
        """Run a button's action and show its sentence, or its error; one action at a time."""
        try:
            with self._lock:
                self.status.content = action()
        except Exception as error:
            self.status.content = f"**Not done:** {_sentence(error)}"

    def unlocked(self, action: Callable[[], str]) -> None:
        """Run an action that takes long, as `guarded` does; other buttons need not wait for it."""
        try:
            self.status.content = action()
        except Exception as error:
            self.status.content = f"**Not done:** {_sentence(error)}"

    def _run(self) -> None:
        due = time.monotonic()
        # after a slow tick the next one comes at once, and those that were missed are dropped
        while not self._closing.is_set():
            try:
                self.tick()
            except Exception as error:
                self.status.content = f"**Not moved:** {_sentence(error)}"
            due = max(due + 1 / self._rate, time.monotonic())
            time.sleep(max(0.0, due - time.monotonic()))


def _sentence(error: Exception) -> str:
    """Text of an error for the page; unexpected errors are printed on the terminal as well."""
    if isinstance(error, HybridJaxError | OSError):
        return shortened(str(error))
    remark("".join(traceback.format_exception(error)))
    return f"a defect of hybrid_jax ({shortened(repr(error))}); the terminal says more"


def serve(page: WebPage) -> None:
    """Print the address of a page, and wait for Ctrl-C."""
    remark(f"open {page.address} in a browser; Ctrl-C ends it")
    with contextlib.suppress(KeyboardInterrupt):
        while True:
            time.sleep(1.0)
    page.close()
