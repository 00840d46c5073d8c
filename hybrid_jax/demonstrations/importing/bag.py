# SPDX-License-Identifier: MIT
"""Recordings in ROS 2 bags. Errors name a sample by its number among the pose messages."""

from collections.abc import Iterator
from pathlib import Path

import numpy as np

from hybrid_jax.demonstrations.demonstration import Demonstration
from hybrid_jax.demonstrations.importing.common import ImportConfig, finish
from hybrid_jax.errors import DemonstrationError

POSE_MESSAGES = ("geometry_msgs/msg/PoseStamped", "geometry_msgs/msg/TransformStamped")
GRIPPER_MESSAGES = ("std_msgs/msg/Bool", "std_msgs/msg/Float32", "std_msgs/msg/Float64")


def _topic(connections: list, wanted: str, kinds: tuple[str, ...], path: Path):
    """The connection of the topic `wanted`, or the only one of the kinds where that is empty."""
    matches = [c for c in connections if c.msgtype in kinds and (not wanted or c.topic == wanted)]
    if len(matches) != 1:
        listed = ", ".join(f"{c.topic} ({c.msgtype})" for c in connections) or "none"
        subject = f"topic {wanted!r}" if wanted else f"{len(matches)} topics"
        raise DemonstrationError(
            f"{path}: {subject} of kind {' or '.join(kinds)}; name one of the topics: {listed}"
        )
    return matches[0]


def _stamped(message) -> tuple[float, str, list[float]]:
    """Time [s], frame and pose (position [m], quaternion wxyz) of a stamped pose or transform."""
    if hasattr(message, "pose"):
        p, q = message.pose.position, message.pose.orientation
    else:
        p, q = message.transform.translation, message.transform.rotation
    stamp = message.header.stamp
    pose = [p.x, p.y, p.z, q.w, q.x, q.y, q.z]
    return stamp.sec + stamp.nanosec * 1e-9, message.header.frame_id, pose


def _messages(reader, connection) -> Iterator[tuple[float, object]]:
    """Messages of a connection, with the times at which they were recorded [s]."""
    for _, nanoseconds, raw in reader.messages(connections=[connection]):
        yield nanoseconds * 1e-9, reader.deserialize(raw, connection.msgtype)


def read_bag(path: Path, config: ImportConfig = ImportConfig()) -> list[Demonstration]:
    """Read a ROS 2 bag: a folder, or a file `.mcap` or `.db3`. Lengths are metres, as usual in ROS.

    Args:
        path: of the folder or file.
        config: topics, and what the bag does not say itself.

    Returns:
        One demonstration, with poses `[sample, 7]`.

    Raises:
        DemonstrationError: none or several of the topics fit, or a message is wrong.
    """
    try:
        from rosbags.highlevel import AnyReader
        from rosbags.typesys import Stores, get_typestore
    except ImportError:
        raise DemonstrationError(
            f"{path}: reading ROS 2 bags needs the package rosbags: pip install 'hybrid_jax[ros]'"
        ) from None
    try:
        # a bag is a folder: a file of it stands for the whole
        bag = path.parent if (path.parent / "metadata.yaml").is_file() else path
        with AnyReader([bag], default_typestore=get_typestore(Stores.LATEST)) as reader:
            poses = _topic(reader.connections, config.pose_topic, POSE_MESSAGES, path)
            received = [(t, *_stamped(m)) for t, m in _messages(reader, poses)]
            grip = [(0.0, 0.0)]
            if config.gripper_topic:
                topic = _topic(reader.connections, config.gripper_topic, GRIPPER_MESSAGES, path)
                grip = [(t, float(m.data)) for t, m in _messages(reader, topic)] or grip
    except DemonstrationError:
        raise
    except Exception as error:
        raise DemonstrationError(f"{path} cannot be read as a ROS 2 bag: {error!r}") from None
    return [_from_bag(path, config, received, grip)]


def _from_bag(path: Path, config: ImportConfig, received: list, grip: list) -> Demonstration:
    """A demonstration of pose messages (recorded at, stamp, frame, pose) and gripper states."""
    if not received:
        raise DemonstrationError(f"{path}: the topic of poses holds no message")
    arrived, stamps, frames, poses = zip(*received, strict=True)
    mismatch = next((i for i, frame in enumerate(frames) if frame != frames[0]), None)
    if mismatch is not None:
        raise DemonstrationError(
            f"{path}, message {mismatch}: frame {frames[mismatch]!r}, but {frames[0]!r} before"
        )
    grip_times, state = np.array(grip).T
    # the gripper's messages carry no stamp: both are compared by when they were recorded
    latest = np.clip(np.searchsorted(grip_times, arrived, side="right") - 1, 0, None)
    times = np.array(stamps) - stamps[0]
    columns = dict(times=times, poses=np.array(poses), gripper=state[latest])
    return finish(path, config, {"frame": frames[0]}, columns, "message {}".format)
