"""What the page asks for."""

from __future__ import annotations

import asyncio
import json
import re
from collections.abc import AsyncIterator, Callable
from dataclasses import asdict
from importlib.resources import files
from typing import Any
from urllib.parse import quote

from starlette.exceptions import HTTPException
from starlette.requests import Request
from starlette.responses import JSONResponse, Response, StreamingResponse
from starlette.routing import BaseRoute, Route

from .board import Board
from .camera import Camera
from .desk import Desk

#: The page's files, and nothing else that there is on the disk.
TYPES = {".html": "text/html", ".css": "text/css", ".js": "text/javascript"}

#: Seconds after which a page that hears nothing is told so much, so that each notices where the other has gone.
SILENCE = 15.0

#: Seconds that a page waits for what the rendering thread is asked for.
PATIENCE = 60.0

#: Suffix -> the content of a file of the picture, which the rendering thread makes, at an exposure.
Encoder = Callable[[float], dict[str, bytes]]

#: What a gesture does to the camera, by two numbers.
GESTURES: dict[str, Callable[[Camera, float, float], Camera]] = {
    "orbit": lambda camera, x, y: camera.orbited(x, y),
    "pan": lambda camera, x, y: camera.panned(x, y),
    "dolly": lambda camera, x, _: camera.dollied(x),
}


class Pages:
    """The answers to every page, which shows what is on ``board``, and wishes at ``desk``; ``encode`` makes the files
    that are saved.
    """

    def __init__(self, desk: Desk, board: Board, encode: Encoder) -> None:
        self._desk, self._board, self._encode = desk, board, encode
        self._actions: dict[str, Callable[[], None]] = {
            "stop": lambda: desk.stop(True),
            "go": lambda: desk.stop(False),
            "compare": lambda: desk.compare(True),
            "alone": lambda: desk.compare(False),
            "home": desk.home,
        }
        folder = files(__package__).joinpath("page")
        self._content = {file.name: file.read_bytes() for file in folder.iterdir() if file.name.endswith(tuple(TYPES))}

    def routes(self) -> list[BaseRoute]:
        """What is asked for by which address."""
        return [
            Route("/", self.page),
            Route("/events", self.events),
            Route("/layer/{take}/{layer}", self.layer),
            Route("/pixel/{x:int}/{y:int}", self.pixel),
            Route("/save/{suffix}", self.save),
            Route("/do/{doing}", self.act, methods=["POST"]),
            Route("/move/{gesture}", self.move, methods=["POST"]),
            Route("/{name}", self.page),
        ]

    async def page(self, request: Request) -> Response:
        """A file of the page."""
        name = request.path_params.get("name", "index.html")
        found = self._content.get(name)
        if found is None:
            raise HTTPException(404)
        return Response(found, media_type=TYPES[name[name.rindex(".") :]])

    async def events(self, request: Request) -> Response:
        """The state, and each newer one, as events."""

        async def stream() -> AsyncIterator[str]:
            states = self._board.follow()
            following: asyncio.Future[Any] | None = None
            try:
                while True:
                    following = following or asyncio.ensure_future(anext(states, None))
                    done, _ = await asyncio.wait([following], timeout=SILENCE)
                    if not done:
                        yield "event: here\ndata:\n\n"
                        continue
                    state, following = following.result(), None
                    if state is None:
                        return
                    yield f"data: {json.dumps(asdict(state))}\n\n"
            finally:
                if following is not None:
                    following.cancel()

        return StreamingResponse(stream(), media_type="text/event-stream")

    async def layer(self, request: Request) -> Response:
        """A layer of a picture, as :meth:`.Picture.packed` has it."""
        take, name = request.path_params["take"], request.path_params["layer"]
        picture = self._board.pictures.get(take)
        if picture is None or name not in picture.layers:
            raise HTTPException(404)
        content, facts = await asyncio.to_thread(picture.packed, name)
        return Response(content, media_type="application/octet-stream", headers=facts)

    async def pixel(self, request: Request) -> Response:
        """The values of a pixel, and what is seen there."""
        x, y = (request.path_params[name] for name in "xy")
        width, height = self._board.state.size
        if not (x < width and y < height):
            raise HTTPException(404)
        found: dict[str, Any] = {}
        for name, picture in self._board.pictures.items():
            found[name] = picture.at(x, y, (width, height))
        seen = self._desk.errand(lambda subject: subject.seen(x, y) if subject is not None else "")
        found["seen"] = await asyncio.wait_for(asyncio.wrap_future(seen), PATIENCE)
        return JSONResponse(found)

    async def save(self, request: Request) -> Response:
        """A file of the picture, made at an exposure."""
        suffix = f".{request.path_params['suffix']}"
        try:
            exposure = min(max(float(request.query_params.get("exposure", "0")), -64.0), 64.0)
        except ValueError:
            raise HTTPException(400) from None
        if not self._board.pictures or suffix not in (".exr", ".png"):
            raise HTTPException(404)
        making = self._desk.errand(lambda _: self._encode(exposure))
        made = await asyncio.wait_for(asyncio.wrap_future(making), PATIENCE)
        name = (self._board.state.scene.rpartition(".")[0] or "picture") + suffix
        plain, whole = re.sub(r"[^\w.-]", "_", name, flags=re.ASCII), quote(name, safe="", errors="replace")
        return Response(
            made[suffix],
            media_type="application/octet-stream",
            headers={"Content-Disposition": f"attachment; filename={plain}; filename*=UTF-8''{whole}"},
        )

    async def act(self, request: Request) -> Response:
        """Stops, goes on, compares, or goes back to the scene's view."""
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
        try:
            x, y = (min(max(float(request.query_params.get(name, "0")), -360.0), 360.0) for name in "xy")
        except ValueError:
            raise HTTPException(400) from None
        if x != x or y != y or (gesture is GESTURES["dolly"] and not x > 0):
            raise HTTPException(400)
        self._desk.move(lambda camera: gesture(camera, x, y))
        return Response(status_code=204)
