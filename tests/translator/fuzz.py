"""Fuzzes the translator, by hand: pip install atheris; python tests/translator/fuzz.py [libFuzzer options] [corpus].

Anything but a SceneError, and a formatted scene that means something else, is a finding. The examples serve as corpus:

    python tests/translator/fuzz.py -max_total_time=600 examples
"""

import sys
import tempfile
import warnings
from pathlib import Path
from xml.etree import ElementTree

import atheris

with atheris.instrument_imports():
    import prosim_scene
    from prosim_scene import output
    from prosim_scene.language import document_of
    from prosim_scene.language.words import WORDS
    from prosim_scene.mitsuba.assemble import assemble
    from prosim_scene.options import Options

warnings.simplefilter("ignore")
OPTIONS = Options(tolerance=1e3)
MARKS = (
    "(",
    ")",
    "#",
    '\\"',
    ":",
    "=",
    "+ ",
    "- ",
    "* ",
    "nan",
    "inf",
    "1e400",
    "1e-200",
    "-0",
    ".5",
    "t-tijolo",
    "t-x",
    "a.png",
    "cobre",
    "$a ",
    "{1+$a}",
    "{sin(30)}",
    "Cu_palik",
)


def dictionary():
    """The words of the language, for libFuzzer."""
    words = [spelling for row in WORDS for spelling in row.spellings]
    return "".join(f'"{word}"\n' for word in (*words, *MARKS))


def one_input(data):
    try:
        text = data.decode("utf-8")
    except UnicodeDecodeError:
        text = data.decode("latin-1")
    try:
        document = document_of(text, "fuzz.scn")
    except prosim_scene.SceneError:
        return
    assert prosim_scene.parse(prosim_scene.format(text), "fuzz.scn") == document.scene
    if len(document.scene.csg) < 50:
        try:
            tree = assemble(document, Path("/nonexistent"), OPTIONS, lambda name, _: name, str)
        except prosim_scene.SceneError:
            return
        ElementTree.fromstring(output.xml(tree))


if __name__ == "__main__":
    with tempfile.NamedTemporaryFile("w", suffix=".dict") as words:
        words.write(dictionary())
        words.flush()
        atheris.Setup([*sys.argv, f"-dict={words.name}"], one_input)
        atheris.Fuzz()
