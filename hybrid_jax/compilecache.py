# SPDX-License-Identifier: MIT
"""Keep compiled programs between runs, in the user's cache folder."""

import os
from pathlib import Path


def enable_compile_cache() -> Path | None:
    """Switch JAX's persistent compile cache on; `HYBRID_JAX_NO_CACHE=1` leaves it off.

    `JAX_COMPILATION_CACHE_DIR`, if set, says where; else `hybrid_jax` in the user's cache folder.
    """
    if os.environ.get("HYBRID_JAX_NO_CACHE"):
        return None
    import jax  # noqa: PLC0415

    caches = os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache"
    folder = Path(os.environ.get("JAX_COMPILATION_CACHE_DIR") or Path(caches) / "hybrid_jax")
    jax.config.update("jax_compilation_cache_dir", str(folder))
    jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.5)
    return folder
