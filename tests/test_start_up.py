# SPDX-License-Identifier: MIT
"""Importing is quick and silent, programs are kept between processes and never traced twice."""

import os
import subprocess
import sys
import time

import jax
import numpy as np
import pytest

import hybrid_jax as hj
from hybrid_jax.kernels import dualquat as dq

_TRACED = []
jax.monitoring.register_event_duration_secs_listener(
    lambda event, *args, **kwargs: _TRACED.append(event) if "jaxpr_trace" in event else None
)
USE = "import hybrid_jax as hj; c = hj.load_workcell('gen3_handling'); hj.clearance(c, c.home)"


def run(code, **environment):
    """A fresh process without the settings of this one."""
    inherited = {k: v for k, v in os.environ.items() if not k.startswith(("JAX_", "XLA_"))}
    return subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, env=inherited | environment
    )


def test_import_is_quick():
    """1.5 s are allowed; the best of three, so that a busy machine does not decide."""
    times = []
    for _ in range(3):
        began = time.perf_counter()
        assert run("import hybrid_jax").returncode == 0
        times.append(time.perf_counter() - began)
    assert min(times) < 1.5


def test_a_renderer_that_is_not_installed_is_said_and_does_without():
    none = "import ctypes.util; ctypes.util.find_library = lambda name: None;"
    done = run(none + "import hybrid_jax, mujoco", MUJOCO_GL="osmesa")
    assert done.returncode == 0, done.stderr
    assert "MUJOCO_GL=osmesa: libOSMesa is not installed" in done.stderr


def test_nothing_is_printed_without_need(tmp_path):
    done = run(
        "import hybrid_jax.agents.ppo, hybrid_jax.mjx.physics, hybrid_jax.planner.pipeline;" + USE,
        XDG_CACHE_HOME=str(tmp_path),
    )
    assert (done.returncode, done.stdout, done.stderr) == (0, "", "")


def test_programs_are_kept_unless_told_not_to(tmp_path):
    for folder, settings in (("on", {}), ("off", {"HYBRID_JAX_NO_CACHE": "1"})):
        assert run(USE, XDG_CACHE_HOME=str(tmp_path / folder), **settings).returncode == 0
    assert len(list((tmp_path / "on" / "hybrid_jax").iterdir())) > 0
    assert not (tmp_path / "off").exists()


def test_the_users_own_cache_is_left_alone(tmp_path):
    own = tmp_path / "own"
    done = run(USE, XDG_CACHE_HOME=str(tmp_path / "ours"), JAX_COMPILATION_CACHE_DIR=str(own))
    assert done.returncode == 0 and not (tmp_path / "ours").exists() and own.is_dir()


def test_traces_are_seen():
    """Without this the tests below could not fail."""
    before = len(_TRACED)
    jax.jit(lambda x: x + 1.0)(np.float32(1.0))
    assert len(_TRACED) > before


def map_of(cell):
    """A tiny map."""
    config = hj.MapConfig(
        lower=(0.3, -0.1, 0.3), upper=(0.5, 0.1, 0.5), spacing=0.2, batch=32, samples=1
    )
    return hj.build_feasibility_map(cell, config)


CALLS = {
    "tool_pose": lambda cell, q, pose, fmap: hj.tool_pose(cell, q),
    "jacobian": lambda cell, q, pose, fmap: hj.jacobian(cell, q),
    "manipulability": lambda cell, q, pose, fmap: hj.manipulability(cell, q),
    "clearance": lambda cell, q, pose, fmap: hj.clearance(cell, q),
    "edge_is_free": lambda cell, q, pose, fmap: hj.edge_is_free(cell, q, q + np.float32(0.01)),
    "sense": lambda cell, q, pose, fmap: hj.sense(cell, pose),
    "solve_ik": lambda cell, q, pose, fmap: hj.solve_ik(cell, pose, key=jax.random.key(0)),
    "query": lambda cell, q, pose, fmap: hj.query(fmap, pose),
    "nearest_feasible": lambda cell, q, pose, fmap: hj.nearest_feasible(fmap, pose),
}
"""Public kernels, each called with two different configurations and poses of one shape."""


@pytest.fixture(scope="module")
def tiny_map(cell):
    return map_of(cell)


@pytest.mark.parametrize("name", CALLS)
def test_a_second_call_traces_nothing(cell, configurations, tiny_map, name):
    first, second = configurations[:2]
    poses = [np.asarray(dq.normalize(hj.tool_pose(cell, q))) for q in (first, second)]
    CALLS[name](cell, first, poses[0], tiny_map)
    before = len(_TRACED)
    CALLS[name](cell, second, poses[1], tiny_map)
    assert _TRACED[before:] == []


def test_a_cell_that_is_loaded_again_traces_nothing(cell, configurations):
    hj.clearance(cell, configurations[0])
    again = hj.load_workcell("gen3_handling")
    before = len(_TRACED)
    hj.clearance(again, configurations[1])
    assert _TRACED[before:] == []


def test_a_plan_that_is_made_again_traces_nothing(planner, planned):
    task, _ = planned
    hj.plan_motion(planner, task, key=jax.random.key(0))
    before = len(_TRACED)
    hj.plan_motion(planner, task, key=jax.random.key(0))
    assert _TRACED[before:] == []


def test_a_map_that_is_built_again_traces_nothing(cell, tiny_map):
    before = len(_TRACED)
    map_of(cell)
    assert _TRACED[before:] == []
