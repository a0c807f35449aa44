"""The camera of the page: what its moves keep, and the VIEW that says the same."""

import numpy as np
import prosim_scene
import pytest
from little import LITTLE
from mitsuba_prosim.live.orbit_camera import STEEPEST, Camera, as_view, as_xml, nearest_axis
from prosim_scene.language.diagnostics import Source
from prosim_scene.view import camera_of


def seen(document):
    """The view of a scene as the page's camera."""
    view = camera_of(document)
    to_world = np.eye(4)
    to_world[:3] = np.stack([-view.u, view.v, -view.n, view.eye], axis=1)
    across = (view.right - view.left) / view.depth, (view.top - view.bottom) / view.depth
    return Camera(to_world, view.depth, nearest_axis(view.v), across)


DOCUMENT = prosim_scene.document_of(LITTLE, "little.scn")


def test_orbit_keeps_the_distance_and_ends_before_the_pole():
    home = seen(DOCUMENT)
    moved = home.orbited(30, 200)
    assert np.allclose(moved.pivot, home.pivot)
    assert np.linalg.norm(moved.eye - home.pivot) == pytest.approx(home.distance)
    level = np.degrees(np.arcsin((moved.eye - moved.pivot) @ home.up / home.distance))
    assert level == pytest.approx(STEEPEST)
    assert np.allclose(moved.to_world[:3, :3].T @ moved.to_world[:3, :3], np.eye(3))


def test_pan_and_dolly_move_the_image_by_their_numbers():
    home = seen(DOCUMENT)
    moved = home.panned(0.25, 0.5)
    # What was at the pivot lies a quarter of the picture further to the right now, and half of it further up.
    x, y, z = (np.linalg.inv(moved.to_world) @ [*home.pivot, 1])[:3]
    assert (-x / z, y / z) == pytest.approx((0.25 * home.across[0], 0.5 * home.across[1]))
    nearer = home.dollied(0.5)
    assert np.allclose(nearer.pivot, home.pivot) and np.allclose(nearer.eye, (home.eye + home.pivot) / 2)


def test_dolly_stays_between_the_target_and_the_limit():
    home = seen(DOCUMENT)
    for factor in (0.01, 300):
        moved = home
        for _ in range(200):
            moved = moved.dollied(factor)
        assert moved.distance > 0 and np.isfinite(moved.to_world).all()
        assert np.allclose(moved.pivot, home.pivot, atol=1e-6 * moved.distance)
        back = moved.dollied(home.distance / moved.distance)  # it is no way of no return
        assert np.allclose(back.to_world, home.to_world)


@pytest.mark.parametrize("more", ["", "VPN 0.1 0.4 1", "APERTURE 0.125 FOCUS 7.5"])
def test_copied_view_is_the_shown_view(more):
    document = prosim_scene.document_of(LITTLE.replace("OBS", f"{more}\nOBS"), "little.scn")
    home = seen(document)
    before, after = LITTLE.index("VIEW"), LITTLE.index("CSG-TREE")
    moves = np.random.default_rng(1).uniform((-90, -60, -1, -1, 0.2), (90, 60, 1, 1, 4), (15, 5))
    for yaw, pitch, right, up, nearer in [*moves, (0, 0, 0, 0, 1), (90, 60, 1, -1, 4)]:
        moved = home.orbited(yaw, pitch).panned(right, up).dollied(nearer)
        text = as_view(document.scene.view, home, moved, document.source.spellings)
        copied = prosim_scene.document_of(LITTLE[:before] + text + "\n" + LITTLE[after:], "again.scn")
        again, lenses = seen(copied), [(one.scene.view.aperture, one.scene.view.focus) for one in (document, copied)]
        assert lenses[0] == lenses[1]
        assert np.allclose(again.to_world, moved.to_world, atol=1e-5)
        assert np.allclose(again.across, home.across, rtol=1e-5)


@pytest.mark.parametrize(
    "text, words",
    [
        ("LIGHTS AREA position 0 9 9 radius 2 VIEW EYE 0 0 9 CSG-TREE CUBE 0 END", "VIEW RESOLUTION WINDOW EYE"),
        ("LIGHTS AREA position 0 9 9 raio 2 VIEW OBS 0 0 9 CSG-TREE CUBE 0 END", "VIEW RESOLUTION WINDOW OBS"),
        ("LUZES EXTENSA posição 0 9 9 VISTA OLHO 0 0 9 CSG CUBO 0 FIM", "VISTA RESOLUCAO JANELA OLHO"),
        ("LUZES EXTENSA posição 0 9 9 WINDOW -1 -1 1 1 FIM", "VISTA RESOLUCAO WINDOW OBS"),
    ],
)
def test_copied_view_has_the_words_of_the_scene(text, words):
    source = Source(text, "s.scn")
    camera = seen(DOCUMENT)
    lines = as_view(DOCUMENT.scene.view, camera, camera.orbited(10, 0), source.spellings).split("\n")
    assert [line.split()[0] for line in lines] == [*words.split(), "VPN", "VRP", "VUP"]


def test_xml_has_the_matrix():
    moved = seen(DOCUMENT).orbited(10, 20)
    words = as_xml(moved).split('value="')[1].split('"')[0].split()
    assert np.allclose(np.array(words, dtype=float).reshape(4, 4), moved.to_world, atol=1e-5)
