# SPDX-License-Identifier: MIT
"""What all pages have in common: server, status line, a steady loop beside the buttons, an end."""

import contextlib
import threading
import time
import traceback
from collections.abc import Callable

from hybrid_jax.errors import HybridJaxError, shortened
from hybrid_jax.terminal import remark
from hybrid_jax.webserver import address_of, close_server, open_server


class WebPage:
    """A page; those that derive from it fill it, set `status`, and call `start`."""

    def __init__(self, host: str, port: int, label: str, rate: float):
        """Open the server.

        Args:
            host: address to listen at.
            port: the first one that is tried.
            label: title of the page.
            rate: times that `tick` is called in a second.
        """
        self.server = open_server(host, port, label)
        self.status = self.server.gui.add_markdown("")
        self._lock, self._closing = threading.Lock(), threading.Event()
        self._rate = rate
        self._thread = threading.Thread(target=self._run, daemon=True)

    @property
    def address(self) -> str:
        """Where a browser finds the page."""
        return address_of(self.server)

    def start(self) -> None:
        """Begin to call `tick`."""
        self._thread.start()

    def tick(self) -> None:
        """What is done steadily."""
        raise NotImplementedError

    def close(self) -> None:
        """Stop, and take the page down."""
        self._closing.set()
        self._thread.join()
        close_server(self.server)

    def guarded(self, action: Callable[[], str]) -> None:
        """Run a button's action; what goes wrong is said on the page and nothing is lost."""
        try:
            with self._lock:
                self.status.content = action()
        except Exception as error:  # noqa: BLE001 what a browser sends may be anything
            self.status.content = f"**Not done:** {_sentence(error)}"

    def unlocked(self, action: Callable[[], str]) -> None:
        """The same for an action that takes long: other buttons need not wait for it."""
        try:
            self.status.content = action()
        except Exception as error:  # noqa: BLE001
            self.status.content = f"**Not done:** {_sentence(error)}"

    def _run(self) -> None:
        due = time.monotonic()
        while not self._closing.is_set():
            try:
                self.tick()
            except Exception as error:  # noqa: BLE001 the page goes on with its next tick
                self.status.content = f"**Not moved:** {_sentence(error)}"
            due = max(due + 1 / self._rate, time.monotonic())
            time.sleep(max(0.0, due - time.monotonic()))


def _sentence(error: Exception) -> str:
    """What went wrong, for the page; what was not foreseen goes to the terminal as well."""
    if isinstance(error, HybridJaxError | OSError):
        return shortened(str(error))
    remark("".join(traceback.format_exception(error)))
    return f"a defect of hybrid_jax ({shortened(repr(error))}); the terminal says more"


def serve(page: WebPage) -> None:
    """Say where a page is, and wait for Ctrl-C."""
    remark(f"open {page.address} in a browser; Ctrl-C ends it")
    with contextlib.suppress(KeyboardInterrupt):
        while True:
            time.sleep(1.0)
    page.close()
