# SPDX-License-Identifier: MIT
"""Recording demonstrations by hand, in a browser page."""
