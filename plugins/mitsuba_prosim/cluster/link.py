"""What is asked of the workers of a Dask client, and the files that travel to them."""

from __future__ import annotations

import asyncio
import hashlib
from collections.abc import Callable, Coroutine, Iterable
from concurrent.futures import Future
from typing import Any

import dask
import distributed


class Link:
    """A Dask client whose loop does what is begun here."""

    def __init__(self, client: distributed.Client) -> None:
        self.client = client
        #: Whether workers answer directly; None where nobody knows yet.
        self.direct: bool | None = None
        self._files: dict[str, distributed.Future] = {}

    def begin(self, coroutine: Coroutine[Any, Any, None]) -> Future:
        """Lets the loop of the client run it."""
        assert self.client.loop is not None
        return asyncio.run_coroutine_threadsafe(coroutine, self.client.loop.asyncio_loop)  # type: ignore[attr-defined]

    async def present(self) -> frozenset[str] | None:
        """The addresses of the workers that are there; None where nobody knows any more."""
        try:
            if self.client.status != "running":
                return None
            scheduler: Any = self.client.scheduler
            return frozenset(await scheduler.ncores())
        except (OSError, ValueError, TypeError, AttributeError):  # whatever is left of a connection says
            return None

    def submit(
        self, address: str | None, function: Callable[..., Any], *arguments: Any, key: str | None = None
    ) -> distributed.Future:
        """What a worker is to do, or any of them."""
        with dask.config.set({"distributed.admin.large-graph-warning-threshold": "1 TiB"}):
            return self.client.submit(
                function, *arguments, key=key, pure=False, workers=None if address is None else [address]
            )

    async def outcome(self, future: distributed.Future, direct: bool | None = None, release: bool = True) -> Any:
        """What came of it, or the error."""
        try:
            direct = self.direct if direct is None else direct
            return await self.client.gather(future, direct=direct, asynchronous=True)
        except (Exception, distributed.CancelledError) as error:  # noqa: BLE001
            return error
        finally:
            if release:
                future.release()

    def file(self, content: bytes) -> distributed.Future:
        """A file's content, which the workers pass on to each other."""
        key = content_key(content)
        if key not in self._files:
            self._files[key] = self.submit(None, bytes, content, key=key)
        return self._files[key]

    def has(self, content: bytes) -> bool:
        """Whether that was asked for already."""
        return content_key(content) in self._files

    def keep(self, contents: Iterable[bytes]) -> None:
        """Forgets all files but these."""
        for key in set(self._files) - set(map(content_key, contents)):
            self._files.pop(key).release()


def content_key(content: bytes) -> str:
    """Name of a file's content among what Dask keeps."""
    return f"prosim-{hashlib.sha256(content).hexdigest()}"
