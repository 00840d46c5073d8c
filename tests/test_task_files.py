# SPDX-License-Identifier: MIT
"""Task files: what is written is read back, what is wrong is named."""

import json

import numpy as np
import pytest

from hybrid_jax.errors import TaskError, UnknownNameError
from hybrid_jax.tasks.registry import random_task, read_task, task_values, with_key_poses


def test_dragged_tasks_survive_their_file(cell, tmp_path):
    task = random_task(cell, 4)
    rows = np.array(task_values(task)["key_poses"])
    rows[0, :2] += 0.02
    moved = with_key_poses(cell, task, rows)
    index = cell.source.layout.object_names.index(task.object_name)
    shift = moved.object_poses[index] - task.object_poses[index]
    np.testing.assert_allclose(shift[:3], [0.02, 0.02, 0], atol=1e-5)  # it lies where it is grasped
    path = tmp_path / "task.json"
    path.write_text(json.dumps(task_values(moved)))
    again = read_task(cell, path)
    np.testing.assert_allclose(again.key_poses[1:-1], moved.key_poses[1:-1], atol=2e-6)
    np.testing.assert_allclose(again.object_poses, moved.object_poses, atol=2e-6)


@pytest.mark.parametrize(
    "values, message",
    [
        ({"object": "block_1", "key_poses": [[0] * 7]}, "key_poses must be 4 finite rows"),
        ({"object": "block_1", "key_poses": [[0, 0, 0, 2, 0, 0, 0]] * 4}, "row 0 has not length 1"),
        ({"object": "block_1", "key_poses": "up"}, "key_poses must be 4 finite rows"),
        ({"object": "block_1", "scene_seed": -1}, "scene_seed must be a whole number"),
        ({"object": "block_1", "colour": "red"}, "unknown field 'colour'"),
        ({"object": 7}, "needs a field 'object'"),
    ],
)
def test_bad_task_files_are_refused_by_name(cell, tmp_path, values, message):
    path = tmp_path / "task.json"
    path.write_text(json.dumps(values))
    with pytest.raises(TaskError, match=message):
        read_task(cell, path)


def test_task_files_are_checked(cell, tmp_path):
    path = tmp_path / "task.json"
    for text, message in (
        ("{", "task.json"),
        ("{}", "field 'object'"),
        ('{"object": "hammer", "object_poses": [[1]]}', "must be 5 finite rows"),
    ):
        path.write_text(text)
        with pytest.raises(TaskError, match=message):
            read_task(cell, path)
    path.write_text('{"object": "spanner"}')
    with pytest.raises(UnknownNameError, match="hammer"):
        read_task(cell, path)
    path.write_text(json.dumps({"object": "bolt_1", "scene_seed": 3}))
    assert read_task(cell, path).object_name == "bolt_1"
