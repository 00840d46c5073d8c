# SPDX-License-Identifier: MIT
"""A viser server that answers its own page only: pages of other origins cannot reach it."""

import asyncio
import contextlib
import http
import io
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor

import viser
import websockets.asyncio.server

from hybrid_jax.errors import InputError
from hybrid_jax.web.origins import is_local, is_own


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
    with _guarded(is_local(host)), contextlib.redirect_stdout(io.StringIO()):
        return viser.ViserServer(host=host, port=port, label=label, verbose=False)


def close_server(server: viser.ViserServer) -> None:
    """Stop a server without its messages on the terminal."""
    with contextlib.redirect_stdout(io.StringIO()):
        server.stop()


def address_of(server: viser.ViserServer) -> str:
    """Address of a server's page for a browser."""
    return f"http://{server.get_host()}:{server.get_port()}"
