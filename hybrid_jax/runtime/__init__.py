# SPDX-License-Identifier: MIT
"""General services: devices, random keys, caches, files, messages on the terminal."""
