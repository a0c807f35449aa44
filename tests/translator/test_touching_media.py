"""What a dieletrico is made of; dielectrics that touch or lie in one another: one face between any two media."""

import math
import re

import exact_csg
import mitsuba as mi
import numpy as np
import prosim_scene
import pytest
from meshes import area, scene, skins, solids, volume
from mitsuba_prosim.optics.dispersion import MATERIALS, D, Dispersion
from prosim_scene import SceneWarning
from prosim_scene.geometry.mesh_files import MeshFile
from prosim_scene.geometry.primitives import PRIMITIVES
from prosim_scene.language import document_of
from prosim_scene.language.words import GLASSES, INDICES
from prosim_scene.mitsuba import assemble
from prosim_scene.model import Leaf
from test_mesh_files import obj

pytestmark = pytest.mark.filterwarnings("ignore::prosim_scene.SceneWarning", "error::RuntimeWarning")

METAL = "metal"
GLASS, WATER = (f"material dieletrico n-refr = {n}" for n in (1.5, 1.33))


def hits(meshes, origin, direction):
    """Where a ray meets the meshes (Moeller and Trumbore): distances in their order, keys, and whether it enters."""
    found = []
    for key, mesh in meshes.items():
        p = mesh.positions
        a, b = p[:, 1] - p[:, 0], p[:, 2] - p[:, 0]
        h, s = np.cross(direction, b), origin - p[:, 0]
        det = np.einsum("ti,ti->t", a, h)
        det = np.where(np.abs(det) > 1e-12, det, np.inf)
        q = np.cross(s, a)
        u, v, t = np.einsum("ti,ti->t", s, h) / det, q @ direction / det, np.einsum("ti,ti->t", b, q) / det
        met = (u >= 0) & (v >= 0) & (u + v <= 1) & (t > 1e-6) & np.isfinite(det)
        found += [(at, key, side) for at, side in zip(t[met], np.sign(det[met]))]
    return sorted(found, key=lambda hit: hit[0])


def media_along(meshes, origin, direction):
    """The media that a ray leaves, METAL for what is opaque; every face has to lead from one to the next."""
    result, now = [], None
    for t, skin, entering in hits(meshes, origin, direction):
        inside = METAL if skin.material[0].material == "conductor" else skin.inside
        before, after = (skin.outside, inside) if entering > 0 else (inside, skin.outside)
        assert now == before, t
        result.append(before)
        now = after
    assert now is None
    return result


def media_of_the_tree(text, origin, direction):
    """The same by the tree's definition: the first of the media in the tree that is there."""
    read = document_of(text, "test.scn").scene
    media = {medium_of(read, node): 0 for node in read.csg if isinstance(node, Leaf)}
    media = sorted(media, key=lambda medium: medium != METAL)  # which is first
    found = exact_csg.intervals(read, origin[None], direction[None])
    ends = [[(near[0], far[0]) for near, far in pairs] for pairs in found]
    times = np.unique([t for pairs in ends for near, far in pairs if near < far for t in (near, far)])
    times, result, now = times[np.isfinite(times)], [], None
    for begin, end in zip(times, [*times[1:], np.inf]):
        if end - begin < 1e-6:
            continue
        middle = begin + 1 if end == np.inf else (begin + end) / 2
        inside = [any(near < middle < far for near, far in pairs) for pairs in ends]
        after = next((medium for medium in media if exists(read, inside, medium)), None)
        if after != now:
            result.append(now)
        now = after
    return result + [now] * (now is not None)  # of a half-space, which has no end


def medium_of(read, leaf):
    return METAL if read.surfaces[leaf.index].material == "conductor" else assemble.medium_key(read, leaf)


def exists(read, inside, medium):
    """Whether the part of the tree that is of a medium is where these leaves are ``inside``."""
    stack, number = [], len(inside)
    for node in reversed(read.csg):
        if isinstance(node, Leaf):
            number -= 1
            stack.append({medium_of(read, node)} if inside[number] else set())
        elif node.symbol == "+":
            stack.append(stack.pop() | stack.pop())
        else:
            first, second = stack.pop(), stack.pop()
            stack.append(first if bool(second) == (node.symbol == "*") else set())
    return medium in stack.pop()


KINDS = "grid,turned_grid,grid of one glass,turned_grid of one glass,grid with metal,chains,same_quadric,"
KINDS += "nested,rings_and_stumps,slices,turned_half_spaces"


@pytest.mark.slow
@pytest.mark.parametrize("kind", KINDS.split(","))
def test_every_face_leads_from_one_medium_to_the_next(kind):
    compared = {False: 0, True: 0}
    for seed in range(2):
        rng = np.random.default_rng([seed, 5])
        text = exact_csg.KINDS[kind.split()[0]](rng)
        text = re.sub(r"lambertiano kd \S+", "dieletrico n-refr {}", text).format(
            *rng.choice([1.5] if "one glass" in kind else [1.2, 1.3, 1.5], 20)
        )
        if "metal" in kind:  # what cuts has to be of the same kind
            text = re.sub(r"(?<!\S)[-*](?!\S)", "+", text)
            text = re.sub(r"dieletrico n-refr 1.[25]", "condutor ouro", text)
        meshes = skins(text, 0.2)
        for mesh in meshes.values():
            a, b, c = np.moveaxis(mesh.positions, 1, 0)
            assert np.mean(np.sum(np.cross(b - a, c - a) * mesh.normals[mesh.index].sum(1), axis=1) >= 0) > 0.9
        for _ in range(15):
            origin = 9.0 * rng.choice([-1, 1], 3)
            direction = rng.uniform(-2, 2, 3) - origin
            direction /= np.linalg.norm(direction)
            found, expected = media_along(meshes, origin, direction), media_of_the_tree(text, origin, direction)
            compared[len(found) == len(expected)] += 1
            if len(found) == len(expected):
                assert found == expected, seed
    assert compared[False] < 0.05 * compared[True]  # at edges, which chords cut


def test_opaque_ball_in_glass_keeps_its_surface():
    meshes = solids(scene("+ CUBE 1 SPHERE 0", ["", "TRANSLATE (-.5 -.5 -.5) SCALE (4 4 4)"], ["kd 1 1 1", GLASS]))
    assert area(meshes[0]) == pytest.approx(4 * np.pi, rel=0.02)


@pytest.mark.parametrize("tree", ["+ - CUBE 0 {} {}", "+ {} - CUBE 0 {}", "+ * CUBE 0 {} {}", "* + {} {} CUBE 3"])
def test_copy_of_a_mesh_fills_its_hollow(tree):
    ball = PRIMITIVES["sphere"].mesh(20, np.eye(4))
    files = {"ball.obj": MeshFile(obj(ball.triangles.tolist(), ball.vertices))}
    turn, block = "SCALE (1.1 -.9 1) ROTATE-X (33) TRANSLATE (.1 .2 .3)", "TRANSLATE (-.5 -.5 -.5) SCALE (4 4 4)"
    transforms = [f"{steps} {turn}" for steps in (block, "", "", f"TRANSLATE (.2 .1 -.4) {block}")]
    glasses = [f"material dieletrico n-refr = {n}" for n in (1.5, 1.5, 1.3, 1.7)]
    text = scene(tree.format('MESH 1 "ball.obj"', 'MESH 2 "ball.obj"'), transforms, glasses)
    meshes, generator, tested = skins(text, 0.3, files), np.random.default_rng(1), 0
    for origin, target in zip(generator.normal(scale=6, size=(40, 3)), generator.uniform(-1, 1, (40, 3))):
        direction = (target - origin) / np.linalg.norm(target - origin)
        tested += len(media_along(meshes, origin, direction))
    assert tested > 40


TUMBLER = scene(
    "+ - CYLINDER 0 CYLINDER 1 CYLINDER 2",
    [
        "SCALE (2 2 4) ROTATE-X (-70)",
        "SCALE (1.8 1.8 4) TRANSLATE (0 0 .3) ROTATE-X (-70)",
        "SCALE (1.8 1.8 2) TRANSLATE (0 0 .3) ROTATE-X (-70)",
    ],
    [GLASS, GLASS, WATER],
)


def shapes_of(path, target="prosim"):
    return [x for x in prosim_scene.load(path, target=target).values() if isinstance(x, dict) and "bsdf" in x]


@pytest.mark.parametrize("target", ["prosim", "stock"])
def test_faces_say_the_indices_on_both_sides(write_scene, target):
    shapes = shapes_of(write_scene(TUMBLER), target)
    found = [(shape["bsdf"]["int_ior"], shape["bsdf"]["ext_ior"]) for shape in shapes]
    assert sorted(found) == [(1.33, 1.0), (1.5, 1.0), (1.5, 1.33)]
    # What cuts glass of another kind leaves the glass its index.
    shapes = shapes_of(write_scene(scene("- SPHERE 0 CUBE 1", ["", ""], [GLASS, WATER])), target)
    assert [shape["bsdf"]["int_ior"] for shape in shapes] == [1.5, 1.5]
    # Rough dielectrics take no equal indices, and light goes straight through such a face.
    glasses = [GLASS + " m = .1", GLASS.replace("1.5", "1.4 1.5 1.6")]
    between = shapes_of(write_scene(scene("+ SPHERE 0 SPHERE 1", ["", "SCALE (2 2 2)"], glasses)), target)[0]["bsdf"]
    assert "alpha" not in between and "rough" not in between["type"]


def test_a_face_knows_what_absorbs_and_disperses_on_both_sides(variant_rgb, write_scene):
    # Bottle glass by its name, and red water in it.
    red = WATER + " transmitancia = 0.9 0.2 0.2"
    path = write_scene(scene("+ SPHERE 0 SPHERE 1", ["SCALE (.5 .5 .5)", ""], [red, "material dieletrico bk7"]))
    loaded = prosim_scene.load(path)
    water, glass = loaded["surface_0"], loaded["surface_1"]
    assert water["bsdf"]["int_ior"] == pytest.approx(1.33) and water["bsdf"]["ext_material"] == "bk7"
    assert glass["bsdf"] == {"type": "prosim_dielectric", "int_material": "bk7", "ext_ior": 1.0}
    assert "interior" in water and "exterior" not in water and "interior" not in glass
    path.write_text(path.read_text().replace("+ SPHERE 0 SPHERE 1", "+ - SPHERE 1 SPHERE 0 SPHERE 0"))
    shape = next(x for x in prosim_scene.load(path).values() if isinstance(x, dict) and "exterior" in x)
    assert shape["exterior"] == water["interior"] and "interior" not in shape
    scene_of_xml = mi.load_file(str(prosim_scene.translate(path)))
    assert [s.exterior_medium() is not None for s in scene_of_xml.shapes() if s.is_mesh()].count(True) == 1


SPOON = "material condutor n-refr = 1.2 k-abs = 3"
BATH = scene("+ CYLINDER 0 CUBE 1", ["SCALE (.5 .5 4)", "SCALE (8 8 2) TRANSLATE (-4 -4 -1)"], [SPOON, WATER])


def test_opaque_solids_are_divided_by_the_medium_around_them(write_scene):
    meshes = solids(BATH, 0.02)
    wet, dry = meshes[0, 1], meshes[0]
    disc, around = math.pi / 4, math.pi  # the spoon stands in water from 0 to 1, and has its other end in the air
    assert area(wet) == pytest.approx(disc + around, rel=2e-3)
    assert area(dry) == pytest.approx(disc + 3 * around, rel=2e-3)
    assert volume([wet, dry]) == pytest.approx(math.pi, rel=2e-3)
    assert volume([meshes[1], dry]) == pytest.approx(8 * 8 * 2 + 3 * disc, rel=1e-3)
    varnish = BATH.replace(SPOON, "material composto kd = .5 n-refr = 1.6")
    for text, target, key, values in (
        (BATH, "prosim", "ext_ior", [1.33, 1]),
        (BATH.replace("n-refr = 1.2 k-abs = 3", "ouro"), "prosim", "ext_ior", [1.33, 1]),
        (varnish, "prosim", "ext_ior", [1.33, 1]),
        (varnish, "stock", "ext_ior", [1.33, 1]),
        (BATH, "stock", "k", [3 / 1.33, 3]),
    ):
        shapes = prosim_scene.load(write_scene(text), target=target)
        found = [shapes[name]["bsdf"][key] for name in ("surface_0", "surface_0_")]
        assert sorted(np.mean(x["value"] if isinstance(x, dict) else x) for x in found) == pytest.approx(sorted(values))
    matte = write_scene(BATH.replace(SPOON, "material lambertiano kd = .5"))
    assert "surface_0_" not in prosim_scene.load(matte)  # what is matte is so everywhere, and stays in one piece
    # Varnish of the index of water is not seen in it.
    shapes = shapes_of(write_scene(BATH.replace(SPOON, "material composto kd = .5 n-refr = 1.33 m = .1")), "stock")
    assert {"diffuse", "roughplastic"} <= {shape["bsdf"]["type"] for shape in shapes}


@pytest.mark.parametrize(
    "tree, surfaces, words",
    [
        ("- SPHERE 0 CUBE 1", (GLASS, ""), "3:12: CUBE 1 cuts glass .* SURFACE 1 is opaque, .*material dieletrico"),
        ("* SPHERE 0 CUBE 1", (GLASS, ""), "3:12: CUBE 1 cuts glass"),
        ("- SPHERE 0 CUBE 1", ("", GLASS), "3:12: CUBE 1 cuts an opaque solid .* SURFACE 1 is a dieletrico"),
        ("- SPHERE 0 CUBE 1", (GLASS, WATER), None),
        ("+ SPHERE 0 CUBE 1", (GLASS, ""), None),
        ("- + SPHERE 0 CUBE 2 CUBE 1", (GLASS, "", ""), "3:21: CUBE 1 cuts glass"),
    ],
)
def test_warning_names_an_opaque_surface_that_lines_glass(tree, surfaces, words, recwarn):
    skins(scene(tree, ["", "", "TRANSLATE (5 5 5)"][: 2 + ("2" in tree)], surfaces), 0.2)
    said = [str(w.message) for w in recwarn]
    assert len(said) == bool(words) and all(re.search(words, message) for message in said)


# ---- Glasses by name, Abbe numbers, and what they absorb


@pytest.fixture
def glass(write_scene):
    before = "LIGHTS AREA position 0 50 0 VIEW OBS 0 0 9 CSG-TREE SPHERE 0 SURFACE 0 material dieletrico"
    return lambda surface: write_scene(f"{before} {surface} TRANSFORM 0 END")


def ball(path, **options):
    return prosim_scene.load(path, **options)["surface_0"]


def test_names_of_glasses_are_those_of_the_plugin(variant_rgb):
    assert set(GLASSES.values()) == set(MATERIALS) == set(INDICES)
    for name, n in INDICES.items():
        assert n == pytest.approx(Dispersion.sellmeier(MATERIALS[name]).index(D)[0], abs=1e-5)


def test_glass_is_said_by_name_or_abbe_number(glass):
    named = ball(glass("Diamante m = .2"))["bsdf"]
    assert named["int_material"] == "diamond" and "int_ior" not in named and named["alpha"] == 0.2
    given = ball(glass("n-refr = 1.62 abbe = 36.4"))["bsdf"]
    assert (given["int_ior"], given["int_abbe"]) == (pytest.approx(1.62), 36.4)
    with pytest.warns(SceneWarning, match="one index for all wavelengths"):
        assert ball(glass("agua"), target="stock")["bsdf"]["int_ior"] == INDICES["water"]


def test_medium_transmits_the_given_share_after_the_thickness(glass):
    path = glass("n-refr = 1.5 transmitancia = .25 1 .5 espessura = 2")
    for target in ("prosim", "stock"):
        loaded = prosim_scene.load(path, target=target)
        medium = loaded["surface_0"]["interior"]
        sigma = np.array(medium["sigma_t"]["value"]) * medium["scale"]
        assert medium["albedo"] == 0 and np.exp(-2 * sigma) == pytest.approx([0.25, 1, 0.5])
        assert min(sigma) > 0  # or volpath would give no number
        assert loaded["integrator"]["type"] == {"prosim": "prosim", "stock": "volpath"}[target]
    assert "interior" not in ball(glass("n-refr = 1.5 transmitancia = 1"))
