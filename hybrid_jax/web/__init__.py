# SPDX-License-Identifier: MIT
"""The server, page and 3-D scene that the browser pages share."""
