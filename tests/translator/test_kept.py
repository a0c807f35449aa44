"""What a translation leaves to the next one."""

import exact_csg
import numpy as np
import prosim_scene
import pytest

SCENE = """DEFAULT $turn = 0
DEFAULT $red = 0.1
DEFAULT $size = 1
DEFAULT $blue = 0.5
VIEW OBS {15 * sin($turn)} 0 {15 * cos($turn)} WINDOW -4 -4 4 4
LIGHTS POINT position 5 5 9
CSG-TREE - + CUBE 0 t-tijolo SPHERE 1 CYLINDER 2
SURFACE 0 kd = $red 0.5 0.5
SURFACE 1 kd = $blue 0.5 0.5
SURFACE 2 material condutor ouro
TRANSFORM 0 TRANSLATE (-.5 -.5 -.5) SCALE (2 2 2)
TRANSFORM 1 SCALE ($size $size 1.3)
TRANSFORM 2 SCALE (.4 .4 9) TRANSLATE (0 0 -4)
END
"""


def files(folder):
    return {path.name: path.read_bytes() for path in folder.rglob("*.*") if path.is_file()}


# what is told to the second and third translation, and how many trees are evaluated in all
@pytest.mark.parametrize(
    "second, third, made",
    [
        ({"turn": 30, "red": 0.7}, {"turn": 70}, 1),
        ({"blue": 0.1}, {"red": 0.5}, 1),  # CUBE 0 has a texture: they never look alike
        ({"size": 1.1}, {"size": 1.1, "turn": 20}, 2),
        ({"size": 1.1}, {"size": 1}, 3),
    ],
)
def test_the_same_solids_are_evaluated_once_and_the_files_are_the_same(tmp_path, second, third, made):
    path = tmp_path / "s.scn"
    path.write_text(SCENE)
    kept = prosim_scene.Kept()
    for define in {}, second, third:
        prosim_scene.translate(prosim_scene.document(path, define), tmp_path / "kept", kept=kept)
        prosim_scene.translate(path, tmp_path / "anew", define=define)
        assert files(tmp_path / "kept") == files(tmp_path / "anew") and len(files(tmp_path / "kept")) == 4
    assert kept.made == made


@pytest.mark.filterwarnings("ignore::prosim_scene.SceneWarning")
@pytest.mark.parametrize("options", [{"resolution": (20, 10), "samples": 7}, {"target": "stock"}])
def test_another_view_needs_no_translation(tmp_path, options):
    """Also where the eye is so near to a face that it would be cut off."""
    path, kept = tmp_path / "s.scn", prosim_scene.Kept()
    path.write_text(cube := SCENE.replace("- + CUBE 0 t-tijolo SPHERE 1 CYLINDER 2", "CUBE 0"))
    prosim_scene.translate(path, kept=kept, **options)
    path.write_text(cube.replace("WINDOW -4 -4 4 4", "WINDOW -4 -3 4 4").replace("15 *", "1.0001 *"))
    document = prosim_scene.document(path, {"turn": 90})
    view = prosim_scene.sensor(document, kept, **options)
    np.testing.assert_equal(view, prosim_scene.load(document, **options)["view"])
    assert view["near_clip"] < prosim_scene.sensor(document, **options)["near_clip"]
    path.write_text(cube.replace("-4 -4 4 4", "-4 4 4 4"))
    document = prosim_scene.document(path)
    with pytest.raises(prosim_scene.SceneError, match="the window -4 4 4 4 is empty"):
        prosim_scene.sensor(document, kept, **options)


def test_solids_that_come_to_look_alike_and_no_longer_are_not_evaluated_anew(tmp_path):
    path = tmp_path / "s.scn"
    path.write_text(SCENE.replace("CUBE 0 t-tijolo", "CUBE 0"))
    kept = prosim_scene.Kept()
    for red, meshes in ((0.1, 3), (0.5, 2), (0.7, 3), (0.5, 2)):
        prosim_scene.translate(path, tmp_path / "kept", define={"red": red}, kept=kept)
        prosim_scene.translate(path, tmp_path / "anew", define={"red": red})
        assert files(tmp_path / "kept") == files(tmp_path / "anew") and len(files(tmp_path / "kept")) == 1 + meshes
        assert len(kept.files) == meshes
    assert kept.made == 1


def test_what_vanishes_is_said_each_time(tmp_path):
    path = tmp_path / "s.scn"
    kept = prosim_scene.Kept()
    vanishing = SCENE.replace("- + CUBE 0 t-tijolo SPHERE 1 CYLINDER 2", "+ CUBE 0 + SPHERE 1 SPHERE 2").replace(
        "SCALE (.4 .4 9) TRANSLATE (0 0 -4)", "SCALE (.4 .4 .4)"
    )
    path.write_text(vanishing)
    for turn in (0, 20):
        with pytest.warns(prosim_scene.SceneWarning, match="nothing is seen of SPHERE 2"):
            prosim_scene.translate(path, tmp_path / "kept", define={"turn": turn}, kept=kept)
    assert kept.made == 1


class Edited:
    """Random solids on a grid, with many faces in common, of which one changes at a time."""

    def __init__(self, seed):
        self.rng = np.random.default_rng([seed, 16])
        self.nodes = exact_csg.tree(self.rng, 14, "+++-")
        self.leaves = [self.leaf() for _ in range(14)]

    def leaf(self):
        shape = exact_csg.SHAPES[self.rng.choice(4, p=[0.6, 0.15, 0.15, 0.1])]
        size, place = self.rng.choice([0.5, 1, 2], 3), self.rng.integers(-5, 6, 3) / 2
        material = ["lambertiano", "condutor ouro", "dieletrico n-refr = 1.5"][self.rng.choice(3, p=[0.8, 0.1, 0.1])]
        return shape, f"SCALE ({exact_csg.numbers(size)}) TRANSLATE ({exact_csg.numbers(place)})", material

    def edit(self, kind):
        present = [n for n in self.nodes if not isinstance(n, str)]
        number, new = int(self.rng.choice(present)), len(self.leaves)
        if kind == "change":
            self.leaves[number] = self.leaf()
            return
        if kind == "remove":
            at = next(
                i for i, pair in enumerate(zip(self.nodes, self.nodes[1:])) if [type(n) for n in pair] == [str, int]
            )
            del self.nodes[at : at + 2]
            return
        self.leaves.append(self.leaf())
        if kind == "append":
            self.nodes = ["+", *self.nodes, new]
        else:
            at = self.nodes.index(number)
            self.nodes[at : at + 1] = ["-", number, new]

    def text(self):
        lines = ["VIEW OBS 3 4 15 WINDOW -4 -3 4 3 RESOLUTION 60 45", "LIGHTS POINT position 0 9 9", "CSG-TREE"]
        lines += [n if isinstance(n, str) else f"{self.leaves[n][0]} {n}" for n in self.nodes]
        for i, (_, place, material) in enumerate(self.leaves):
            if i in self.nodes:
                lines += [f"SURFACE {i} material {material} kd = 0.{1 + i % 3}", f"TRANSFORM {i} {place}"]
        return "\n".join([*lines, "END", ""])


@pytest.mark.filterwarnings("ignore::prosim_scene.SceneWarning")
@pytest.mark.parametrize("seed", [pytest.param(0), pytest.param(1, marks=pytest.mark.slow)])
def test_an_edited_tree_is_translated_as_if_nothing_had_been_kept(tmp_path, seed):
    path, kept, edited = tmp_path / "s.scn", prosim_scene.Kept(), Edited(seed)
    for kind in ["change", "append", "change", "insert", "remove", "change"]:
        path.write_text(edited.text())
        prosim_scene.translate(path, tmp_path / "kept", kept=kept)
        prosim_scene.translate(path, tmp_path / "anew")
        assert files(tmp_path / "kept") == files(tmp_path / "anew")
        edited.edit(kind)
