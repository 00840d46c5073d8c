# SPDX-License-Identifier: MIT
"""The cell in MJX: its collision functions, physics and servos."""

from hybrid_jax.runtime.quiet import import_mjx

import_mjx()
