"""How fine curved faces are, and that what is too much is coarser or refused."""

import numpy as np
import pytest
from meshes import area, scene, solids, volume
from prosim_scene import SceneError, SceneWarning
from prosim_scene.geometry import detail
from prosim_scene.geometry.leaves import Leaves
from prosim_scene.language import document_of
from prosim_scene.view import camera_of

BALLS = [f"SCALE (.4 .4 .4) TRANSLATE ({i % 5 - 2} {i // 5 - 2} 0)" for i in range(20)]
UNION = "+ " * 19 + " ".join(f"SPHERE {i}" for i in range(20))


def segments(tree, transforms, look="OBS 0 0 20 VRP 0 0 0 WINDOW -5 -5 5 5"):
    """Around a circle, of the leaves of a scene under a view."""
    document = document_of(scene(tree, transforms).replace("OBS 0 0 20 VRP 0 0 0 WINDOW -5 -5 5 5", look), "test.scn")
    leaves = Leaves(document, camera_of(document), 0.1, np.zeros(len(transforms), bool), {})
    return [leaves.solids[i].segments for i in leaves.of_leaf]


def test_what_lies_outside_of_the_window_is_not_as_fine_as_what_lies_in_it():
    plain = segments(UNION, BALLS)
    zoomed = segments(UNION, BALLS, "OBS 0 0 20 VRP -2 -2 0 WINDOW -.1 -.1 .1 .1 VPN 0 0 1")
    assert zoomed[0] > 5 * plain[0]  # the ball in the middle of the picture
    assert max(zoomed[1:]) <= 128 and min(zoomed[1:]) >= min(plain[1:])


RADIUS, RIM = 20, 1
SAGITTA = RADIUS - (RADIUS**2 - RIM**2) ** 0.5
CAP = np.pi * SAGITTA**2 * (3 * RADIUS - SAGITTA) / 3


@pytest.mark.parametrize("tree, expected", [("* SPHERE 0 SPHERE 1", 2 * CAP), ("- CUBE 2 SPHERE 0", 5.76 - CAP)])
def test_the_rim_of_a_lens_is_as_fine_as_its_faces(tree, expected, recwarn):
    center = np.array([0, 0, SAGITTA - RADIUS])
    ball = f"SCALE ({RADIUS} {RADIUS} -{RADIUS}) TRANSLATE (0 0 {{}})"
    transforms = [ball.format(z) for z in (center[2], -center[2])] + ["SCALE (2.4 2.4 1) TRANSLATE (-1.2 -1.2 0)"]
    meshes = solids(scene(tree, transforms).replace("WINDOW -5 -5 5 5", "WINDOW -2 -2 2 2"), 0.4)
    assert volume(meshes.values()) == pytest.approx(expected, abs=8e-3 * CAP)
    outwards = (meshes[0].positions - center) * (-1 if tree[0] == "-" else 1)
    assert outwards == pytest.approx(RADIUS * meshes[0].normals[meshes[0].index], abs=1e-4)
    x, y, z = meshes[0].positions.reshape(-1, 3).T
    pixel = 4 / 500
    assert np.abs(np.hypot(x, y)[z < 1e-6] - RIM).max() < 0.4 * pixel
    assert not any("far from the origin" in str(w.message) for w in recwarn)  # as the eye is not far from the ball


def test_more_triangles_than_memory_holds_are_coarser_with_a_warning(monkeypatch):
    monkeypatch.setattr(detail, "MAX_TRIANGLES", 10_000)
    with pytest.warns(SceneWarning, match="curved faces are approximated to .* pixels instead of 0.1"):
        n = segments(UNION, BALLS)
    assert sum(k * k // 2 for k in n) <= 10_000


def test_more_primitives_than_memory_holds_are_an_error(monkeypatch):
    monkeypatch.setattr(detail, "MAX_TRIANGLES", 1000)
    with pytest.raises(
        SceneError, match="20 different primitives have at least 2,560 triangles; expected 1,000 at most"
    ) as error:
        segments(UNION, BALLS)
    assert error.value.line == 2


@pytest.mark.parametrize("distance, said", [(0, False), (1e3, False), (1e6, True), (1e9, True)])
def test_a_scene_far_from_the_origin_is_exact_in_itself_and_warned_of(distance, said, recwarn):
    def at(d):
        steps = [f"TRANSLATE ({d} 0 0)", f"SCALE (.25 .25 1) TRANSLATE ({d + 0.5} .5 0)"]
        text = scene("- CUBE 0 CYLINDER 1", steps)
        return solids(text.replace("OBS 0 0 20 VRP 0 0 0", f"OBS {d} 0 20 VRP {d} 0 0"))

    here, there = at(0), at(distance)
    assert any("far from the origin" in str(w.message) for w in recwarn) == said
    for index in here:
        assert area(there[index]) == pytest.approx(area(here[index]), rel=max(1e-6, 1e-15 * distance))
        assert len(here[index].positions) == len(there[index].positions)


def test_needles_are_not_as_fine_as_they_are_long():
    # With more segments, two of them take manifold3d minutes.
    assert segments("SPHERE 0", ["SCALE (.1 .1 1000) ROTATE-X (90)"])[0] < 256
