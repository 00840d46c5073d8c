# SPDX-License-Identifier: MIT
"""Keep compiled programs between processes, in the user's cache folder."""

import os
from pathlib import Path


def enable_compile_cache() -> Path | None:
    """Switch JAX's persistent compile cache on, where the user has not set it up otherwise.

    `load_workcell` does it. `HYBRID_JAX_NO_CACHE=1` leaves it off; `JAX_COMPILATION_CACHE_DIR` says
    where it lies, else it is `hybrid_jax` in the user's cache folder.

    Returns:
        The folder; None if it is left off, or if the user has no home to keep it in.
    """
    if os.environ.get("HYBRID_JAX_NO_CACHE"):
        return None
    import jax  # noqa: PLC0415

    if not jax.config.jax_compilation_cache_dir:
        caches = _caches()
        if caches is None:
            return None
        jax.config.update("jax_compilation_cache_dir", str(caches / "hybrid_jax"))
    if "JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS" not in os.environ:
        jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.5)
    return Path(jax.config.jax_compilation_cache_dir)


def _caches() -> Path | None:
    """The user's cache folder; None where there is no home."""
    stated = os.environ.get("XDG_CACHE_HOME")
    try:
        return Path(stated) if stated else Path.home() / ".cache"
    except RuntimeError:
        return None
