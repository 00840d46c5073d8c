# SPDX-License-Identifier: MIT
"""Shared fixtures. The compile cache is on for the run: the same programs recur in many tests."""

import os
import tempfile
from pathlib import Path

import pytest

os.environ.setdefault(
    "JAX_COMPILATION_CACHE_DIR", str(Path(tempfile.gettempdir()) / "hybrid_jax_test_cache")
)

from hybrid_jax.compilecache import enable_compile_cache  # noqa: E402

enable_compile_cache()

import numpy as np  # noqa: E402

from hybrid_jax.workcell.load import load_workcell  # noqa: E402

SHARED = Path(__file__).resolve().parents[2] / "shared"


@pytest.fixture(scope="session")
def cell():
    """The handling cell."""
    return load_workcell("gen3_handling")


@pytest.fixture(scope="session")
def configurations(cell):
    """200 random configurations within the limits, float32."""
    low, high = np.asarray(cell.joint_limits).T
    return np.random.default_rng(0).uniform(low, high, (200, len(low))).astype(np.float32)


@pytest.fixture(scope="session")
def shared():
    """Reference data beside the checkout; a test that needs it skips without it."""
    if not SHARED.is_dir():
        pytest.skip("reference data beside the checkout is absent")
    return SHARED
