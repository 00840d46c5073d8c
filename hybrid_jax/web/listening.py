# SPDX-License-Identifier: MIT
"""Addresses that a server may listen at."""

import socket

from hybrid_jax.errors import InputError


def listen_at(host: str, port: int) -> socket.socket:
    """A socket that is bound to an address of this machine.

    Args:
        host: name or address.
        port: number of the port.

    Raises:
        InputError: there is no such port, it is taken, or the address is none of this machine.
    """
    if not 0 < port < 65536:
        raise InputError(f"the port must be a number from 1 to 65535, got {port}")
    try:
        family = socket.AF_INET6 if ":" in host else socket.AF_INET
        return socket.create_server((host, port), family=family)
    except OSError as error:
        raise InputError(
            f"this machine cannot listen at {host}, port {port} ({error.strerror or error}): name "
            "a port that is free and an address of this machine, or 0.0.0.0 for all of them"
        ) from None
