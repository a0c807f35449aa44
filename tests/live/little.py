"""A little scene, and ``prosim watch`` of it as a process."""

import http.client
import json
import select
import shutil
import signal
import subprocess
import sys
import threading
from contextlib import contextmanager
from urllib.parse import urlsplit

import numpy as np
import pytest
from mitsuba_prosim.live.loaded_scene import LoadedScene
from mitsuba_prosim.live.viewer import Viewer
from mitsuba_prosim.scene.scene_file import SceneFile
from waiting import PATIENCE, started, until

#: Its path; None where there is none.
BROWSER = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome", "chrome"))), None)

LITTLE = """NAME: little
NSAMPLES: 2
AMBIENT 20000 20000 20000
LIGHTS AREA position 10 20 30 Intensity 600000 600000 600000 raio 4
BACKGROUND: 5000 6000 10000 NULL
VIEW RESOLUTION 64 48 WINDOW -4 -3 4 3 OBS 0 3 12 VRP 0 0 0
CSG-TREE + SPHERE 0 CUBE 1
SURFACE 0 ka = .2 .2 .2 kd = 0.6 0.2 0.1 ks = .3 .3 .3 n = 20
SURFACE 1 material lambertiano kd = 0.4 0.5 0.6
TRANSFORM 0 SCALE (2 2 2)
TRANSFORM 1 SCALE (9 1 9) TRANSLATE (-4 -3 -4)
END
"""


@contextmanager
def watching(scene, *options, start=("-m", "prosim_start")):
    """The process, and the address of its page."""
    command = [sys.executable, *start, "watch", str(scene), "--no-browser", *options]
    with started(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, bufsize=1) as process:
        try:
            written = select.select([process.stdout], [], [], PATIENCE)[0]
            line = process.stdout.readline() if written else "no address was printed"
            if " is shown at http://127.0.0.1:" not in line:
                process.kill()  # otherwise there is no end of what it says
                pytest.fail(line + process.stderr.read())
            yield process, line.split(" at ")[1].split()[0]
        finally:
            process.send_signal(signal.SIGINT)
            process.wait(PATIENCE)


def ask(address, path="", method="GET", **headers):
    """An answer of the page's server and its content; what is not given as a header is as a browser would say it."""
    url = urlsplit(address)
    connection = http.client.HTTPConnection("127.0.0.1", url.port, timeout=PATIENCE)
    connection.request(method, url.path + path, headers={"Host": url.netloc} | headers)
    answer = connection.getresponse()
    content = answer.read() if path != "events" else answer.readline()
    connection.close()
    return answer, content


def state_when(address, status):
    """The state of the page's viewer, as soon as its status is this."""
    states = []

    def found():
        states.append(json.loads(ask(address, "events")[1].removeprefix(b"data: ")))
        return states[-1]["status"] == status

    until(found)
    return states[-1]


def new_page(browser, **options):
    page = browser.new_page(**options)
    page.set_default_timeout(1000 * PATIENCE)
    return page


@contextmanager
def opened(browser, address, **options):
    """A page in the browser, which may say nothing on its console and ask nobody but its own server."""
    page, said, asked = new_page(browser, **options), [], []
    page.on("console", lambda message: said.append(message.text))
    page.on("pageerror", lambda error: said.append(str(error)))
    page.on("request", lambda request: asked.append(request.url))
    page.goto(address)
    try:
        yield page
    finally:
        page.close()
    assert said == [] and all(url.startswith((address, "blob:", "data:")) for url in asked)


def shown(page):
    """The pixels of the canvas, shape (height, width, 3)."""
    width, height, data = page.evaluate(
        """() => { const c = document.getElementById("canvas"), copy = new OffscreenCanvas(c.width, c.height);
        const context = copy.getContext("2d", {willReadFrequently: true});  // otherwise Chrome gives advice
        context.drawImage(c, 0, 0);
        return [c.width, c.height, [...context.getImageData(0, 0, c.width, c.height).data]]; }"""
    )
    return np.array(data).reshape(height, width, 4)[..., :3]


@contextmanager
def running(path, opened=lambda: None, **options):
    """A viewer in a thread, which lists what it published as ``said``.

    ``opened`` is called when the scene has been read, before the viewer has it.
    """

    def open_scene():
        scene = LoadedScene(SceneFile(path, path.parent / "scratch"))
        opened()
        return scene

    viewer = Viewer(path, open_scene, **options)
    publish, viewer.said = viewer.publish, []

    def published(picture=None, **changes):
        publish(picture, **changes)
        viewer.said.append(viewer.picture)

    viewer.publish = published
    thread = threading.Thread(target=viewer.run)
    thread.start()
    try:
        yield viewer
        assert thread.is_alive()
    finally:
        viewer.close()
        thread.join(PATIENCE)
        assert not thread.is_alive()


def save(viewer, path, text):
    """Saves, and waits until the scene is opened again."""
    opened = viewer.state.opened
    path.write_text(text)
    until(lambda: viewer.state.opened != opened)


def move(viewer, by):
    """Moves the camera, and waits for the image."""
    viewer.call(lambda viewer: viewer.move(by)).result(PATIENCE)
    until(lambda: viewer.state.view is not None and viewer.state.status == "done")


def surface_at(viewer, x, y):
    return viewer.call(lambda viewer: viewer.scene.surface_at(x, y)).result(PATIENCE)


def is_(viewer, doing, opened=1):
    """Waits for a status of the viewer, which has opened the scene so many times, or more often."""
    until(lambda: viewer.state.status == doing and viewer.state.opened >= opened)
