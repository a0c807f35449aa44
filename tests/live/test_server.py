"""Who may ask the page's server, and for what; and how it ends."""

import http.client
import json
import resource
import select
import signal
import socket
import subprocess
import sys
from contextlib import suppress
from urllib.parse import urlsplit

import pytest
from click.testing import CliRunner
from little import LITTLE, ask, state_when, watching
from mitsuba_prosim.live import scene_watcher
from prosim_start import group
from waiting import PATIENCE, until

pytestmark = pytest.mark.slow


def test_server_answers_only_this_machine_with_the_token(address):
    url = urlsplit(address)
    port, token = url.port, url.path.strip("/")
    assert len(token) >= 32
    page, content = ask(address)
    assert page.status == 200 and b"<script" in content
    assert "default-src 'none'" in page.getheader("Content-Security-Policy")
    # At this end or the other one of a tunnel.
    assert ask(address, Host="localhost:9000")[0].status == 200
    for host in ("evil.example", f"evil.example:{port}", "127.0.0.1.evil.example", f"192.168.0.1:{port}", ""):
        assert ask(address, Host=host)[0].status == 403, host
    bare = f"http://127.0.0.1:{port}/"
    other = f"{token[:-1]}{'y' if token[-1] == 'x' else 'x'}/page.js"
    for path in ("", "page.js", "events", f"{token[:-1]}/", other, f"{token}x/", f"x/{token}/", "%2e%2e/"):
        assert ask(bare, path)[0].status == 403, path
    assert ask(bare, f"?token={token}")[0].status == 403
    for origin in "http://evil.example", "null":
        assert ask(address, "do/home", "POST", Origin=origin)[0].status == 403
    assert ask(address, "do/home", "POST", Origin=f"http://{url.netloc}")[0].status == 204
    # Nobody else can reach it: it listens at this machine's own address alone.
    others = {info[4][0] for info in socket.getaddrinfo(socket.gethostname(), None, socket.AF_INET)}
    for other in others - {"127.0.0.1", "127.0.1.1"}:
        with pytest.raises(ConnectionRefusedError):
            socket.create_connection((other, port), timeout=2).close()


def test_server_serves_only_its_own_files(address, scene):
    state_when(address, "done")
    (scene.parent / "secret.html").write_text("secret")
    files = "../secret.html secret.html ..%2fsecret.html %2e%2e/%2e%2e/etc/passwd little.scn server.py save/scn save/.."
    wrong = "layer/other pixel/-1/0 explain/-1/0 do/home do/orbit"
    for path in f"{files} {wrong}".split():
        answer, content = ask(address, path)
        assert answer.status in (404, 405) and b"secret" not in content, path
    assert ask(address, "pixel/64/0")[1] == b"{}"
    for path, status in ("everything", 404), ("orbit?x=nan", 400), ("pan?x=one", 400):
        assert ask(address, f"do/{path}", "POST")[0].status == status
    assert ask(address, "save/exr?exposure=bright")[0].status == 400
    answer, content = ask(address, "explain/64/0")
    assert (answer.status, content[:41]) == (400, b"the pixel 64,0 is outside the image, whos")
    answer, content = ask(address, "explain/1/2")
    allowed = answer.getheader("Content-Security-Policy")
    assert b"</html>" in content and allowed.startswith("sandbox allow-scripts; default-src 'none'; script-src 'unsafe")


def test_watch_ends_by_signals_and_refuses_a_used_port(path):
    with watching(path, "-t", "2") as (process, address):
        state_when(address, "done")
        port = urlsplit(address).port
        taken = CliRunner().invoke(group.prosim, ["watch", str(path), "--no-browser", "--port", str(port)])
        assert taken.exit_code == 1 and "--port" in taken.output
        process.send_signal(signal.SIGINT)
        assert process.wait(PATIENCE) == 0
        assert process.stderr.read() == ""
    assert [p.name for p in path.parent.iterdir()] == ["little.scn"]
    scalar = CliRunner().invoke(group.prosim, ["watch", str(path), "--no-browser", "-m", "scalar_rgb"])
    assert scalar.exit_code == 2 and "scalar_rgb" in scalar.output


# ---- Other programs of this machine that open connections without end


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


@pytest.fixture(scope="module")
def limited(tmp_path_factory):
    """The process and the address of a page whose process may open 64 files, and its scene."""
    path = tmp_path_factory.mktemp("limited") / "little.scn"
    path.write_text(LITTLE)
    limits, popen = resource.getrlimit(resource.RLIMIT_NOFILE), subprocess.Popen
    limit = {"preexec_fn": lambda: resource.setrlimit(resource.RLIMIT_NOFILE, (64, limits[1]))}
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(subprocess, "Popen", lambda *a, **k: popen(*a, **k, **limit))
        with watching(path, "-t", "1") as (process, address):
            patch.undo()
            yield process, address, path
            process.terminate()
            assert process.stderr.read() == ""


@pytest.mark.skipif(sys.platform == "win32", reason="limits of open files are of Unix")
@pytest.mark.parametrize("kind", CLIENTS)
def test_hostile_client_does_not_stop_the_page(limited, kind):
    """While it is at work, the owner's page answers, and an edit is shown; on two streams of the owner, too."""
    process, address, path = limited
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
    assert ask(address, "do/home", "POST")[0].status == 204
    path.write_text(f"{LITTLE}# {kind}\n")
    until(lambda: state_when(address, "done")["opened"] > state["opened"])
    assert states.readline().startswith(b"data: ")  # the stream of the owner was not closed
    lines = (line for line in iter(states.readline, b"") if line.startswith(b"data: "))
    assert any(json.loads(line[6:])["opened"] > state["opened"] for line in lines)
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
