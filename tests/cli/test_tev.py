"""``prosim render --view tev``, before a socket that hears what tev would."""

import socket
import struct
import threading

import numpy as np
import pytest
from mitsuba_prosim.cli import tev
from mitsuba_prosim.scene import throttle
from running import done, pixels, refused
from waiting import PATIENCE

tevclient = pytest.importorskip("tevclient", reason="tevclient is not installed (it needs Python 3.11)")

CREATE, UPDATE = 4, 6


class Tev:
    """Listens; ``end``: leaves after so many bytes."""

    def __init__(self, end=1 << 30):
        self.socket = socket.create_server(("127.0.0.1", 0))
        self.place = f"tev=127.0.0.1:{self.socket.getsockname()[1]}"
        self.heard, self.end = b"", end
        self.thread = threading.Thread(target=self.listen, daemon=True)
        self.thread.start()

    def listen(self):
        connection, _ = self.socket.accept()
        connection.settimeout(None)  # that of the process may be another's just now
        with connection:
            while len(self.heard) < self.end and (more := connection.recv(1 << 16)):
                self.heard += more

    def packets(self):
        """``(type, content)`` of each, when nothing more comes."""
        self.thread.join(PATIENCE)
        self.socket.close()
        rest, result = self.heard, []
        while rest:
            (length,) = struct.unpack("<I", rest[:4])
            result.append((rest[4], rest[5:length]))
            rest = rest[length:]
        return result


def test_waves_are_sent_and_the_last_is_the_image(palito, monkeypatch):
    monkeypatch.setattr(throttle, "DRAW_INTERVAL", 0.0)
    monkeypatch.setattr(throttle, "DRAW_FRACTION", 1e9)
    viewer = Tev()
    done("render", palito, "--resolution", "24x16", "--samples", 2, "--view", viewer.place)
    (kind, first), *updates = viewer.packets()
    assert kind == CREATE and first[1:9] == b"listing\0" and struct.unpack("<3i", first[9:21]) == (24, 16, 3)
    assert {kind for kind, _ in updates} == {UPDATE} and len(updates) > 2
    image = np.frombuffer(updates[-1][1][-24 * 16 * 12 :], dtype="<f4").reshape(16, 24, 3)
    assert np.array_equal(image, pixels(palito.with_suffix(".exr")))


def test_lost_tev_does_not_stop_the_render(scene, monkeypatch):
    with socket.create_server(("127.0.0.1", 0)) as unused:
        port = unused.getsockname()[1]
    refused(f"no tev at 127.0.0.1:{port}", "render", scene, "--view", f"tev=127.0.0.1:{port}", code=1)
    viewer = Tev(end=1)
    said = done("render", scene, "--view", viewer.place, "--resolution", "640x480", "--spp", 1).stderr
    assert "tev has ended" in said and scene.with_suffix(".exr").exists()
    viewer.packets()
    # One that is there, but takes nothing.
    monkeypatch.setattr(tev, "SOCKET_TIMEOUT", 0.3)
    with socket.create_server(("127.0.0.1", 0)) as deaf:
        deaf.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 1 << 12)
        place = f"tev=127.0.0.1:{deaf.getsockname()[1]}"
        said = done("render", scene, "--view", place, "--resolution", "960x720", "--spp", 1).stderr
    assert "tev has ended (timed out)" in said


def test_a_tev_that_leaves_at_once_leaves_no_connection(scene, monkeypatch):
    def broken(*client):
        clients.append(client)  # which are not closed by being forgotten
        raise BrokenPipeError(32, "Broken pipe")

    clients, viewer = [], Tev()
    monkeypatch.setattr(tevclient.Ipc, "create_image", broken)
    refused("(Broken pipe)", "render", scene, "--view", viewer.place, code=1)
    assert clients and viewer.packets() == [] and not viewer.thread.is_alive()
