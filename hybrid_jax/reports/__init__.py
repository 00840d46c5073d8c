# SPDX-License-Identifier: MIT
"""Pictures, films and logs of a run's results."""
