# SPDX-License-Identifier: MIT
"""From a fresh clone to a planned motion on the screen, by the README's two commands.

    python -m benchmarks.newcomer --json FILE

What is committed is cloned into a temporary folder; caches of packages and of compiled programs
are empty. The second command's page is opened in a headless Chromium, `Plan` is pressed, and the
time ends when the playback has begun to move. Some ten minutes on two cores.
"""

import contextlib
import os
import re
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path

import tyro

from benchmarks.browsing import browser
from benchmarks.report import metric, write
from hybrid_jax.types import Status

ROOT = Path(__file__).resolve().parents[1]
OK = "OK after"
"""What the page's status line begins with once a plan has been made, ..."""
ENDED = (OK, *(f"{status.name}:" for status in Status))
"""... or, the others, not."""


def wait_for(condition, seconds: float):
    """The first true value of a condition.

    Raises:
        TimeoutError: it never came.
    """
    until = time.monotonic() + seconds
    while time.monotonic() < until:
        if found := condition():
            return found
        time.sleep(0.1)
    raise TimeoutError(f"nothing came within {seconds:.0f} s")


def press(shown, label: str) -> None:
    """Click a button of the page once it can be."""
    there = f"//button[.//*[text()='{label}']]"
    wait_for(lambda: [b for b in shown.find_elements("xpath", there) if b.is_enabled()], 60.0)
    shown.find_element("xpath", there).click()


@contextlib.contextmanager
def page_of(command: list[str], cwd: Path, env: dict[str, str]) -> Iterator[str]:
    """Context in which a command shows its page; gives the page's address."""
    page = subprocess.Popen(command, cwd=cwd, env=env, stderr=subprocess.PIPE, text=True)
    try:
        yield next(found[0] for line in page.stderr if (found := re.search(r"http\S+", line)))
    finally:
        page.terminate()
        page.wait()


def plan_in_browser(address: str) -> tuple[str, float]:
    """Open the page, plan the task that it begins with, let it move.

    Returns:
        The status line, and seconds from `Plan` until the arm moves or the page says why not.
    """
    with browser() as shown:
        text = lambda: shown.find_element("tag name", "body").text  # noqa: E731
        shown.get(address)
        wait_for(lambda: "Choose an object" in text(), 60.0)
        began = time.monotonic()
        press(shown, "Plan")
        said = lambda: [line for line in text().splitlines() if line.startswith(ENDED)]  # noqa: E731
        told = wait_for(said, 600.0)[0]
        if told.startswith(OK):
            press(shown, "Play")
            wait_for(lambda: "Stop" in text(), 60.0)
        return told, time.monotonic() - began


def follow_readme(place: Path, tiny: bool) -> tuple[dict[str, float], str]:
    """Seconds of each step, and what the page said.

    Args:
        place: empty folder.
        tiny: install nothing, train with preset `smoke`, use the caches that are there.
    """
    python = sys.executable if tiny else ".venv/bin/python"
    train = [python, "-m", "hybrid_jax.train", "--preset", "smoke"] if tiny else ["make", "train"]
    clone, seconds = place / "hybrid_jax", {}
    kept = {k: v for k, v in os.environ.items() if k != "JAX_COMPILATION_CACHE_DIR"}
    env = dict(os.environ) if tiny else kept | {"XDG_CACHE_HOME": str(place / "cache")}
    began = time.monotonic()
    subprocess.run(["git", "clone", "--quiet", str(ROOT), str(clone)], check=True)
    subprocess.run(train, cwd=clone, env=env, check=True)
    seconds["train"] = time.monotonic() - began
    command = [python, "-m", "hybrid_jax.view", "--run", "runs/gen3_handling-001"]
    with page_of(command, clone, env) as address:
        seconds["page"] = time.monotonic() - began - seconds["train"]
        told, _ = plan_in_browser(address)
    seconds["all"] = time.monotonic() - began
    return seconds, told


def main(json: Path | None = None, tiny: bool = False) -> None:
    """Print how long it takes.

    Args:
        json: file to write the figures to.
        tiny: as little of everything as shows that it runs.
    """
    with tempfile.TemporaryDirectory() as place:
        seconds, told = follow_readme(Path(place), tiny)
    print(told)
    note = f"make train {seconds['train']:.0f}, page {seconds['page']:.0f}, then planning; {told}"
    write([metric("newcomer.seconds", seconds["all"], "s", "lower", note)], json)


if __name__ == "__main__":
    tyro.cli(main)
