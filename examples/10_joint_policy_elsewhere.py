# SPDX-License-Identifier: MIT
"""The joint agent's policy as StableHLO: it runs where this package is not installed.

python examples/10_joint_policy_elsewhere.py runs/gen3_handling-001
"""

import json
import sys
import tempfile
from pathlib import Path

import jax.numpy as jnp
from jax import export

import hybrid_jax as hj


def main(folder: str) -> None:
    """Write the policy of a trained run, then use the file alone."""
    with tempfile.TemporaryDirectory() as place:
        path = Path(place) / "policy.bin"
        hj.export_policy(hj.open_run(folder), path)
        about = json.loads(path.with_suffix(".json").read_text())
        policy = export.deserialize(bytearray(path.read_bytes()))
    # from here on jax is enough
    for part in about["observation"]:
        print(f"{part['count']:3d} numbers: {part['what']}")
    length = sum(part["count"] for part in about["observation"])
    actions = policy.call(jnp.zeros((4, length)))
    print(f"actions of four observations: {actions.shape}; an action is the {about['action']}")


if __name__ == "__main__":
    main(sys.argv[1] if len(sys.argv) > 1 else "runs/gen3_handling-001")
