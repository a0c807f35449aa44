"""The web server of the live page. Only users of this machine who know the secret address can open the page."""

import asyncio
import json
import logging
import re
import secrets
import socket
import threading
from collections.abc import AsyncIterator, Callable, Iterator
from contextlib import contextmanager
from dataclasses import asdict
from math import isfinite
from typing import Any

import uvicorn
from starlette.applications import Starlette
from starlette.middleware import Middleware
from starlette.middleware.base import BaseHTTPMiddleware, RequestResponseEndpoint
from starlette.requests import Request
from starlette.responses import HTMLResponse, JSONResponse, PlainTextResponse, Response, StreamingResponse
from starlette.routing import BaseRoute, Mount, Route
from starlette.staticfiles import StaticFiles
from uvicorn.protocols.http.h11_impl import H11Protocol

from ..explaining import explanation_page
from ..scene.channels import parse_factors
from .orbit_camera import Camera
from .progressive_image import Factors
from .viewer import Viewer

#: A function of the exposure in stops and of the factors of layers, which is called in the thread that renders. The
#: function returns the contents of the image's files: suffix -> content.
Encoder = Callable[[float, Factors], dict[str, bytes]]

#: Name of an action of the page -> the camera after it, or None for the camera of the scene file. Two numbers describe
#: a motion.
ACTIONS: dict[str, Callable[[Camera, float, float], Camera | None]] = {
    "home": lambda camera, *_: None,
    "orbit": Camera.orbited,
    "pan": Camera.panned,
    "dolly": lambda camera, x, _: camera.dollied(x),
}

#: Exception of a request -> status of the response.
STATUS = {KeyError: 404, ValueError: 400, RuntimeError: 400}

#: The host names by which a browser addresses this machine, directly or through a tunnel. Other names are refused,
#: because a hostile site can make its own name resolve to this machine.
HOSTS = re.compile(r"(127\.0\.0\.1|localhost|\[::1\])(:\d{1,5})?")

HEADERS = {
    "Content-Security-Policy": "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self' data: blob:; "
    "connect-src 'self'; base-uri 'none'; form-action 'none'; frame-ancestors 'none'",
    "X-Content-Type-Options": "nosniff",
    "Referrer-Policy": "no-referrer",
    "Cache-Control": "no-store",
}


#: Maximum numbers of connections: all, accepted at once, and waiting. Maximum number of seconds without a request that
#: :func:`guard` accepts; minimum number of seconds between two log messages.
MAX_CONNECTIONS, AT_ONCE, QUEUE, TIMEOUT, LOG_INTERVAL = 16, 4, 1024, 10.0, 60.0


class Connection(H11Protocol):
    """An HTTP connection to a client, who may be hostile.

    Every :data:`TIMEOUT` seconds, the connection is closed unless an accepted request is being answered. With more than
    :data:`MAX_CONNECTIONS` connections, the oldest one without an accepted request is closed.
    """

    def connection_made(self, transport: Any) -> None:
        """Closes another connection if there are too many."""
        super().connection_made(transport)
        self.made = self.loop.time()
        self.loop.call_later(TIMEOUT, self._expire)
        connections: Any = self.connections
        open_ones = [one for one in connections if not one.transport.is_closing()]
        idle = [one for one in open_ones if not one.answers]
        if len(open_ones) > MAX_CONNECTIONS and idle:
            min(idle, key=lambda one: one.made).transport.abort()

    @property
    def answers(self) -> bool:
        """Whether a request that :func:`guard` has accepted is being answered."""
        return self.cycle is not None and not self.cycle.response_complete and "authorised" in self.scope

    def _expire(self) -> None:
        if self.answers:
            self.loop.call_later(TIMEOUT, self._expire)
        else:
            self.transport.abort()


class Server(uvicorn.Server):
    """A server that accepts few connections at once, lets many wait, and seldom logs errors."""

    #: Time of the event loop after which the next error is logged.
    due = 0.0

    async def startup(self, sockets: list[socket.socket] | None = None) -> None:
        """Begins to accept connections at ``sockets``."""
        asyncio.get_running_loop().set_exception_handler(self.log)
        await super().startup(sockets)
        for sock in sockets or ():
            sock.listen(QUEUE)  # asyncio accepts as many connections at once as it lets wait

    def log(self, loop: asyncio.AbstractEventLoop, context: dict[str, Any]) -> None:
        """Logs an error of the event loop, such as too many open files."""
        if loop.time() >= self.due:
            self.due = loop.time() + LOG_INTERVAL
            words = context.get("exception") or context["message"]
            logging.getLogger(__name__).warning("The server of the page: %s", words)


@contextmanager
def served(viewer: Viewer, encode: Encoder, sock: socket.socket) -> Iterator[str]:
    """Serves the live page in another thread until the ``with`` block ends, and yields the address of the page.

    ``encode`` makes the files that the user saves from the page. The server listens on ``sock``. At the end, the viewer
    and the socket are closed.
    """
    token = secrets.token_urlsafe(24)
    app = Starlette(
        routes=[Mount(f"/{token}", routes=Pages(viewer, encode).routes())],
        middleware=[Middleware(BaseHTTPMiddleware, dispatch=guard(token))],
        exception_handlers=dict.fromkeys(STATUS, refused),
    )
    config = uvicorn.Config(
        app,
        log_config=None,
        log_level="critical",
        lifespan="off",
        ws="none",
        http=Connection,
        backlog=AT_ONCE,
        loop="asyncio",
        server_header=False,
        timeout_graceful_shutdown=1,
    )
    server = Server(config)
    thread = threading.Thread(target=server.run, args=([sock],), name="page", daemon=True)
    thread.start()
    try:
        yield f"http://127.0.0.1:{sock.getsockname()[1]}/{token}/"
    finally:
        viewer.close()
        server.should_exit = True
        thread.join(3)
        sock.close()


def guard(token: str) -> Callable[[Request, RequestResponseEndpoint], Any]:
    """Returns a middleware that refuses HTTP requests without the secret token in their address, for another host name,
    or from a page of another site. All responses get those :data:`HEADERS` that they lack.
    """

    async def dispatch(request: Request, call_next: RequestResponseEndpoint) -> Response:
        host, origin = request.headers.get("host", ""), request.headers.get("origin")
        first_folder = request.scope["path"].lstrip("/").partition("/")[0]
        authorised = secrets.compare_digest(first_folder.encode(), token.encode())
        if authorised and HOSTS.fullmatch(host) and origin in (None, f"http://{host}"):
            request.scope["authorised"] = True
            response = await call_next(request)
        else:
            response = PlainTextResponse("Refused: open the address that prosim watch printed.\n", 403)
        for name, value in HEADERS.items():
            response.headers.setdefault(name, value)
        return response

    return dispatch


def refused(_: Request, error: Exception) -> Response:
    """Answers a request that has raised one of the exceptions in :data:`STATUS`."""
    status = next(status for kind, status in STATUS.items() if isinstance(error, kind))
    return PlainTextResponse(f"{error}\n", status)


class Pages:
    """Answers the HTTP requests of the live page; ``encode`` makes the files that the user saves."""

    def __init__(self, viewer: Viewer, encode: Encoder) -> None:
        self._viewer, self._encode = viewer, encode

    def routes(self) -> list[BaseRoute]:
        """Returns the routes of all requests that the page sends, and of its HTML, CSS and JavaScript files."""
        return [
            Route("/events", self.events),
            Route("/layer/{layer}", self.layer),
            Route("/pixel/{x:int}/{y:int}", self.pixel),
            Route("/explain/{x:int}/{y:int}", self.explain),
            Route("/save/{suffix}", self.save),
            Route("/do/{action}", self.act, methods=["POST"]),
            Mount("/", StaticFiles(packages=[(__package__, "page")], html=True)),
        ]

    async def events(self, _: Request) -> Response:
        """Streams the state of the viewer: the current state at once, and a new state after each change."""

        async def stream() -> AsyncIterator[str]:
            async for state in self._viewer.follow():
                yield f"data: {json.dumps(asdict(state))}\n\n"

        return StreamingResponse(stream(), media_type="text/event-stream")

    async def layer(self, request: Request) -> Response:
        """Returns the values of a layer, see :meth:`.Picture.packed`, after multiplication by the request's
        :meth:`factors`.
        """
        picture, mix, name = self._viewer.latest(), self.factors(request), request.path_params["layer"]
        content, facts = await asyncio.to_thread(lambda: picture.mixed(mix).packed(name))
        return Response(content, media_type="application/octet-stream", headers=facts)

    async def pixel(self, request: Request) -> Response:
        """Returns, as JSON, the ``values`` of a pixel in all layers, and the name of the visible ``surface``; an empty
        object if there is no picture, or if it does not have this pixel.
        """
        x, y = (request.path_params[name] for name in "xy")
        picture, (width, height) = self._viewer.picture, self._viewer.state.size
        if picture is None or not (x < width and y < height):
            return JSONResponse({})  # the page still shows a larger image
        surface = await self._call(lambda viewer: viewer.scene.surface_at(x, y) if viewer.scene is not None else "")
        return JSONResponse({"values": picture.at(x, y, (width, height)), "surface": surface})

    async def explain(self, request: Request) -> Response:
        """Returns the page that explains a pixel, which may only run its own script."""
        x, y = (request.path_params[name] for name in "xy")
        page = await self._call(lambda viewer: viewer.explanation(x, y))
        return HTMLResponse(page, headers={"Content-Security-Policy": explanation_page.POLICY})

    async def save(self, request: Request) -> Response:
        """Returns the image as an EXR or PNG file, after multiplication by the request's :meth:`factors`; the exposure
        makes only the PNG brighter.
        """
        exposure, mix = clamped_number(request, "exposure", 64.0), self.factors(request)
        files = await self._call(lambda _: self._encode(exposure, mix))
        return Response(files[f".{request.path_params['suffix']}"], media_type="application/octet-stream")

    async def act(self, request: Request) -> Response:
        """Schedules an action, one of :data:`ACTIONS`, for the thread that renders. The query parameters ``x`` and
        ``y`` describe a camera motion.
        """
        motion, (x, y) = ACTIONS[request.path_params["action"]], (clamped_number(request, axis, 360.0) for axis in "xy")
        self._viewer.call(lambda viewer: viewer.move(lambda camera: motion(camera, x, y)))
        return Response(status_code=204)

    async def _call(self, work: Callable[[Viewer], Any]) -> Any:
        return await asyncio.wrap_future(self._viewer.call(work))

    def factors(self, request: Request) -> Factors:
        """Returns the factors by which a request multiplies layers of the picture that the integrator's parameter
        ``layers`` requests, from the query parameters ``mix``, such as ``lights.lamp1=0.5``. Raises ValueError for
        wrong ones, and without a picture.
        """
        names = [name for name in self._viewer.latest().layers if "." in name]
        return parse_factors(request.query_params.getlist("mix"), names)


def clamped_number(request: Request, name: str, limit: float) -> float:
    """Returns the query parameter ``name`` as a number in [-limit, limit]; 0 if it is missing. Raises ValueError if it
    is not a finite number.
    """
    value = float(request.query_params.get(name, "0"))
    if not isfinite(value):
        raise ValueError(f"{name} is {value}")
    return min(max(value, -limit), limit)
