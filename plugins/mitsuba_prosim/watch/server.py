"""The page's server, on this machine alone."""

from __future__ import annotations

import secrets
import socket
import threading
from collections.abc import Iterator
from contextlib import contextmanager

import uvicorn
from starlette.applications import Starlette
from starlette.routing import Mount

from . import pages
from .guard import Guard
from .studio import Studio


def bound(port: int) -> socket.socket:
    """A socket on this machine's own address; any free port for 0. Raises OSError."""
    result = socket.socket(socket.AF_INET, socket.SOCK_STREAM)
    try:
        result.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        result.bind(("127.0.0.1", port))
        result.listen()  # who opens the address at once waits until the server is there
    except OSError:
        result.close()
        raise
    return result


@contextmanager
def served(studio: Studio, encode: pages.Encoder, sock: socket.socket) -> Iterator[str]:
    """Serves the page in a thread of its own, for a while; yields its address."""
    token = secrets.token_urlsafe(24)
    routes = pages.Pages(studio.desk, studio.board, encode).routes()
    config = uvicorn.Config(
        Guard(Starlette(routes=[Mount(f"/{token}", routes=routes)]), token),
        log_config=None,
        log_level="critical",
        access_log=False,
        lifespan="off",
        ws="none",
        server_header=False,
        timeout_graceful_shutdown=1,
    )
    server = uvicorn.Server(config)
    thread = threading.Thread(target=server.run, args=([sock],), name="page", daemon=True)
    thread.start()
    try:
        yield f"http://127.0.0.1:{sock.getsockname()[1]}/{token}/"
    finally:
        studio.board.close()
        server.should_exit = True
        thread.join(3)
        sock.close()
