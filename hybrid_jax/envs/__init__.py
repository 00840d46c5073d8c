# SPDX-License-Identifier: MIT
"""Environments to learn in, and the segments that the joint agent bridges."""

from hybrid_jax.runtime.quiet import import_mjx

import_mjx()
