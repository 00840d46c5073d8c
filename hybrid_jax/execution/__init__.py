# SPDX-License-Identifier: MIT
"""Plans carried out in simulated physics."""

from hybrid_jax.runtime.quiet import import_mjx

import_mjx()
