# SPDX-License-Identifier: MIT
"""Recording of demonstrations by hand, in a browser page."""
