# SPDX-License-Identifier: MIT
"""What tests do with a page in a browser."""

import time

import numpy as np
from scipy.spatial.transform import Rotation


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


def camera_of(page):
    """Of the only browser that shows a page."""
    return wait_for(lambda: list(page.server.get_clients().values()))[0].camera


def come_near(page, point):
    """Look at a point of the scene from so near that a handle's arrows and rings lie apart."""
    camera = camera_of(page)
    camera.position, camera.look_at = np.add(point, [0.4, -0.3, 0.1]), np.asarray(point)
    asked = camera.update_timestamp
    wait_for(lambda: camera.update_timestamp > asked)  # the browser has turned to it, ...
    time.sleep(2.0)  # ... and drawn it


def pixel(page, point, size):
    """Where the browser shows a point of the scene, from its camera; x, y from the top left."""
    camera = camera_of(page)
    forward = np.asarray(camera.look_at) - camera.position
    forward /= np.linalg.norm(forward)
    right = np.cross(forward, camera.up_direction)
    right /= np.linalg.norm(right)
    up = np.cross(right, forward)
    away = np.asarray(point) - camera.position
    height = np.tan(camera.fov / 2) * (away @ forward)
    x, y = away @ right / (height * size[0] / size[1]), away @ up / height
    return (1 + x) / 2 * size[0], (1 - y) / 2 * size[1]


def drag(browser, page, handle, grip, distance):
    """Take a handle's arrow along its z axis, `grip` away from its middle, and pull."""
    from selenium.webdriver import ActionChains

    canvas = browser.find_element("tag name", "canvas")
    size = canvas.size["width"], canvas.size["height"]
    middle = np.array(handle.position)
    axis = Rotation.from_quat(handle.wxyz, scalar_first=True).apply([0.0, 0.0, 1.0])
    ends = middle + grip * axis, middle + (grip + distance) * axis
    (x0, y0), (x1, y1) = (pixel(page, p, size) for p in ends)
    chain = ActionChains(browser, duration=60)
    chain.move_to_element_with_offset(canvas, int(x0 - size[0] / 2), int(y0 - size[1] / 2))
    chain.click_and_hold()
    for share in np.linspace(0.05, 1, 20):
        x, y = x0 + share * (x1 - x0), y0 + share * (y1 - y0)
        chain.move_to_element_with_offset(canvas, int(x - size[0] / 2), int(y - size[1] / 2))
    chain.release().perform()
