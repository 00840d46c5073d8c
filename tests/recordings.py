# SPDX-License-Identifier: MIT
"""Recordings for tests."""

import dataclasses

import numpy as np
from scipy.spatial.transform import Rotation

from hybrid_jax.demonstrations.demonstration import (
    Demonstration,
)


def recording(name="lift", count=60, gripper=0.0) -> Demonstration:
    """A smooth motion up, forward and about the vertical."""
    s = np.linspace(0, 1, count)
    position = np.stack([0.4 + 0.1 * s, 0.02 * np.sin(3 * s), 0.1 + 0.3 * s**2], axis=1)
    turn = Rotation.from_rotvec(0.8 * s[:, None] * [0, 0, 1]) * Rotation.from_euler("x", np.pi)
    poses = np.concatenate([position, turn.as_quat(scalar_first=True)], axis=1)
    return Demonstration(name, 2.0 * s, poses, np.full(count, gripper), robot="test arm")


def broken(**changes) -> Demonstration:
    """The recording with single values replaced: field=(index, value)."""
    demo = recording()
    for field, (index, value) in changes.items():
        array = np.array(getattr(demo, field))
        array[index] = value
        demo = dataclasses.replace(demo, **{field: array})
    return demo


def write_csv(path, demo, unit="mm", scale=1000.0, head=""):
    rows = np.column_stack([demo.times, demo.poses[:, :3] * scale, demo.poses[:, 3:], demo.gripper])
    names = f"time [s], x [{unit}], y [{unit}], z [{unit}], qw, qx, qy, qz, gripper"
    lines = [",".join(f"{v:.9f}" for v in row) for row in rows]
    path.write_text("\n".join([f"{head}{names}", *lines]) + "\n")


def write_bag(path, demo, frame="base", odd=None):
    """A ROS 2 bag with stamped poses and a gripper that closes half way."""
    from rosbags.rosbag2 import StoragePlugin, Writer
    from rosbags.typesys import Stores, get_typestore

    store = get_typestore(Stores.LATEST)
    kinds = store.types
    stamped, boolean = kinds["geometry_msgs/msg/PoseStamped"], kinds["std_msgs/msg/Bool"]
    header, time = kinds["std_msgs/msg/Header"], kinds["builtin_interfaces/msg/Time"]
    pose, point = kinds["geometry_msgs/msg/Pose"], kinds["geometry_msgs/msg/Point"]
    quaternion = kinds["geometry_msgs/msg/Quaternion"]
    with Writer(path, version=9, storage_plugin=StoragePlugin.MCAP) as writer:
        tool = writer.add_connection("/tool", stamped.__msgtype__, typestore=store)
        grip = writer.add_connection("/grip", boolean.__msgtype__, typestore=store)
        for i, (t, row) in enumerate(zip(demo.times, demo.poses, strict=True)):
            stamp = 10**9 + int(t * 1e9)
            head = header(time(stamp // 10**9, stamp % 10**9), "camera" if i == odd else frame)
            w, x, y, z = row[3:]
            message = stamped(head, pose(point(*row[:3]), quaternion(x, y, z, w)))
            writer.write(tool, stamp, store.serialize_cdr(message, tool.msgtype))
            if i in (0, 30):
                state = store.serialize_cdr(boolean(i == 30), grip.msgtype)
                writer.write(grip, stamp, state)
