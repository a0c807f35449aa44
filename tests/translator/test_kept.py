"""What one translation leaves for later ones."""

from pathlib import Path

import prosim_scene
import pytest
from meshes import scene
from prosim_scene import Kept
from prosim_scene.solids import csg

SCENE = scene("- + CUBE 0 SPHERE 1 CYLINDER 2", ["", "TRANSLATE (1 0 0)", "SCALE (.2 .2 2)"])


def files(folder):
    return {p.relative_to(folder): p.read_bytes() for p in Path(folder).rglob("*") if p.suffix in (".ply", ".xml")}


def translated(text, folder, kept=None):
    folder.mkdir()
    (folder / "scene.scn").write_text(text)
    prosim_scene.translate(folder / "scene.scn", kept=kept)
    return files(folder)


@pytest.fixture
def evaluations(monkeypatch):
    """One entry for each evaluation of a tree."""
    found, original = [], csg.evaluate
    monkeypatch.setattr(csg, "evaluate", lambda *a: found.append(a) or original(*a))
    return found


@pytest.mark.parametrize(
    "old, new, anew",
    [
        ("material lambertiano kd = 0.2 0 0", "material condutor ouro", False),
        ("POINT position 0 9 9", "AREA position 0 9 0 raio 2", False),
        ("RESOLUTION", "VUP 1 1 0 RESOLUTION", False),
        ("kd = 0.1 0 0", "kd = 0.3 0 0", False),  # two that look alike share a mesh
        ("TRANSFORM 1", "TRANSFORM 1 SCALE (1 1 2)", True),
        ("- +", "+ +", True),
        ("WINDOW -5 -5 5 5", "WINDOW -1 -1 1 1", True),  # finer
        ("material lambertiano kd = 0.2 0 0", "material dieletrico n-refr 1.5", True),
    ],
)
def test_what_is_kept_gives_the_same_files(tmp_path, evaluations, old, new, anew):
    assert SCENE.count(old) == 1
    kept = Kept()
    translated(SCENE, tmp_path / "before", kept)
    after = translated(SCENE.replace(old, new), tmp_path / "after", kept)
    assert len(evaluations) == 1 + anew
    assert after == translated(SCENE.replace(old, new), tmp_path / "alone")


@pytest.mark.parametrize("most, evaluated", [(12, 3), (24, 2)])
def test_the_oldest_makes_place(tmp_path, evaluations, most, evaluated):
    kept = Kept(most)
    for number, transform in enumerate(("", "TRANSLATE (1 0 0)", "")):
        translated(scene("CUBE 0", [transform]), tmp_path / str(number), kept)
    assert len(evaluations) == evaluated


def test_a_film_evaluates_its_solids_once(tmp_path, evaluations):
    text = scene("- SPHERE 0 CYLINDER 1", ["", "SCALE (.2 .2 4) TRANSLATE (0 0 -2)"])
    text = text.replace("OBS 0 0 20", "OBS {15 * sin($turn)} 0 {15 * cos($turn)}")
    (tmp_path / "scene.scn").write_text("DEFAULT $turn = 0\n" + text)
    kept = Kept()
    for turn in (0, 30, 70):
        prosim_scene.translate(tmp_path / "scene.scn", tmp_path / "kept", define={"turn": turn}, kept=kept)
        assert len(evaluations) == 1
    prosim_scene.translate(tmp_path / "scene.scn", tmp_path / "anew", define={"turn": 70})
    assert files(tmp_path / "kept") == files(tmp_path / "anew")


def test_what_vanishes_is_said_each_time(tmp_path, evaluations):
    path = tmp_path / "scene.scn"
    path.write_text(scene("+ SPHERE 0 SPHERE 1", ["", "SCALE (.4 .4 .4)"]))
    kept = Kept()
    for _ in range(2):
        with pytest.warns(prosim_scene.SceneWarning, match="nothing is seen of SPHERE 1"):
            prosim_scene.translate(path, kept=kept)
    assert len(evaluations) == 1
