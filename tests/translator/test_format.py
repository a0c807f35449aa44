"""The canonical layout, and files that are rewritten in it."""

import errno
import os
from pathlib import Path

import prosim_scene
import pytest
from prosim_scene import SceneError

pytestmark = pytest.mark.filterwarnings("ignore::prosim_scene.SceneWarning")

REST = "\n".join(f"SURFACE {i}\nTRANSFORM {i}" for i in range(5)) + "\nEND\n"


def tree(text):
    """The lines of the tree in canonical layout, without the common indentation."""
    tidy = prosim_scene.format(f"CSG-TREE {text}\n{REST}")
    assert prosim_scene.format(tidy) == tidy
    lines = tidy[: tidy.index("\nSURFACE 0")].splitlines()[1:]
    return "\n".join(line[4:] for line in lines).rstrip()


def test_the_tree_shows_its_shape():
    assert tree("+ + + CUBE 0 CUBE 1 CUBE 2 CUBE 3") == "+ + +\n    CUBE 0\n    CUBE 1\n    CUBE 2\n    CUBE 3"
    assert tree("- + CUBE 0 SPHERE 1 - CYLINDER 2 * CONE 3 CUBE 4") == (
        "- +\n    CUBE 0\n    SPHERE 1\n    -\n        CYLINDER 2\n        *\n            CONE 3\n            CUBE 4"
    )
    assert tree("cubo 0 t-tijolo") == "CUBE 0 t-tijolo"


def test_remarks_stand_with_what_follows_them():
    assert tree("- (a)\n CUBE 0 (b)\n(c)\n# d\n + CUBE 1 CUBE 2 # e") == (
        "- (a)\n    CUBE 0 (b)\n    (c)\n    # d\n    +\n        CUBE 1\n        CUBE 2 # e"
    )
    assert tree("+ (a) - CUBE 0 CUBE 1 CUBE 2") == "+ (a)\n-\n    CUBE 0\n    CUBE 1\n    CUBE 2"


def test_words_are_spelt_as_the_place_has_them():
    tidy = prosim_scene.format("TEXTURE t-x fractal escala=3 SURFACE 0 TRANSFORM 0 escala 1 2 3 CSG CUBE 0 LUZES END")
    assert "    scale = 3\n" in tidy and "    SCALE (1 2 3)\n" in tidy and "CSG-TREE\n" in tidy and "LIGHTS\n" in tidy
    tidy = prosim_scene.format("TEXTURE t-x brick tijolo 1 TEXTURE t-tijolo brick = 1 1 1 argamassa 1 END")
    assert tidy.startswith(
        "TEXTURE t-x\n    brick\n    brick = 1\n\nTEXTURE t-tijolo\n    brick = 1 1 1\n    mortar = 1\n"
    )


@pytest.mark.parametrize("step", ["writing", "renaming"])
def test_a_disk_that_is_full_leaves_the_file_as_it_was(write_scene, step, monkeypatch):
    scene = write_scene("fim")

    def full(*_, **__):
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    if step == "writing":
        monkeypatch.setattr(Path, "write_bytes", full)
    else:
        monkeypatch.setattr(os, "replace", full)
    with pytest.raises(SceneError, match=r"s.scn: No space left on device; the file is unchanged"):
        prosim_scene.rewrite(scene, "END\n")
    assert scene.read_text() == "fim" and os.listdir(scene.parent) == ["s.scn"]
