# SPDX-License-Identifier: MIT
"""A viser server that answers its own page only: pages of other origins cannot reach it."""

import asyncio
import contextlib
import http
import io
import ipaddress
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from urllib.parse import urlsplit

import viser
import websockets.asyncio.server

from hybrid_jax.errors import InputError


def _is_local(name: str | None) -> bool:
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
        if local and not _is_local(urlsplit(f"//{host}").hostname):
            return False
        return origin is None or (host is not None and urlsplit(origin).netloc == host)
    except ValueError:  # "[" begins an address that never ends
        return False


@contextlib.contextmanager
def _guarded(local: bool) -> Iterator[None]:
    """Context in which new servers refuse other origins; viser has no setting for that."""
    serve = websockets.asyncio.server.serve

    def guarded(handler, *args, process_request, **kwargs):
        def check(connection, request):
            headers = request.headers
            if is_own(headers.get("Origin"), headers.get("Host"), local):
                return process_request(connection, request)
            return connection.respond(http.HTTPStatus.FORBIDDEN, "not this server's page\n")

        return serve(handler, *args, process_request=check, **kwargs)

    websockets.asyncio.server.serve = guarded
    try:
        yield
    finally:
        websockets.asyncio.server.serve = serve


async def _listen_once(host: str) -> None:
    """Listen at an address on any port, and stop; OSError if it is not one of this machine."""
    server = await asyncio.start_server(lambda reader, writer: None, host, 0)
    server.close()
    await server.wait_closed()


def open_server(host: str, port: int, label: str) -> viser.ViserServer:
    """Start a page's server.

    Args:
        host: address to listen at.
        port: the first one that is tried.
        label: title of the page.

    Raises:
        InputError: there is no such port, or this machine cannot listen at that address.
    """
    if not 0 < port < 65536:
        raise InputError(f"the port must be a number from 1 to 65535, got {port}")
    try:
        with ThreadPoolExecutor(1) as pool:  # a notebook's own loop runs in this thread
            pool.submit(asyncio.run, _listen_once(host)).result()
    except OSError as error:
        raise InputError(
            f"this machine cannot listen at {host!r} ({error.strerror or error}): name one of its "
            "own addresses, or 0.0.0.0 for all of them"
        ) from None
    # the constructor returns when the server listens; its banner would mix with a command's answer
    with _guarded(_is_local(host)), contextlib.redirect_stdout(io.StringIO()):
        return viser.ViserServer(host=host, port=port, label=label, verbose=False)


def close_server(server: viser.ViserServer) -> None:
    """Stop a server without its messages on the terminal."""
    with contextlib.redirect_stdout(io.StringIO()):
        server.stop()


def address_of(server: viser.ViserServer) -> str:
    """Address of a server's page for a browser."""
    return f"http://{server.get_host()}:{server.get_port()}"
