# SPDX-License-Identifier: MIT
"""A headless Chromium that draws in software."""

import contextlib
import shutil
from collections.abc import Iterator

from selenium import webdriver

FLAGS = (
    "--headless=new",
    "--no-sandbox",
    "--window-size=1300,840",
    "--use-angle=swiftshader",
    "--enable-unsafe-swiftshader",
    "--disable-dev-shm-usage",
)


@contextlib.contextmanager
def browser() -> Iterator[webdriver.Chrome]:
    """Chromium, which is closed at the end; `chromium` and `chromedriver` must be on the path."""
    options = webdriver.ChromeOptions()
    options.binary_location = shutil.which("chromium") or ""
    for flag in FLAGS:
        options.add_argument(flag)
    service = webdriver.ChromeService(executable_path=shutil.which("chromedriver"))
    opened = webdriver.Chrome(options=options, service=service)
    try:
        yield opened
    finally:
        opened.quit()
