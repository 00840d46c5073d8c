# SPDX-License-Identifier: MIT
from hybrid_jax.quiet import import_mjx

import_mjx()
