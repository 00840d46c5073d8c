# SPDX-License-Identifier: MIT
"""Recordings in ROS 2 bags; messages count the messages of the pose's topic."""

from collections.abc import Iterator
from pathlib import Path

import numpy as np

from hybrid_jax.errors import DemonstrationError
from hybrid_jax.skills.demonstration import Demonstration
from hybrid_jax.skills.importing.common import ImportConfig, finish

POSE_MESSAGES = ("geometry_msgs/msg/PoseStamped", "geometry_msgs/msg/TransformStamped")
GRIPPER_MESSAGES = ("std_msgs/msg/Bool", "std_msgs/msg/Float32", "std_msgs/msg/Float64")


def _topic(connections: list, wanted: str, kinds: tuple[str, ...], path: Path):
    """The connection of a topic, or the only one of its kind."""
    fitting = [c for c in connections if c.msgtype in kinds and (not wanted or c.topic == wanted)]
    if len(fitting) != 1:
        listed = ", ".join(f"{c.topic} ({c.msgtype})" for c in connections) or "none"
        what = f"topic {wanted!r}" if wanted else f"{len(fitting)} topics"
        raise DemonstrationError(
            f"{path}: {what} of kind {' or '.join(kinds)}; name one of the topics: {listed}"
        )
    return fitting[0]


def _stamped(message) -> tuple[float, str, list[float]]:
    """Time [s], frame and pose of a stamped pose or transform."""
    if hasattr(message, "pose"):
        p, q = message.pose.position, message.pose.orientation
    else:
        p, q = message.transform.translation, message.transform.rotation
    stamp = message.header.stamp
    pose = [p.x, p.y, p.z, q.w, q.x, q.y, q.z]
    return stamp.sec + stamp.nanosec * 1e-9, message.header.frame_id, pose


def _messages(reader, connection) -> Iterator[tuple[float, object]]:
    for _, nanoseconds, raw in reader.messages(connections=[connection]):
        yield nanoseconds * 1e-9, reader.deserialize(raw, connection.msgtype)


def read_bag(path: Path, config: ImportConfig = ImportConfig()) -> list[Demonstration]:
    """Read a ROS 2 bag (folder or `.mcap`, `.db3`); lengths are metres, as ROS lays down.

    Raises:
        DemonstrationError: no or several topics that fit, or a message that is wrong.
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
    except Exception as error:  # noqa: BLE001 storage plugins raise errors of many kinds
        raise DemonstrationError(f"{path} cannot be read as a ROS 2 bag: {error!r}") from None
    return [_from_bag(path, config, received, grip)]


def _from_bag(path: Path, config: ImportConfig, received: list, grip: list) -> Demonstration:
    if not received:
        raise DemonstrationError(f"{path}: the topic of poses holds no message")
    arrived, stamps, frames, poses = zip(*received, strict=True)
    odd = next((i for i, frame in enumerate(frames) if frame != frames[0]), None)
    if odd is not None:
        raise DemonstrationError(
            f"{path}, message {odd}: frame {frames[odd]!r}, but {frames[0]!r} before"
        )
    when, state = np.array(grip).T
    # the gripper's messages carry no stamp: both are compared by when they were recorded
    last = np.clip(np.searchsorted(when, arrived, side="right") - 1, 0, None)
    times = np.array(stamps) - stamps[0]
    columns = dict(times=times, poses=np.array(poses), gripper=state[last])
    return finish(path, config, {"frame": frames[0]}, columns, "message {}".format)
