# SPDX-License-Identifier: MIT
"""Which requests a local server answers: its own page's, and those of no page at all."""

import ipaddress
from urllib.parse import urlsplit


def is_local(name: str | None) -> bool:
    """Is it a name or an address of this machine alone?"""
    if name == "localhost":
        return True
    try:
        return ipaddress.ip_address(name or "").is_loopback
    except ValueError:
        return False


def is_own(origin: str | None, host: str | None, local: bool) -> bool:
    """Does a request come from this server's own page, or from no page at all?

    Args:
        origin: header of that name; browsers send it with every web socket.
        host: header of that name.
        local: does the server listen at this machine's own address only? Then a foreign name in
            `host` means that a page had its name resolved to this machine (DNS rebinding).
    """
    try:
        if local and not is_local(urlsplit(f"//{host}").hostname):
            return False
        return origin is None or (host is not None and urlsplit(origin).netloc == host)
    except ValueError:  # "[" begins an address that never ends
        return False
