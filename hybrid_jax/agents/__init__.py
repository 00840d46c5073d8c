# SPDX-License-Identifier: MIT
"""The agents: task planner, joint agent, switching agent, and what trains them."""

from hybrid_jax.runtime.quiet import import_mjx

import_mjx()
