# SPDX-License-Identifier: MIT
"""The methods that the hybrid planner is compared with."""
