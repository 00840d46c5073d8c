# SPDX-License-Identifier: MIT
"""Recordings of other programs: CSV, NPZ and ROS 2 bags."""

import numpy as np
import pytest
from recordings import broken, recording, write_bag, write_csv
from scipy.spatial.transform import Rotation

from hybrid_jax import demos
from hybrid_jax.demonstrations.importing import ImportConfig, read_recording
from hybrid_jax.errors import DemonstrationError


def test_csv_states_its_units(tmp_path):
    path = tmp_path / "up.csv"
    write_csv(path, recording(), head="# robot: other arm\n# note: by hand\n")
    (demo,) = read_recording(path)
    assert (demo.name, demo.robot, demo.note) == ("up", "other arm", "by hand")
    np.testing.assert_allclose(demo.poses, recording().poses, atol=1e-6)
    text = path.read_text()
    path.write_text(text.replace("x [mm]", "x"))
    with pytest.raises(DemonstrationError, match="column 'x' states no unit of length"):
        read_recording(path)
    path.write_text(text.replace("qz,", ""))
    with pytest.raises(DemonstrationError, match="'qz' is missing"):
        read_recording(path)


def test_csv_faults_are_named_by_their_line(tmp_path):
    path = tmp_path / "up.csv"
    write_csv(path, broken(poses=((17, 1), np.nan)), head="# robot: other arm\n")
    with pytest.raises(DemonstrationError, match=r"line 20: y is nan"):  # a comment, the header
        read_recording(path)
    lines = path.read_text().splitlines()
    path.write_text("\n".join([*lines[:10], "", "# a pause", *lines[10:]]))
    with pytest.raises(DemonstrationError, match=r"line 22: y is nan"):
        read_recording(path)
    write_csv(path, recording())
    lines = path.read_text().splitlines()
    lines[8] = lines[8].replace("0.", "zero.", 1)
    path.write_text("\n".join(lines))
    with pytest.raises(DemonstrationError, match="line 9: could not convert"):
        read_recording(path)


def test_csv_reads_roll_pitch_yaw(tmp_path):
    demo, path = recording(), tmp_path / "wpr.csv"
    turn = Rotation.from_quat(demo.poses[:, 3:], scalar_first=True)
    angles = turn.as_euler("xyz", degrees=True)
    rows = np.column_stack([demo.times * 1000, demo.poses[:, :3], angles])
    header = "time [ms], x [m], y [m], z [m], roll [deg], pitch [deg], yaw [deg]"
    np.savetxt(path, rows, delimiter=",", header=header, comments="")
    (again,) = read_recording(path)
    found = Rotation.from_quat(again.poses[:, 3:], scalar_first=True)
    assert (found * turn.inv()).magnitude().max() < 1e-6
    np.testing.assert_allclose(again.times, demo.times, atol=1e-9)


def test_npz_reads_several_demonstrations_and_never_objects(tmp_path):
    demo, path = recording(), tmp_path / "many.npz"
    poses = np.stack([demo.poses[:, [0, 1, 2, 4, 5, 6, 3]]] * 2) * ([100] * 3 + [1] * 4)
    np.savez(path, poses=poses, rate=30.0, length_unit="cm", quaternion="xyzw")
    first, second = read_recording(path)
    assert (first.name, second.name) == ("many_1", "many_2")
    np.testing.assert_allclose(first.poses, demo.poses, atol=1e-9)
    assert second.times[1] == pytest.approx(1 / 30)
    np.savez(path, poses=poses, rate=30.0, quaternion="xyzw")
    with pytest.raises(DemonstrationError, match="states no unit of length"):
        read_recording(path)
    assert len(read_recording(path, ImportConfig(length_unit="cm"))) == 2
    np.savez(path, poses=np.array([{"a": 1}], dtype=object))
    with pytest.raises(DemonstrationError, match="never loaded"):
        read_recording(path)


def test_ros2_bags_are_read(tmp_path):
    pytest.importorskip("rosbags")
    demo = recording()
    write_bag(tmp_path / "bag", demo)
    (again,) = read_recording(tmp_path / "bag", ImportConfig(gripper_topic="/grip"))
    np.testing.assert_allclose(again.poses, demo.poses, atol=1e-9)
    np.testing.assert_allclose(again.times, demo.times, atol=1e-8)
    assert again.gripper.tolist() == [0.0] * 30 + [1.0] * 30
    file = next((tmp_path / "bag").glob("*.mcap"))
    assert len(read_recording(file)[0].times) == 60
    file.with_name("torn.mcap").write_bytes(file.read_bytes()[:200])
    (tmp_path / "torn").mkdir()
    file.with_name("torn.mcap").rename(tmp_path / "torn" / "torn.mcap")
    with pytest.raises(DemonstrationError, match="cannot be read as a ROS 2 bag"):
        read_recording(tmp_path / "torn")
    with pytest.raises(DemonstrationError, match="topic '/arm' .* /tool"):
        read_recording(tmp_path / "bag", ImportConfig(pose_topic="/arm"))
    write_bag(tmp_path / "base_link", demo, frame="base_link")
    with pytest.raises(DemonstrationError, match="frame 'base_link', wanted 'base'"):
        read_recording(tmp_path / "base_link")
    assert read_recording(tmp_path / "base_link", ImportConfig(frame="base_link"))
    write_bag(tmp_path / "odd", demo, odd=12)
    with pytest.raises(DemonstrationError, match="message 12: frame 'camera'"):
        read_recording(tmp_path / "odd")


def test_commands_import_list_split_and_draw(tmp_path, capsys):
    write_csv(tmp_path / "up.csv", recording(), head="# note: by hand\n")
    library = tmp_path / "library"
    assert demos.import_file(tmp_path / "up.csv", library) == 0
    assert demos.list_library(library) == 0
    assert "by hand" in capsys.readouterr().out
    assert demos.draw_library(tmp_path / "pictures", library) == 0
    assert (tmp_path / "pictures" / "up.png").stat().st_size > 5000
    with pytest.raises(DemonstrationError, match="is there already"):
        demos.import_file(tmp_path / "up.csv", library)
    assert demos.split_file(library / "up.npz") == 0
    assert [path.name for path in library.iterdir()] == ["up.npz"], "no event, nothing to split"
