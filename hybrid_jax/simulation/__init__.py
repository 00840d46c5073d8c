# SPDX-License-Identifier: MIT
"""Worlds to learn in, and the cell in physics."""

from hybrid_jax.quiet import import_mjx

import_mjx()
