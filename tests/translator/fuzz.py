"""Fuzzes the translator, by hand: pip install atheris; python tests/translator/fuzz.py [libFuzzer options] [corpus]

Anything but a SceneError, and a formatted scene that means something else, is a finding. The examples serve as corpus:

    python tests/translator/fuzz.py -max_total_time=600 -dict=tests/translator/fuzz.dict examples
"""

import sys
import warnings

import atheris

with atheris.instrument_imports():
    import prosim_scene
    from prosim_scene import translator
    from prosim_scene.solids.primitives import primitive

warnings.simplefilter("ignore")
primitive.MAX_SEGMENTS = 16  # speed


def one_input(data):
    try:
        text = data.decode("utf-8")
    except UnicodeDecodeError:
        text = data.decode("latin-1")
    try:
        scene = prosim_scene.parse(text, "fuzz.scn")
    except prosim_scene.SceneError:
        return
    assert prosim_scene.parse(prosim_scene.format(text), "fuzz.scn") == scene
    if len(scene.csg) < 50:
        try:
            translator._Translation(scene, "/nonexistent", tolerance=1e3).build(str, str)
        except prosim_scene.SceneError:
            pass


if __name__ == "__main__":
    atheris.Setup(sys.argv, one_input)
    atheris.Fuzz()
