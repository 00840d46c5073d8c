# SPDX-License-Identifier: MIT
"""The picture of the view page in the documentation, taken in a headless Chromium.

python -m benchmarks.page_picture --run DIR --out docs/pictures/view.png
"""

import time
from pathlib import Path

import tyro

from benchmarks.browsing import browser
from hybrid_jax.runs.run_folder import open_run
from hybrid_jax.view.page import ViewPage

NOTICE = "document.querySelectorAll('.mantine-Notification-root').forEach(n => n.remove())"
"""Removes the browser's remark that it draws in software."""


def main(run: Path, out: Path, at: float = 6.0) -> None:
    """Plan the first object's task and take a picture of its playback.

    Args:
        run: folder of a trained run.
        out: PNG to write.
        at: moment of the plan [s].
    """
    page = ViewPage(open_run(run), port=8400)
    try:
        with browser() as shown:
            shown.get(page.address)
            page.status.content = page.plan()
            page.task.hide(True)
            page.playback.at.value = at
            time.sleep(5.0)  # software rendering takes its time
            shown.execute_script(NOTICE)
            time.sleep(1.0)
            shown.save_screenshot(str(out))
    finally:
        page.close()


if __name__ == "__main__":
    tyro.cli(main)
