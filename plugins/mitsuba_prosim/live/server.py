"""The page's server, which only this machine and only who knows the address can reach."""

from __future__ import annotations

import asyncio
import json
import re
import secrets
import socket
import threading
from collections.abc import AsyncIterator, Awaitable, Callable, Iterator, MutableMapping
from contextlib import contextmanager
from dataclasses import asdict
from math import isfinite
from typing import Any
from urllib.parse import quote

import uvicorn
from starlette.applications import Starlette
from starlette.exceptions import HTTPException
from starlette.requests import Request
from starlette.responses import JSONResponse, PlainTextResponse, Response, StreamingResponse
from starlette.routing import BaseRoute, Mount, Route
from starlette.staticfiles import StaticFiles

from .camera import Camera
from .viewer import Viewer

#: Seconds that a page waits for the thread that renders.
PATIENCE = 60.0

#: Exposure -> contents of the image's files by suffix; the thread that renders calls it.
Encoder = Callable[[float], dict[str, bytes]]

#: Gestures -> the camera after them; their arguments are two numbers.
GESTURES: dict[str, Callable[[Camera, float, float], Camera]] = {
    "orbit": lambda camera, x, y: camera.orbited(x, y),
    "pan": lambda camera, x, y: camera.panned(x, y),
    "dolly": lambda camera, x, _: camera.dollied(x),
}

#: Names of this machine in a browser here or at the other end of a tunnel. Other names are refused, as another site may
#: have made its own name lead here.
HOSTS = re.compile(r"(127\.0\.0\.1|localhost|\[::1\])(:\d{1,5})?")

HEADERS = {
    "Content-Security-Policy": "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self' data: blob:; "
    "connect-src 'self'; base-uri 'none'; form-action 'none'; frame-ancestors 'none'",
    "X-Content-Type-Options": "nosniff",
    "Referrer-Policy": "no-referrer",
    "Cache-Control": "no-store",
}


def bound(port: int) -> socket.socket:
    """A socket at 127.0.0.1; port 0: any free one. Raises OSError."""
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
def served(viewer: Viewer, encode: Encoder, sock: socket.socket) -> Iterator[str]:
    """Serves the page in a thread; yields its address."""
    token = secrets.token_urlsafe(24)
    routes = Pages(viewer, encode).routes()
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
        viewer.publisher.closed = True
        server.should_exit = True
        thread.join(3)
        sock.close()


class Guard:
    """Refuses requests without the token, by another host name, or from another site's page."""

    def __init__(self, app: Any, token: str) -> None:
        self.app, self.token = app, token

    async def __call__(
        self,
        scope: MutableMapping[str, Any],
        receive: Callable[[], Awaitable[Any]],
        send: Callable[[Any], Awaitable[None]],
    ) -> None:
        """An ASGI application."""
        if scope["type"] != "http":
            return

        async def sealed(message: MutableMapping[str, Any]) -> None:
            if message["type"] == "http.response.start":
                more = ((name.lower().encode(), value.encode()) for name, value in HEADERS.items())
                message["headers"] = [*message["headers"], *more]
            await send(message)

        request = Request(scope)
        host, origin = request.headers.get("host", ""), request.headers.get("origin")
        given = scope["path"].lstrip("/").partition("/")[0]
        if (
            not HOSTS.fullmatch(host)
            or (origin is not None and origin != f"http://{host}")
            or not secrets.compare_digest(given.encode(), self.token.encode())
        ):
            refusal = PlainTextResponse("Refused: open the address that prosim watch printed.\n", 403)
            await refusal(scope, receive, sealed)
            return
        await self.app(scope, receive, sealed)


class Pages:
    """The answers to the page; ``encode`` makes the files to save."""

    def __init__(self, viewer: Viewer, encode: Encoder) -> None:
        self._requests, self._publisher, self._encode = viewer.requests, viewer.publisher, encode
        self._actions: dict[str, Callable[[], None]] = {
            "stop": lambda: self._requests.change(stopped=True),
            "go": lambda: self._requests.change(stopped=False),
            "compare": lambda: self._requests.change(compared=True),
            "alone": lambda: self._requests.change(compared=False),
            "home": lambda: self._requests.change(camera=None, stopped=False),
        }

    def routes(self) -> list[BaseRoute]:
        """The addresses."""
        return [
            Route("/events", self.events),
            Route("/layer/{take}/{layer}", self.layer),
            Route("/pixel/{x:int}/{y:int}", self.pixel),
            Route("/save/{suffix}", self.save),
            Route("/do/{doing}", self.act, methods=["POST"]),
            Route("/move/{gesture}", self.move, methods=["POST"]),
            Mount("/", StaticFiles(packages=[(__package__, "page")], html=True)),
        ]

    async def events(self, _: Request) -> Response:
        """The state, and each newer one, as events."""

        async def stream() -> AsyncIterator[str]:
            async for state in self._publisher.follow():
                yield f"data: {json.dumps(asdict(state))}\n\n" if state else "event: here\ndata:\n\n"

        return StreamingResponse(stream(), media_type="text/event-stream")

    async def layer(self, request: Request) -> Response:
        """A layer of a picture; see :meth:`.Picture.packed`."""
        picture, name = self._publisher.pictures.get(request.path_params["take"]), request.path_params["layer"]
        if picture is None or name not in picture.layers:
            raise HTTPException(404)
        content, facts = await asyncio.to_thread(picture.packed, name)
        return Response(content, media_type="application/octet-stream", headers=facts)

    async def pixel(self, request: Request) -> Response:
        """The values of a pixel, and its surface."""
        x, y = (request.path_params[name] for name in "xy")
        width, height = self._publisher.state.size
        if not (x < width and y < height):
            return JSONResponse({})  # the page shows a larger image still
        found: dict[str, Any] = {
            name: picture.at(x, y, (width, height)) for name, picture in self._publisher.pictures.items()
        }
        surface = self._requests.call(lambda scene: scene.surface_at(x, y) if scene is not None else "")
        found["surface"] = await asyncio.wait_for(asyncio.wrap_future(surface), PATIENCE)
        return JSONResponse(found)

    async def save(self, request: Request) -> Response:
        """A file of the image, with an exposure."""
        suffix = f".{request.path_params['suffix']}"
        exposure = number(request, "exposure", 64.0)
        if not self._publisher.pictures or suffix not in (".exr", ".png"):
            raise HTTPException(404)
        making = self._requests.call(lambda _: self._encode(exposure))
        made = await asyncio.wait_for(asyncio.wrap_future(making), PATIENCE)
        name = (self._publisher.state.scene.rpartition(".")[0] or "picture") + suffix
        plain, whole = re.sub(r"[^\w.-]", "_", name, flags=re.ASCII), quote(name, safe="", errors="replace")
        return Response(
            made[suffix],
            media_type="application/octet-stream",
            headers={"Content-Disposition": f"attachment; filename={plain}; filename*=UTF-8''{whole}"},
        )

    async def act(self, request: Request) -> Response:
        """Pauses, continues, compares, or returns to the scene's view."""
        doing = request.path_params["doing"]
        if doing not in self._actions:
            raise HTTPException(404)
        self._actions[doing]()
        return Response(status_code=204)

    async def move(self, request: Request) -> Response:
        """Moves the camera."""
        gesture = GESTURES.get(request.path_params["gesture"])
        if gesture is None:
            raise HTTPException(404)
        x, y = (number(request, name, 360.0) for name in "xy")
        if gesture is GESTURES["dolly"] and not x > 0:
            raise HTTPException(400)
        self._requests.move(lambda camera: gesture(camera, x, y))
        return Response(status_code=204)


def number(request: Request, name: str, most: float) -> float:
    """A parameter of a request, at most ``most`` from 0, which is the default. Raises HTTPException."""
    try:
        value = float(request.query_params.get(name, "0"))
    except ValueError:
        raise HTTPException(400) from None
    if not isfinite(value):
        raise HTTPException(400)
    return min(max(value, -most), most)
