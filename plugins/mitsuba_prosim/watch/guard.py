"""Who may ask: whoever knows the token, by a name of this machine, and no other site's page."""

from __future__ import annotations

import re
import secrets
from collections.abc import Awaitable, Callable, MutableMapping
from typing import Any

from starlette.requests import Request
from starlette.responses import PlainTextResponse

#: The names that a browser on this machine, or at the other end of a tunnel, has for it. A page of another site that
#: has its own name lead here is refused by this.
HOSTS = re.compile(r"(127\.0\.0\.1|localhost|\[::1\])(:\d{1,5})?")

HEADERS = {
    "Content-Security-Policy": "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self' data: blob:; "
    "connect-src 'self'; base-uri 'none'; form-action 'none'; frame-ancestors 'none'",
    "X-Content-Type-Options": "nosniff",
    "Referrer-Policy": "no-referrer",
    "Cache-Control": "no-store",
}


class Guard:
    """Lets only those requests pass that come by a name of this machine, from no other page, and know the token."""

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
                message["headers"] = [
                    *message["headers"],
                    *((name.lower().encode(), value.encode()) for name, value in HEADERS.items()),
                ]
            await send(message)

        request = Request(scope)
        host, origin = request.headers.get("host", ""), request.headers.get("origin")
        given = scope["path"].lstrip("/").partition("/")[0]
        if (
            not HOSTS.fullmatch(host)
            or (origin is not None and origin != f"http://{host}")
            or not secrets.compare_digest(given.encode(), self.token.encode())
        ):
            refusal = PlainTextResponse("Refused: open the address that prosim watch has printed.\n", 403)
            await refusal(scope, receive, sealed)
            return
        await self.app(scope, receive, sealed)
