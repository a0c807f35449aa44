"""Other programs of this machine that open connections without end: the page answers its owner, and the scene opens."""

import http.client
import re
import resource
import select
import socket
import subprocess
import sys
from contextlib import suppress
from urllib.parse import urlsplit

import pytest
from little import LITTLE, ask, state_when, watching
from mitsuba_prosim.live import scene_watcher
from waiting import PATIENCE, until

pytestmark = pytest.mark.slow

REFUSED = b"GET /x HTTP/1.1\r\nHost: x\r\n\r\n"
#: What a hostile client sends on each connection, and its number of connections.
CLIENTS = {
    "silent": (b"", 2000),
    "half a request": (b"GET / HTTP/1.1\r\nX: ", 2000),
    "many requests, no answer read": (REFUSED * 20000, 60),
    "a long body": (b"POST / HTTP/1.1\r\nHost: x\r\nContent-Length: 1000000000\r\n\r\n" + b"x" * 1000000, 60),
    "no HTTP": (bytes(range(256)) * 100, 500),
    "an upgrade": (b"GET / HTTP/1.1\r\nHost: x\r\nConnection: upgrade\r\nUpgrade: websocket\r\n\r\n", 500),
}


@pytest.fixture
def limited(path, monkeypatch):
    """The process and the address of a page whose process may open 64 files; its lines on stderr follow."""
    path.write_text(LITTLE)
    limits = resource.getrlimit(resource.RLIMIT_NOFILE)
    popen = subprocess.Popen
    limit = {"preexec_fn": lambda: resource.setrlimit(resource.RLIMIT_NOFILE, (64, limits[1]))}
    monkeypatch.setattr(subprocess, "Popen", lambda *a, **k: popen(*a, **k, **limit))
    with watching(path, "-t", "1") as (process, address):
        monkeypatch.undo()
        yield process, address
        process.terminate()
        assert process.stderr.read() == ""


@pytest.mark.skipif(sys.platform == "win32", reason="limits of open files are of Unix")
@pytest.mark.parametrize("kind", CLIENTS)
def test_hostile_client_does_not_stop_the_page(limited, path, kind):
    """While it is at work, the owner's page answers, and an edit is shown; on two streams of the owner, too."""
    process, address = limited
    content, number = CLIENTS[kind]
    state = state_when(address, "done")
    place = "127.0.0.1", urlsplit(address).port
    stream = http.client.HTTPConnection(*place, timeout=PATIENCE)
    stream.request("GET", urlsplit(address).path + "events")
    states = stream.getresponse()
    clients = []
    for n in range(number):
        clients.append(client := socket.create_connection(place, timeout=PATIENCE))
        client.setblocking(False)
        with suppress(OSError):
            client.send(content)
        if n % (number // 5) == 0:
            assert ask(address)[0].status == 200
    assert ask(address, "do/pause", "POST")[0].status == 204
    path.write_text(LITTLE + "# edited\n")
    until(lambda: state_when(address, "done")["opened"] > state["opened"])
    assert states.readline().startswith(b"data: ")  # the stream of the owner was not closed
    assert any(re.search(rb'"opened": [2-9]', line) for line in iter(states.readline, b""))
    assert process.poll() is None
    for client in clients:
        client.close()


#: The command, whose server waits for less time.
IMPATIENT = "import mitsuba_prosim.live.server as s; from prosim_start import main; s.TIMEOUT /= 10; main()"


def test_silent_connection_is_closed(path):
    with watching(path, start=("-c", IMPATIENT)) as (_, address):
        client = socket.create_connection(("127.0.0.1", urlsplit(address).port), timeout=PATIENCE)
        client.sendall(b"GET / HTTP/1.1\r\nX: ")
        with suppress(ConnectionError):
            until(lambda: select.select([client], [], [], 0.2)[0] or client.sendall(b"x"))
            assert client.recv(100) == b""


def test_folder_that_cannot_be_read_is_not_watched(path, monkeypatch):
    def fails(*_):
        raise OSError(24, "Too many open files")

    monkeypatch.setattr(type(path), "glob", fails)
    watcher = scene_watcher.SceneWatcher(path)
    watcher.failed()
    assert {path.absolute(), path.absolute().parent} == set(watcher.stamps)
