# SPDX-License-Identifier: MIT
"""The picture of the view page in the documentation, taken in a headless Chromium.

python -m benchmarks.page_picture --run DIR --out docs/pictures/view.png
"""

import shutil
import time
from pathlib import Path

import tyro
from selenium import webdriver

from hybrid_jax.runfolder import open_run
from hybrid_jax.view.page import ViewPage

FLAGS = (
    "--headless=new", "--no-sandbox", "--window-size=1300,840", "--use-angle=swiftshader",
    "--enable-unsafe-swiftshader", "--disable-dev-shm-usage",
)  # fmt: skip
NOTICE = "document.querySelectorAll('.mantine-Notification-root').forEach(n => n.remove())"
"""Removes the browser's remark that it draws in software."""


def main(run: Path, out: Path, at: float = 6.0) -> None:
    """Plan the first object's task and take a picture of its playback.

    Args:
        run: folder of a trained run.
        out: PNG to write.
        at: moment of the plan [s].
    """
    page, options = ViewPage(open_run(run), port=8400), webdriver.ChromeOptions()
    options.binary_location = shutil.which("chromium") or ""
    for flag in FLAGS:
        options.add_argument(flag)
    service = webdriver.ChromeService(executable_path=shutil.which("chromedriver"))
    browser = webdriver.Chrome(options=options, service=service)
    try:
        browser.get(page.address)
        page.status.content = page.plan()
        page.task.hide(True)
        page.playback.at.value = at
        time.sleep(5.0)  # software rendering takes its time
        browser.execute_script(NOTICE)
        time.sleep(1.0)
        browser.save_screenshot(str(out))
    finally:
        browser.quit()
        page.close()


if __name__ == "__main__":
    tyro.cli(main)
