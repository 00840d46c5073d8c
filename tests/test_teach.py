# SPDX-License-Identifier: MIT
"""The teach page: the recorder by itself, and the page in a real headless Chromium."""

import numpy as np
import pytest
from pages import come_near, drag, press, says, wait_for

from hybrid_jax.demonstrations.demonstration import check_demonstration, load_demonstration
from hybrid_jax.errors import DemonstrationError
from hybrid_jax.teach.recorder import Recorder


def test_the_recorder_keeps_what_the_arm_did(cell):
    recorder = Recorder(cell, "test arm")
    start = np.array(recorder.tool)
    hand = start.copy()
    recorder.tick(hand)
    recorder.start()
    for i in range(90):
        hand[2] = start[2] - 0.10 * np.clip((i - 10) / 60, 0, 1)
        recorder.closed = i >= 40
        recorder.tick(hand)
    recorder.stop()
    recorder.tick(start)
    demo = recorder.demonstration("down", "a note")
    check_demonstration(demo)
    assert demo.robot == "test arm" and demo.note == "a note"
    assert 60 < len(demo.times) < 90, "the hand's rest before the motion is left out"
    assert demo.poses[-1, 2] == pytest.approx(start[2] - 0.10, abs=2e-3)
    assert demo.gripper[0] == 0 and demo.gripper[-1] == 1
    assert len(recorder.frames()) == 90


def test_nothing_recorded_is_refused_by_a_sentence(cell):
    with pytest.raises(DemonstrationError, match="0 samples; at least 8"):
        check_demonstration(Recorder(cell, "test arm").demonstration("empty"))


@pytest.fixture
def page(cell, tmp_path):
    pytest.importorskip("viser")
    from hybrid_jax.teach.page import TeachPage

    opened = TeachPage(cell, tmp_path / "skills", "test arm", port=8123)
    yield opened
    opened.close()


def enter(name, page, text):
    """Type a name and wait until the page's server has it."""
    name.clear()
    name.send_keys(text)
    wait_for(lambda: page._name.value == text)


def test_a_skill_is_dragged_recorded_saved_and_there_after_a_reload(browser, page):
    browser.get(page.address)
    says(browser, "Drag the handle")
    wait_for(lambda: list(page.server.get_clients().values()))
    began = np.array(page.handle.position)
    come_near(page, began)
    press(browser, "Record")
    says(browser, "Recording.")
    drag(browser, page, page.handle, 0.225, 0.15)
    wait_for(lambda: began[2] - page.handle.position[2] > 0.05)
    wait_for(lambda: abs(page.recorder.tool[2] - page.handle.position[2]) < 5e-3)
    press(browser, "Stop")
    says(browser, "samples recorded")
    name = browser.find_element("xpath", "//input[@value='skill']")
    enter(name, page, "../out")
    press(browser, "Save")
    says(browser, "is no name for a demonstration")
    enter(name, page, "my_skill")
    press(browser, "Save")
    says(browser, "Saved 'my_skill'")
    moved = np.array(page.handle.position) - began
    demo = load_demonstration(page.library / "my_skill.npz")
    np.testing.assert_allclose(demo.poses[-1, :3] - demo.poses[0, :3], moved, atol=0.01)
    press(browser, "Replay")
    says(browser, "Replaying")
    browser.refresh()
    says(browser, "Show saved")
    assert page.library.joinpath("my_skill.npz").is_file()
    wait_for(lambda: browser.find_elements("xpath", "//input[@value='my_skill']"))
    press(browser, "Show saved")
    says(browser, "my_skill:")
