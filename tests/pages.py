# SPDX-License-Identifier: MIT
"""What tests do with a page in a browser."""

import time


def wait_for(condition, seconds=40.0):
    """The first true value of a condition."""
    until = time.monotonic() + seconds
    while time.monotonic() < until:
        found = condition()
        if found:
            return found
        time.sleep(0.1)
    raise AssertionError("waited in vain")


def press(browser, label):
    """Click the button with this text, once it can be."""
    there = f"//button[.//*[text()='{label}']]"
    found = lambda: [b for b in browser.find_elements("xpath", there) if b.is_enabled()]  # noqa: E731
    wait_for(found)[0].click()


def says(browser, text):
    """Wait until the page shows a text."""
    return wait_for(lambda: text in browser.find_element("tag name", "body").text)


def choose(browser, label, option):
    """Pick an option of the dropdown with this label."""
    found = browser.find_element("xpath", f"//label[text()='{label}']/following::input[1]")
    found.click()
    there = f"//*[@role='option'][.='{option}']"
    wait_for(lambda: browser.find_elements("xpath", there))[0].click()


def open_tab(browser, label):
    """Show a tab."""
    there = f"//*[@role='tab'][@title='{label}']"
    wait_for(lambda: browser.find_elements("xpath", there))[0].click()
