# SPDX-License-Identifier: MIT
"""The joint agent's policy as StableHLO, for programs without this package."""

import json
from pathlib import Path

import jax
import jax.numpy as jnp
from jax import export as jax_export

from hybrid_jax.agents import joint, networks
from hybrid_jax.envs.reach import ReachEnv
from hybrid_jax.errors import RunFolderError
from hybrid_jax.runs.load_planner import load_policy
from hybrid_jax.runs.run_folder import Run
from hybrid_jax.runtime.output_files import write_bytes, write_text

FORMAT = "hybrid_jax.policy/1"
"""Name and version of the description beside an exported policy."""
PLATFORMS = ("cpu", "cuda", "rocm", "tpu")
"""Platforms that the exported program can be compiled for."""


def export_policy(run: Run, path: Path | str) -> None:
    """Write the mode of a run's joint agent: observations `[batch, n]` to actions `[batch, joint]`.

    The file is a serialised `jax.export.Exported` (StableHLO in a container); any batch. Beside it
    `NAME.json` says what an observation consists of and what an action means.

    Args:
        run: whose stage `drl` is finished, not of preset `paper`.
        path: file to write.

    Raises:
        RunFolderError: the stage is missing, or the agent is the paper's.
    """
    path, cell, config = Path(path), run.cell, run.preset.joint
    if joint.env_kind(config) is not ReachEnv:
        raise RunFolderError(
            f"{run.folder} holds the paper's agent, whose observations need the sensor of its "
            "environment: only agents of the other presets can be exported"
        )
    net = joint.make_net(cell, config)
    length = joint.observation_length(cell, config)
    policy = load_policy(run, "drl.npz", "joint agent", net, length)
    # a symbolic batch size: one exported program serves any batch
    shape = jax.ShapeDtypeStruct((*jax_export.symbolic_shape("batch"), length), jnp.float32)
    act = jax.jit(lambda observations: networks.act(net, policy, observations, None))
    write_bytes(path, bytes(jax_export.export(act, platforms=PLATFORMS)(shape).serialize()))
    write_text(path.with_suffix(".json"), json.dumps(describe(run), indent=1) + "\n")


def describe(run: Run) -> dict:
    """Description of an exported policy: its observation and action, with units and limits."""
    cell, rules = run.cell, run.preset.joint.reach
    parts = ReachEnv.observation_parts(cell)
    return {
        "format": FORMAT,
        "workcell": cell.source.digest,
        "joint_names": list(cell.joint_names),
        "observation": [{"what": what, "count": count} for what, count in parts],
        "action": "correction of a straight step to the goal, -1..1 for each joint: see target",
        "target": "q + max_delta * clip(straight + authority * min(steps / fade, 1) * action, "
        "-1, 1) with to_go = (goal - q) / max_delta, steps = max |to_go|, straight = to_go / "
        "max(steps, 1); within the joint limits. A move that comes closer than margin is not made.",
        "max_delta": rules.max_delta,
        "authority": rules.authority,
        "fade": rules.fade,
        "margin": rules.margin,
        "joint_limits": cell.joint_limits.tolist(),
    }
