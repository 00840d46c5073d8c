# SPDX-License-Identifier: MIT
"""A planner as a service over HTTP, and its client."""
