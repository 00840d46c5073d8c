# SPDX-License-Identifier: MIT
"""The view page: its parts by themselves, and the page in a real headless Chromium."""

import threading
import urllib.request

import jax.numpy as jnp
import mujoco
import numpy as np
import pytest
from pages import choose, come_near, drag, open_tab, press, says, wait_for

from hybrid_jax.contracts import PlanResult
from hybrid_jax.errors import InputError, TaskError, WorkcellError
from hybrid_jax.feasibility.evaluation import Reason
from hybrid_jax.kernels.collision.clearance import clearance
from hybrid_jax.planner.phase_scenes import in_scene, phase_scene, segment_kinds
from hybrid_jax.runs.run_folder import create_run, open_run
from hybrid_jax.tasks.registry import read_task
from hybrid_jax.tasks.task import as_rows
from hybrid_jax.types import Status
from hybrid_jax.web.server import is_own, open_server
from hybrid_jax.workcell.assets import robots_folder

pytest.importorskip("viser")

from hybrid_jax.view import curves, map_cloud
from hybrid_jax.view.motion import motion_of  # noqa: E402
from hybrid_jax.view.page import ViewPage  # noqa: E402
from hybrid_jax.view.robot_look import arm_bodies


def test_frames_show_what_the_plan_does(cell, planned):
    """Against C MuJoCo: the tool, and the held object that moves with it into its tray."""
    task, plan = planned
    motion = motion_of(cell, task, plan)
    assert (np.diff(motion.times) > 0).all()
    data, index = mujoco.MjData(cell.model), cell.source.layout.object_names.index(task.object_name)
    address = cell.source.layout.object_qpos[index]
    site = cell.source.layout.tool_site
    for frame in range(0, len(motion.times), 25):
        data.qpos[:] = motion.qpos[frame]
        mujoco.mj_kinematics(cell.model, data)
        np.testing.assert_allclose(data.site_xpos[site], motion.tools[frame], atol=1e-5)
    first, last = motion.qpos[0][address : address + 3], motion.qpos[-1][address : address + 3]
    np.testing.assert_allclose(first, task.object_poses[index][:3], atol=1e-6)
    tray = cell.source.task.object(task.object_name).tray
    assert np.abs(last[:2] - cell.model.body(tray).pos[:2]).max() < 0.2
    kinds = segment_kinds(task)
    inside = in_scene(cell, phase_scene(cell, task, int(kinds[0])))
    q = jnp.asarray(motion.qpos[0][list(cell.source.layout.qpos)], jnp.float32)
    assert motion.clearances[0] == pytest.approx(float(clearance(inside, q)), abs=1e-5)


def test_the_cloud_shows_what_is_chosen():
    rng = np.random.default_rng(0)
    reason = rng.integers(0, len(Reason), (4, 3, 2, 5)).astype(np.uint8)
    fmap = type("Map", (), {"reason": reason, "lower": np.zeros(3), "spacing": 0.1})()
    points, shares = map_cloud.centres(fmap), map_cloud.voxel_shares(fmap, None)
    np.testing.assert_allclose(shares.sum(axis=-1), 1.0)
    every, share = map_cloud.chosen_points(shares, points, None, None, 0.0)
    assert len(every) == 24
    expected = (reason == Reason.FEASIBLE).mean(axis=-1).ravel()
    np.testing.assert_allclose(share, expected)
    kind = int(Reason.UNREACHABLE)
    some, share = map_cloud.chosen_points(shares, points, kind, 0, 0.22)
    assert np.allclose(some[:, 0], 0.2) and (share > 0).all()
    assert len(some) == int((reason[2] == kind).any(axis=-1).sum())
    one = map_cloud.voxel_shares(fmap, 3)
    np.testing.assert_array_equal(one.argmax(axis=-1), reason[..., 3])


@pytest.mark.parametrize(
    "origin, host, local, own",
    [
        (None, "127.0.0.1:8080", True, True),
        ("http://127.0.0.1:8080", "127.0.0.1:8080", True, True),
        ("http://localhost:8080", "localhost:8080", True, True),
        ("http://localhost:3000", "localhost:8080", True, False),
        ("https://evil.example", "127.0.0.1:8080", True, False),
        ("http://evil.example:8080", "evil.example:8080", True, False),
        ("http://robot.plant:8080", "robot.plant:8080", False, True),
        ("http://evil.example", "robot.plant:8080", False, False),
        ("null", "127.0.0.1:8080", True, False),
        ("http://127.0.0.1:8080", "[", True, False),
        ("http://[", "127.0.0.1:8080", True, False),
    ],
)
def test_origins(origin, host, local, own):
    assert is_own(origin, host, local) == own


@pytest.fixture(scope="module")
def page(smoke_run):
    look = robots_folder() / "kinova_gen3_2f85" / "kinova_gen3_2f85.xml"
    opened = ViewPage(open_run(smoke_run), port=8223, look=look)
    yield opened
    opened.close()


def test_the_page_refuses_foreign_origins(page):
    for origin, code in (("http://evil.example", 403), (page.address, 200)):
        request = urllib.request.Request(page.address, headers={"Origin": origin})
        try:
            found = urllib.request.urlopen(request).status
        except urllib.error.HTTPError as error:
            found = error.code
        assert found == code
    websockets = pytest.importorskip("websockets.sync.client")
    with pytest.raises(Exception, match="403"):
        websockets.connect(page.address.replace("http", "ws"), origin="http://evil.example")


def test_the_look_stands_where_the_arm_stands(page):
    """The same model as cell and as look: every body that both have is at the same place."""
    cell, look = page.run.cell, page._look
    qpos = np.array(cell.model.key_qpos[0])
    qpos[list(cell.source.layout.qpos)] += 0.3
    look.show(qpos)
    data = mujoco.MjData(cell.model)
    data.qpos[:] = qpos
    mujoco.mj_kinematics(cell.model, data)
    root = look._scene.root
    assert len(arm_bodies(cell)) == len(cell.joint_names) + 1
    for own, joint in zip(cell.source.layout.joints, look._joints, strict=True):
        body, theirs = cell.model.jnt_bodyid[own], look._model.jnt_bodyid[joint]
        turned = np.zeros(3)
        mujoco.mju_rotVecQuat(turned, look._scene._data.xpos[theirs], np.array(root.wxyz, float))
        np.testing.assert_allclose(turned + root.position, data.xpos[body], atol=1e-6)


def test_a_look_of_another_arm_is_refused(page, tmp_path):
    from hybrid_jax.view.robot_look import RobotLook

    body = "<body><joint type='hinge'/><geom size='0.1'/></body>"
    (tmp_path / "one.xml").write_text(f"<mujoco><worldbody>{body}</worldbody></mujoco>")
    with pytest.raises(WorkcellError, match="has 1 hinge joints"):
        RobotLook(page.server, page.run.cell, tmp_path / "one.xml")


def test_curves_are_those_of_the_run(page):
    steps, values = curves.curve_of(page.run, "lfd", "reward")
    rows = page.run.metrics("lfd")
    assert len(steps) == len(rows) and values[-1] == rows[-1]["reward"]
    assert page.curves >= 3


def test_a_scene_without_room_is_said_and_the_task_stays(page, monkeypatch):
    def no_room(*_):
        raise TaskError("no room for the objects")

    before = page.task.task
    monkeypatch.setattr("hybrid_jax.view.task_panel.sample_scene", no_room)
    page.task.scene.value = 5
    wait_for(lambda: page.status.content == "**Not done:** no room for the objects")
    assert page.task.task is before
    monkeypatch.undo()
    page.task.scene.value = 0
    wait_for(lambda: page.status.content.startswith("Choose an object"))


@pytest.mark.parametrize("value", [-1, float("nan"), 1e308, "abc", None, 2**70])
def test_what_is_no_scene_is_said_on_the_page(page, value):
    before = page.task.task
    page.task.scene.value = 0
    wait_for(lambda: page.status.content.startswith("Choose an object"))
    page.task.scene._impl.value = value  # as a browser sends it
    page.guarded(page.task.reset)
    assert "the scene must be a whole number" in page.status.content
    assert page.task.task.object_name == before.object_name
    page.task.scene._impl.value = 0
    page.guarded(page.task.reset)


@pytest.mark.parametrize("field, value", [("position", (np.nan, 0, 0)), ("wxyz", (0, 0, 0, 0))])
def test_a_key_pose_that_is_no_place_is_put_back(page, field, value):
    page.guarded(page.task.reset)
    before = page.task.task
    setattr(page.task._handles[1], field, value)
    page.guarded(page.task._dragged)
    assert "key pose 2 was dragged to" in page.status.content
    assert page.task.task is before
    rows = as_rows(before.key_poses[before.given])
    np.testing.assert_allclose(page.task._handles[1].position, rows[1][:3], atol=1e-6)


@pytest.mark.parametrize(
    "name", ["../x.json", "/tmp/x.json", "a/b.json", "x\0.json", ".json", "x.txt", "", "..json"]
)
def test_tasks_are_saved_in_one_folder_only(page, name):
    page.guarded(lambda: page.task.save(page.run.path("tasks"), name))
    assert "is no name for a task file" in page.status.content
    page.guarded(lambda: page.task.save(page.run.path("tasks"), "twice.json"))
    assert "Saved" in page.status.content or "there already" in page.status.content
    page.guarded(lambda: page.task.save(page.run.path("tasks"), "twice.json"))
    assert "is there already" in page.status.content


def test_while_a_plan_is_made_presses_are_ignored_and_other_buttons_work(page, monkeypatch):
    begun, go_on, calls = threading.Event(), threading.Event(), []

    def slow(*_, **__):
        calls.append(1)
        begun.set()
        assert go_on.wait(30)
        return PlanResult(Status.NO_PATH, "none")

    monkeypatch.setattr("hybrid_jax.view.page.plan_motion", slow)
    presses = [threading.Thread(target=page._press_plan) for _ in range(40)]
    presses[0].start()
    assert begun.wait(60)
    for press_again in presses[1:]:
        press_again.start()
        press_again.join(5)
        assert not press_again.is_alive()
    page.guarded(lambda: page.task.save(page.run.path("tasks"), "meanwhile.json"))
    assert page.run.path("tasks").joinpath("meanwhile.json").is_file()
    go_on.set()
    presses[0].join(30)
    assert calls == [1] and page.status.content == "**NO_PATH:** none"


def test_the_page_goes_on_after_an_error(page, monkeypatch):
    def broken():
        raise ValueError("something")

    monkeypatch.setattr(page, "tick", broken)
    wait_for(lambda: page.status.content.startswith("**Not moved:** a defect"))
    monkeypatch.undo()
    assert page._thread.is_alive()


@pytest.mark.parametrize(
    "host, port, words",
    [
        ("127.0.0.1", 70000, "from 1 to 65535"),
        ("127.0.0.1", 0, "from 1 to 65535"),
        ("203.0.113.7", 8300, "cannot listen at '203.0.113.7'"),
    ],
)
def test_addresses_that_cannot_be_listened_at_are_refused(host, port, words):
    with pytest.raises(InputError, match=words):
        open_server(host, port, "test")


def test_a_task_is_built_planned_played_and_saved_in_the_browser(browser, page):
    page.guarded(page.task.reset)
    browser.get(page.address)
    says(browser, "Choose an object")
    wait_for(lambda: list(page.server.get_clients().values()))
    choose(browser, "Object", "block_2")
    wait_for(lambda: page.task.task.object_name == "block_2" and len(page.task._handles) == 4)
    handle = page.task._handles[2]  # above the tray: nothing hides it
    before, began, turn = page.task.task, np.array(handle.position), np.array(handle.wxyz)
    come_near(page, began)
    drag(browser, page, handle, 0.09, -0.05)
    wait_for(lambda: abs(np.linalg.norm(handle.position - began) - 0.05) < 0.01)
    np.testing.assert_allclose(handle.wxyz, turn, atol=1e-6)  # an arrow only shifts
    dragged = lambda: as_rows(page.task.task.key_poses[3:4])[0, :3]  # noqa: E731
    wait_for(lambda: np.allclose(dragged(), handle.position, atol=1e-5))
    assert np.allclose(before.key_poses[1], page.task.task.key_poses[1])
    press(browser, "Plan")
    wait_for(lambda: page.status.content.startswith("**"), 240.0)
    assert page.status.content.startswith("**OK**"), page.status.content
    assert page.playback.motion.clearances.min() > -0.005
    press(browser, "Play")
    wait_for(lambda: page.playback.at.value > 0.5)
    says(browser, "clearance")
    press(browser, "Stop")
    path = page.run.path("tasks") / "mine.json"
    page._name.value = path.name
    press(browser, "Save task")
    wait_for(path.is_file)
    again = read_task(page.run.cell, path)
    np.testing.assert_allclose(again.key_poses[1:-1], page.task.task.key_poses[1:-1], atol=1e-5)


def test_map_skills_and_curves_in_the_browser(browser, page):
    browser.get(page.address)
    open_tab(browser, "Map")
    says(browser, "voxels")
    page.map.shown.value = True
    choose(browser, "Reason", "unreachable")
    wait_for(lambda: page.map.reason.value == "unreachable")
    says(browser, "of the poses: unreachable")
    choose(browser, "Slice", "z")
    says(browser, "z = ")
    open_tab(browser, "Skills")
    name = next(iter(page._skills))
    choose(browser, "Skill", name)
    says(browser, page._skills[name].note)
    open_tab(browser, "Learning")
    wait_for(lambda: len(browser.find_elements("css selector", ".uplot canvas")) >= page.curves)


def test_a_run_without_task_data_is_shown_with_its_objects(tmp_path):
    """The objects are where the model's home has them."""
    (tmp_path / "cell.xml").write_text(
        '<mujoco><worldbody><body name="arm"><joint name="a" axis="0 0 1" range="-90 90"/>'
        '<geom type="capsule" fromto="0 0 0 .4 0 0" size=".03"/><site name="tool" pos=".4 0 0"/>'
        '</body><body name="part" pos=".8 0 .1"><freejoint/><geom size=".02"/></body>'
        "</worldbody></mujoco>"
    )
    run = create_run(str(tmp_path / "cell.xml"), "smoke", 0, tmp_path / "run")
    page = ViewPage(run, port=8290)
    assert "no task data" in page.status.content
    page.server.stop()
