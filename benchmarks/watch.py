"""``prosim watch`` beside ``prosim render``: from a save to the first picture and to the final one.

A scene is saved again and again, while no page looks at it and while one does; and by turns the same scene, open and
warm, is rendered as ``prosim render`` does. Seconds by the clock, and of the processor, all threads together; how many
pictures there are, and the longest time that one stands still.

With ``--tree`` one SURFACE, the VIEW or the light changes at each save, of 1,000 primitives as in ``csg.py``.
"""

import argparse
import http.client
import json
import shutil
import statistics
import subprocess
import sys
import tempfile
import threading
import time
from pathlib import Path
from urllib.parse import urlsplit

import csg
import mitsuba as mi
import numpy as np

PALITO = Path(__file__).parents[1] / "examples" / "palito.scn"
STATES = ("opened", "first picture", "first pass", "final", "longest still")

#: What changes -> what the text has of it, and what stands there by turns.
CHANGES = {
    "SURFACE": ("kd = 0.2 0.5 0.5", "kd = 0.2 0.5 0.{}"),
    "VIEW": ("OBS 0 0", "OBS {} 0"),
    "light": ("60000 60000 60000", "60000 60000 5{}000"),
}


def page(address):
    """What a page asks for that shows the picture: the events, and after each wave the picture."""
    place = urlsplit(address)
    stream = http.client.HTTPConnection(place.hostname, place.port)
    stream.request("GET", f"{place.path}events")
    newest = 0
    for line in stream.getresponse():
        number = json.loads(line[6:])["pictures"].get("own", 0) if line.startswith(b"data: ") else newest
        if number != newest:
            newest, asking = number, http.client.HTTPConnection(place.hostname, place.port)
            asking.request("GET", f"{place.path}layer/own/final")
            asking.getresponse().read()
            asking.close()


def now():
    """By the clock, and of the processor."""
    return np.array([time.perf_counter(), time.process_time()])


class Watched:
    """A viewer that notes when what is seen of it after a save."""

    def __init__(self, scene, folder):
        from mitsuba_prosim.live import viewer
        from mitsuba_prosim.scene.scene_file import SceneFile, pick_sensor
        from prosim_scene import Kept

        kept = Kept()

        def opened(document):
            file = SceneFile(scene, folder, kept=kept, document=document)
            loaded = file.load()
            return file, loaded, pick_sensor(loaded, 0)

        self.viewer = viewer.Viewer(scene, opened)
        self.times, self.shown, self._publish = {}, [], self.viewer.publisher.publish
        self.viewer.publisher.publish = self.noted

    def noted(self, pictures=None, **changes):
        """In the place of the publisher's own."""
        if changes.get("doing") == "opening":
            self.times, self.shown = {"saved": now()}, []
        elif pictures:
            self.shown.append(now())
            whole = "error" in pictures["own"].layers
            self.times.setdefault("first pass" if whole else "first picture", self.shown[-1])
        elif changes.get("doing") in ("rendering", "done"):
            self.times.setdefault("opened" if changes["doing"] == "rendering" else "final", now())
        self._publish(pictures, **changes)

    def save(self):
        """``{state: seconds}`` after a save."""
        before, publisher = self.viewer.publisher.state.saves, self.viewer.publisher
        self.viewer.requests.saved()
        while publisher.state.saves == before or publisher.state.doing != "done":
            time.sleep(0.02)
        found = {state: time - self.times["saved"] for state, time in self.times.items()}
        return found | {"longest still": np.diff(self.shown, axis=0).max(axis=0), "pictures": len(self.shown)}

    def render(self):
        """The seconds of the command's render."""
        from mitsuba_prosim.scene import rendering

        def rendered(scene):
            begun = now()
            for _ in rendering.progressive(scene.scene, scene.sensor):
                pass
            image = np.array(scene.sensor.film().develop())
            took = now() - begun
            assert np.array_equal(image, self.viewer.publisher.pictures["own"].layers["final"])
            return {"final": took}

        return self.viewer.requests.call(rendered).result()


def turns(watched, address, rounds, typical):
    """The rounds, of which the first warms up; ``typical`` of each is shown."""
    found = {"no page": [], "a page": [], "render": []}
    for turn in range(-1, rounds):
        alone = watched.save()
        with subprocess.Popen([sys.executable, __file__, "--page", address]) as looking:
            while not watched.viewer.publisher.followed:
                time.sleep(0.1)
            time.sleep(0.5)  # until it has what there is
            seen = watched.save()
            looking.kill()
        for values, value in zip(found.values(), (alone, seen, watched.render()), strict=True):
            values += [value] if turn >= 0 else []
    tell(found, typical)


def changed(watched, scene, rounds, typical):
    """The rounds, in each of which all that can change does, one after the other; the first warms up."""
    text = scene.read_text()
    found = {name: [] for name in CHANGES}
    for turn in range(rounds + 1):
        for name, (before, after) in CHANGES.items():
            scene.write_text(text.replace(before, after.format(turn + 1), 1))
            value = watched.save()
            found[name] += [value] if turn else []
            scene.write_text(text)
            watched.save()
    tell(found, typical)


def tell(found, typical):
    """The table, of what is ``typical`` of the rounds."""
    print("| seconds |", " | ".join([*STATES, *(f"CPU: {state}" for state in STATES), "pictures"]), "|")
    for name, values in found.items():
        cells = [
            f"{typical(v[state][k] for v in values):.3f}" if state in values[0] else ""
            for k in (0, 1)
            for state in STATES
        ]
        pictures = [v["pictures"] for v in values if "pictures" in v]
        print("|", name, "|", " | ".join([*cells, f"{statistics.median(pictures):g}" if pictures else ""]), "|")


def main():
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("scene", nargs="?", default=PALITO, type=Path)
    parser.add_argument("--variant", default="llvm_ad_rgb")
    parser.add_argument("--rounds", type=int, default=5)
    parser.add_argument("--threads", type=int, default=2)
    parser.add_argument(
        "--busy",
        action="store_true",
        help="pace by the processor's time, as the clock's is others' too; the least of all rounds",
    )
    parser.add_argument("--tree", choices=csg.TREES, help="1,000 primitives, of which something changes")
    parser.add_argument("--page", metavar="ADDRESS", help=argparse.SUPPRESS)
    arguments = parser.parse_args()
    if arguments.page:
        page(arguments.page)
        return
    mi.set_variant(arguments.variant)
    from mitsuba_prosim.live import server, throttle
    from mitsuba_prosim.scene import session

    if arguments.busy:
        throttle.clock = lambda: time.process_time() / arguments.threads
    with tempfile.TemporaryDirectory() as folder, session.threads(arguments.threads):
        scene = Path(folder) / arguments.scene.name
        if arguments.tree:
            scene.write_text(csg.scene(arguments.tree, 1000))
        else:
            shutil.copy(arguments.scene, scene)
        watched = Watched(scene, Path(folder) / "scratch")

        def work(address):
            try:
                typical = min if arguments.busy else statistics.median
                if arguments.tree:
                    changed(watched, scene, arguments.rounds, typical)
                else:
                    turns(watched, address, arguments.rounds, typical)
            finally:
                watched.viewer.requests.close()

        with server.served(watched.viewer, lambda exposure: {}, server.bound(0)) as address:
            other = threading.Thread(target=work, args=(address,))
            other.start()
            watched.viewer.run()
            other.join()


if __name__ == "__main__":
    main()
