"""The server of the live page. Only users of this machine who know the secret address can open the page."""

from __future__ import annotations

import asyncio
import json
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
from starlette.exceptions import HTTPException
from starlette.middleware import Middleware
from starlette.middleware.base import BaseHTTPMiddleware, RequestResponseEndpoint
from starlette.requests import Request
from starlette.responses import JSONResponse, PlainTextResponse, Response, StreamingResponse
from starlette.routing import BaseRoute, Mount, Route
from starlette.staticfiles import StaticFiles

from ..denoising.layers import parse_factor
from .picture import Factors, Picture
from .viewer import Viewer

#: A function of the exposure in stops and of the factors of layers, which is called in the thread that renders. The
#: function returns the contents of the image's files: suffix -> content.
Encoder = Callable[[float, Factors], dict[str, bytes]]

#: Name of an action of the page -> the function that changes the view request. Two numbers describe a camera motion.
ACTIONS: dict[str, Callable[[Viewer, float, float], None]] = {
    "pause": lambda viewer, *_: viewer.change(paused=True),
    "resume": lambda viewer, *_: viewer.change(paused=False),
    "compare": lambda viewer, *_: viewer.change(compared=True),
    "alone": lambda viewer, *_: viewer.change(compared=False),
    "home": lambda viewer, *_: viewer.change(camera=None, paused=False),
    "orbit": lambda viewer, x, y: viewer.move(lambda camera: camera.orbited(x, y)),
    "pan": lambda viewer, x, y: viewer.move(lambda camera: camera.panned(x, y)),
    "dolly": lambda viewer, x, _: viewer.move(lambda camera: camera.dollied(x)),
}

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


@contextmanager
def served(viewer: Viewer, encode: Encoder, sock: socket.socket) -> Iterator[str]:
    """Serves the page in another thread, and yields the address of the page. The server ends at the end of the ``with``
    block.

    ``encode`` makes the files that the user saves. ``sock`` is the socket that listens.
    """
    token = secrets.token_urlsafe(24)
    routes = [Mount(f"/{token}", routes=Pages(viewer, encode).routes())]
    config = uvicorn.Config(
        Starlette(routes=routes, middleware=[Middleware(BaseHTTPMiddleware, dispatch=guard(token))]),
        log_config=None,
        log_level="critical",
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
        viewer.close()
        server.should_exit = True
        thread.join(3)
        sock.close()


def guard(token: str) -> Callable[[Request, RequestResponseEndpoint], Any]:
    """Returns a middleware that refuses requests without the token, for another host name, or from another site's
    page.
    """

    async def dispatch(request: Request, call_next: RequestResponseEndpoint) -> Response:
        """Answers a request whose address has the token and whose headers name this machine; refuses other requests."""
        host, origin = request.headers.get("host", ""), request.headers.get("origin")
        first_folder = request.scope["path"].lstrip("/").partition("/")[0]
        authorised = secrets.compare_digest(first_folder.encode(), token.encode())
        if authorised and HOSTS.fullmatch(host) and origin in (None, f"http://{host}"):
            response = await call_next(request)
        else:
            response = PlainTextResponse("Refused: open the address that prosim watch printed.\n", 403)
        response.headers.update(HEADERS)
        return response

    return dispatch


class Pages:
    """The responses to requests of the page. ``encode`` makes the files that the user saves."""

    def __init__(self, viewer: Viewer, encode: Encoder) -> None:
        self._viewer, self._publisher, self._encode = viewer, viewer.publisher, encode

    def routes(self) -> list[BaseRoute]:
        """Returns the routes of the requests that the page sends, and of the page's own files."""
        return [
            Route("/events", self.events),
            Route("/layer/{image}/{layer}", self.layer),
            Route("/pixel/{x:int}/{y:int}", self.pixel),
            Route("/save/{suffix}", self.save),
            Route("/do/{action}", self.act, methods=["POST"]),
            Mount("/", StaticFiles(packages=[(__package__, "page")], html=True)),
        ]

    async def events(self, _: Request) -> Response:
        """Streams the state of the viewer to the page, at first and after each change."""

        async def stream() -> AsyncIterator[str]:
            """Yields each state as a server-sent event."""
            async for state in self._publisher.follow():
                yield f"data: {json.dumps(asdict(state))}\n\n"

        return StreamingResponse(stream(), media_type="text/event-stream")

    async def layer(self, request: Request) -> Response:
        """Returns the values of a layer of a picture, see :meth:`.Picture.packed`.

        The request may have factors of layers, see :func:`factors`.
        """
        picture, name = self._publisher.pictures.get(request.path_params["image"]), request.path_params["layer"]
        if picture is None or name not in picture.layers:
            raise HTTPException(404)
        mix = factors(request, picture)
        content, facts = await asyncio.to_thread(lambda: picture.mixed(mix).packed(name))
        return Response(content, media_type="application/octet-stream", headers=facts)

    async def pixel(self, request: Request) -> Response:
        """Returns the values of a pixel in all layers of all pictures, and the name of its visible surface."""
        x, y = (request.path_params[name] for name in "xy")
        width, height = self._publisher.state.size
        if not (x < width and y < height):
            return JSONResponse({})  # the page still shows a larger image
        values = {name: picture.at(x, y, (width, height)) for name, picture in self._publisher.pictures.items()}
        surface = await self._call(lambda viewer: viewer.scene.surface_at(x, y) if viewer.scene is not None else "")
        return JSONResponse({**values, "surface": surface})

    async def save(self, request: Request) -> Response:
        """Returns the image of the scene's integrator as an EXR or PNG file, after applying factors and exposure."""
        picture, suffix = self._publisher.pictures.get("own"), f".{request.path_params['suffix']}"
        if picture is None or suffix not in (".exr", ".png"):
            raise HTTPException(404)
        exposure, mix = clamped_number(request, "exposure", 64.0), factors(request, picture)
        files = await self._call(lambda _: self._encode(exposure, mix))
        return Response(files[suffix], media_type="application/octet-stream")

    async def act(self, request: Request) -> Response:
        """Schedules one of the :data:`ACTIONS`, whose name is in the address, in the thread that renders."""
        name = request.path_params["action"]
        if name not in ACTIONS:
            raise HTTPException(404)
        x, y = (clamped_number(request, axis, 360.0) for axis in "xy")
        if name == "dolly" and not x > 0:
            raise HTTPException(400)
        self._viewer.call(lambda viewer: ACTIONS[name](viewer, x, y))
        return Response(status_code=204)

    async def _call(self, work: Callable[[Viewer], Any]) -> Any:
        """Executes a function in the thread that renders, and returns its result."""
        return await asyncio.wrap_future(self._viewer.call(work))


def factors(request: Request, picture: Picture) -> Factors:
    """Returns the factors of layers in a request, see :func:`.parse_factor`.

    The factors are the query parameters ``mix``, such as ``lights.lamp1=0.5``. Raises HTTPException for wrong
    parameters, for two factors of one layer, and for a layer that the picture does not have.
    """
    texts = request.query_params.getlist("mix")
    try:
        result = dict(map(parse_factor, texts))
    except ValueError:
        raise HTTPException(400) from None
    if len(result) < len(texts) or not all("." in name and name in picture.layers for name in result):
        raise HTTPException(400)
    return list(result.items())


def clamped_number(request: Request, name: str, limit: float) -> float:
    """Returns a query parameter as a number, clamped to [-limit, limit]; 0 if it is missing. Raises HTTPException."""
    try:
        value = float(request.query_params.get(name, "0"))
    except ValueError:
        raise HTTPException(400) from None
    if not isfinite(value):
        raise HTTPException(400)
    return min(max(value, -limit), limit)
