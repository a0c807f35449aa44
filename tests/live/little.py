"""A little scene, and ``prosim watch`` of it as a process."""

import os
import select
import shutil
import signal
import subprocess
import sys
import threading
import time
from contextlib import contextmanager

from mitsuba_prosim.live.viewer import Viewer
from mitsuba_prosim.scene.scene_file import SceneFile, pick_sensor

#: Its path; None where there is none.
BROWSER = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome", "chrome"))), None)

LITTLE = """NAME: little
NSAMPLES: 2
AMBIENT 20000 20000 20000
LIGHTS
AREA position 10 20 30 Intensity 600000 600000 600000 raio 4
BACKGROUND: 5000 6000 10000 NULL
VIEW
RESOLUTION 64 48
WINDOW -4 -3 4 3
OBS 0 3 12
VRP 0 0 0
CSG-TREE
+ SPHERE 0 CUBE 1
SURFACE 0 ka = .2 .2 .2 kd = 0.6 0.2 0.1 ks = .3 .3 .3 n = 20
SURFACE 1 material lambertiano kd = 0.4 0.5 0.6
TRANSFORM 0 SCALE (2 2 2)
TRANSFORM 1 SCALE (9 1 9) TRANSLATE (-4 -3 -4)
END
"""


@contextmanager
def watching(scene, *options):
    """The process, and the address of its page."""
    command = [sys.executable, "-m", "prosim_start", "watch", str(scene), "--no-browser", *options]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, bufsize=1) as process:
        try:
            assert select.select([process.stdout], [], [], 100)[0], "no address was printed"
            line = process.stdout.readline()
            assert " is shown at http://127.0.0.1:" in line, line + process.stderr.read()
            yield process, line.split(" at ")[1].split()[0]
        finally:
            if process.poll() is None:
                process.send_signal(signal.SIGINT)
                try:
                    process.wait(20)
                except subprocess.TimeoutExpired:
                    os.kill(process.pid, signal.SIGKILL)


@contextmanager
def running(path, opened=lambda: None, **options):
    """A viewer in a thread, whose publisher lists what it published as ``said``.

    ``opened`` is called when the scene has been read, before the viewer has it.
    """

    def opener():
        file = SceneFile(path, path.parent / "scratch")
        scene = file.load()
        opened()
        return file, scene, pick_sensor(scene, 0)

    viewer = Viewer(path, opener, **options)
    publisher, publish = viewer.publisher, viewer.publisher.publish
    publisher.said = []

    def published(pictures=None, **changes):
        publish(pictures, **changes)
        publisher.said.append((publisher.state, publisher.pictures))

    publisher.publish = published
    thread = threading.Thread(target=viewer.run)
    thread.start()
    try:
        yield viewer
        assert thread.is_alive()
    finally:
        viewer.requests.close()
        thread.join(30)
        assert not thread.is_alive()


def save(viewer, path, text):
    """Saves, and waits until the scene is opened again."""
    path.write_text(text)
    saves = viewer.publisher.state.saves
    viewer.requests.save()
    until(lambda: viewer.publisher.state.saves != saves)


def until(condition):
    end = time.monotonic() + 60
    while not condition():
        assert time.monotonic() < end, "nothing came of it"
        time.sleep(0.005)
