# SPDX-License-Identifier: MIT
"""Compiled programs kept between processes, in the user's cache folder."""

import os
from pathlib import Path


def enable_compile_cache() -> Path | None:
    """Switch JAX's persistent compile cache on, unless the user has set it up already.

    `load_workcell` calls it. `HYBRID_JAX_NO_CACHE=1` leaves the cache off.
    `JAX_COMPILATION_CACHE_DIR` sets its folder, else it is `hybrid_jax` in the user's cache folder.

    Returns:
        The folder; None if the cache is left off, or if the user has no home folder.
    """
    if os.environ.get("HYBRID_JAX_NO_CACHE"):
        return None
    import jax

    if not jax.config.jax_compilation_cache_dir:
        caches = _caches()
        if caches is None:
            return None
        jax.config.update("jax_compilation_cache_dir", str(caches / "hybrid_jax"))
    if "JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS" not in os.environ:
        jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.0)
    return Path(jax.config.jax_compilation_cache_dir)


def _caches() -> Path | None:
    """The user's cache folder; None where there is no home folder."""
    folder = os.environ.get("XDG_CACHE_HOME")
    try:
        return Path(folder) if folder else Path.home() / ".cache"
    except RuntimeError:
        return None


def cache_folder() -> Path | None:
    """Folder of JAX's compile cache; None where it is off or no folder of this machine."""
    import jax

    folder = jax.config.jax_compilation_cache_dir
    return Path(folder) if folder and "://" not in folder else None
