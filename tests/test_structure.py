# SPDX-License-Identifier: MIT
"""The public names resolve, and imports go one way."""

import ast
from pathlib import Path

import pytest

import hybrid_jax

PACKAGE = Path(hybrid_jax.__file__).parent
FORBIDDEN = {
    "kernels": ("workcell", "ik", "feasibility", "skills", "simulation", "agents", "planner"),
    "workcell": ("ik", "feasibility", "skills", "simulation", "agents", "planner"),
    "skills": ("feasibility", "simulation", "agents", "planner"),
}
"""What a stage must not import."""


@pytest.mark.parametrize("name", hybrid_jax.__all__)
def test_public_names_resolve(name):
    assert getattr(hybrid_jax, name) is not None


@pytest.mark.parametrize("stage", FORBIDDEN)
def test_imports_go_one_way(stage):
    for path in (PACKAGE / stage).glob("*.py"):
        for node in ast.walk(ast.parse(path.read_text())):
            if isinstance(node, ast.ImportFrom) and (node.module or "").startswith("hybrid_jax."):
                part = node.module.split(".")[1]
                assert part not in FORBIDDEN[stage], f"{path.name} imports {node.module}"


def test_kernels_do_not_know_mujoco():
    for path in (PACKAGE / "kernels").glob("*.py"):
        assert "mujoco" not in [
            alias.name
            for node in ast.walk(ast.parse(path.read_text()))
            if isinstance(node, ast.Import)
            for alias in node.names
        ]
