"""A little scene, and ``prosim watch`` of it as a process."""

import os
import select
import shutil
import signal
import subprocess
import sys
import time
from contextlib import contextmanager

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


def until(condition):
    end = time.monotonic() + 60
    while not condition():
        assert time.monotonic() < end, "nothing came of it"
        time.sleep(0.02)
