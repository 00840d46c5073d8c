# SPDX-License-Identifier: MIT
"""Recordings: what is read, what is refused and how it is said, what a damaged file costs."""

import dataclasses
import pickle

import numpy as np
import pytest
from recordings import broken, recording
from scipy.spatial.transform import RigidTransform, Rotation

from hybrid_jax.demonstrations import filtering, splitting
from hybrid_jax.demonstrations.demonstration import (
    Demonstration,
    check_demonstration,
    load_demonstration,
    load_demonstrations,
    save_demonstration,
)
from hybrid_jax.demonstrations.importing import read_recording
from hybrid_jax.errors import DemonstrationError, RunFolderError
from hybrid_jax.skills.library import build_library
from hybrid_jax.workcell.assets import demonstrations_folder


@pytest.mark.parametrize(
    ("demo", "said"),
    [
        (broken(poses=((17, 1), np.nan)), r"row 17: y is nan"),
        (broken(poses=((9, 3), 2.0)), r"row 9: the quaternion has length"),
        (broken(times=(30, 0.5)), r"row 30: time 0.5 s does not come after"),
        (broken(times=(slice(40, None), np.linspace(5, 6, 20))), r"row 40: .* a gap"),
        (broken(poses=((slice(25, None), 0), 0.9)), r"row 25: lies .* from the sample before"),
        (broken(gripper=(3, 7.0)), r"row 3: gripper is 7"),
        (broken(poses=(slice(None), recording().poses[0])), r"does not move"),
        (dataclasses.replace(recording(), frame="camera"), r"frame 'camera', wanted 'base'"),
        (dataclasses.replace(recording(), name="../lift"), r"no name"),
        (recording(count=5), r"5 samples; at least 8"),
        (dataclasses.replace(recording(), gripper=np.zeros(3)), r"gripper must have shape \(60,\)"),
    ],
)
def test_bad_recordings_are_refused_with_the_row(demo, said):
    with pytest.raises(DemonstrationError, match=said):
        check_demonstration(demo)


def test_a_library_keeps_what_it_was_given(tmp_path):
    demo = dataclasses.replace(recording(), note="straight up")
    again = load_demonstration(save_demonstration(tmp_path, demo))
    assert (again.name, again.robot, again.note) == ("lift", "test arm", "straight up")
    np.testing.assert_allclose(again.poses, demo.poses, atol=1e-6)


def test_a_damaged_file_costs_that_file_only(tmp_path):
    for name in ("a", "b", "c"):
        save_demonstration(tmp_path, recording(name))
    before = (tmp_path / "b.npz").read_bytes()
    (tmp_path / "b.npz").write_bytes(before[: len(before) // 2])
    (tmp_path / "d.npz").write_bytes(pickle.dumps({"poses": [1, 2, 3]}))
    with pytest.warns(UserWarning, match="left out") as warned:
        demos = load_demonstrations(tmp_path)
    said = [str(w.message) for w in warned if "left out" in str(w.message)]
    assert [d.name for d in demos] == ["a", "c"]
    assert len(said) == 2 and "b.npz" in said[0] and "d.npz" in said[1]
    assert (tmp_path / "b.npz").exists()
    with pytest.raises(RunFolderError, match="no demonstration that can be used"):
        (tmp_path / "empty").mkdir()
        load_demonstrations(tmp_path / "empty")


def test_what_is_no_number_is_refused_by_a_sentence(tmp_path):
    path = tmp_path / "odd.npz"
    poses = np.stack([recording().poses] * 2)
    about = {"length_unit": "m", "quaternion": "wxyz"}
    np.savez(path, poses=poses, times=np.arange(7.0), **about)
    with pytest.raises(DemonstrationError, match=r"odd\.npz cannot be read: .*broadcast"):
        read_recording(path)
    np.savez(path, poses=poses.astype(str)[:, :, ::-1] + "x", rate=30, **about)
    with pytest.raises(DemonstrationError, match="could not convert"):
        read_recording(path)
    np.savez(path, poses=poses[0], times=recording().times, gripper=np.zeros(3), **about)
    with pytest.raises(DemonstrationError, match=r"gripper must have shape \(60,\)"):
        read_recording(path)


def test_a_name_is_taken_once(tmp_path):
    save_demonstration(tmp_path, recording())
    before = (tmp_path / "lift.npz").read_bytes()
    with pytest.raises(DemonstrationError, match="is there already"):
        save_demonstration(tmp_path, recording(count=80))
    assert (tmp_path / "lift.npz").read_bytes() == before
    save_demonstration(tmp_path, recording(count=80), replace=True)
    assert len(load_demonstration(tmp_path / "lift.npz").times) == 80


def test_unknown_and_absent_files_are_named(tmp_path):
    with pytest.raises(DemonstrationError, match="does not exist"):
        read_recording(tmp_path / "none.csv")
    (tmp_path / "demo.txt").write_text("")
    with pytest.raises(DemonstrationError, match=r"unknown format '\.txt'; known: \.csv"):
        read_recording(tmp_path / "demo.txt")


def test_cleaning_removes_tremor_and_sign_flips_and_keeps_the_ends():
    demo = recording(count=200)
    rng, poses = np.random.default_rng(0), np.array(recording(count=200).poses)
    fade = np.sin(np.pi * demo.times / demo.times[-1])[:, None]
    poses[:, :3] += 0.002 * fade * np.sin(2 * np.pi * 12 * demo.times)[:, None]
    poses[:, 3:] *= rng.choice([-1.0, 1.0], (200, 1))
    skill = filtering.clean(dataclasses.replace(demo, poses=poses))
    wanted = filtering.clean(demo)
    assert skill.shape == (filtering.POINTS, 8)
    assert np.all(np.sum(skill[1:, :4] * skill[:-1, :4], axis=1) > 0)
    found, ideal = (
        RigidTransform.from_dual_quat(s.astype(float), scalar_first=True) for s in (skill, wanted)
    )
    assert np.linalg.norm(found.translation - ideal.translation, axis=1).max() < 4e-4
    for end, row in ((0, 0), (-1, -1)):
        np.testing.assert_allclose(found.translation[end], poses[row, :3], atol=1e-5)
    steps = np.linalg.norm(np.diff(found.translation, axis=0), axis=1)
    assert steps.max() < 2 * np.median(steps)


def test_gripper_events_end_a_skill():
    up, demo = recording(), recording()
    still = np.repeat(up.poses[-1:], 20, axis=0)
    poses = np.concatenate([up.poses, still, up.poses[::-1]])
    gripper = np.concatenate([np.zeros(70), np.ones(70)])
    whole = Demonstration("fetch", np.arange(140) * 0.03, poses, gripper)
    first, second = splitting.at_gripper_events(whole)
    assert (first.name, first.closed, second.name, second.closed) == (
        "fetch.1",
        False,
        "fetch.2",
        True,
    )
    assert splitting.at_gripper_events(demo) == [demo]
    library = build_library([whole])
    assert library.names == ("fetch.1", "fetch.2") and library.closed[:2].tolist() == [False, True]


def screw_path(start, twist, count):
    """Poses `[count, 7]` along a constant screw from a pose, and where it ends."""
    share = np.linspace(0, 1, count)[:, None]
    path = start * RigidTransform.from_exp_coords(share * twist)
    rows = [path.translation, path.rotation.as_quat(scalar_first=True)]
    return np.concatenate(rows, axis=1), path[-1]


def test_a_change_of_screw_ends_a_segment():
    start = RigidTransform.from_components([0.4, 0.0, 0.3], Rotation.from_euler("x", np.pi))
    first, corner = screw_path(start, np.array([0, 0, 0, 0.0, 0.0, 0.2]), 40)
    second, _ = screw_path(corner, np.array([0, 0, 1.2, 0.25, 0.0, 0.0]), 40)
    poses = np.concatenate([first, second[1:]])
    cuts = splitting.screw_cuts(poses)
    assert len(cuts) == 1 and abs(cuts[0] - 39) <= 6
    assert splitting.screw_cuts(first) == []
    demo = Demonstration("two", np.arange(79) * 0.03, poses, np.zeros(79))
    assert [part.name for part in splitting.at_screws(demo)] == ["two.1", "two.2"]


def test_twenty_skills_are_shipped():
    shipped = load_demonstrations(demonstrations_folder())
    assert len(shipped) == 20
    assert all(demo.robot == "Kinova Gen3" and demo.note for demo in shipped)
