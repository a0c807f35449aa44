"""Each primitive is seen where its canonical solid is, under its transform and the scene's view."""

import mitsuba as mi
import numpy as np
import prosim_scene
import pytest
from exact_csg import rotation

SIZE = 80
INSIDE = {
    "CUBE": lambda p: np.all((p >= 0) & (p <= 1), axis=-1),
    "SPHERE": lambda p: (p**2).sum(-1) <= 1,
    "CYLINDER": lambda p: (p[..., 0] ** 2 + p[..., 1] ** 2 <= 1) & (p[..., 2] >= 0) & (p[..., 2] <= 1),
    "CONE": lambda p: (p[..., 0] ** 2 + p[..., 1] ** 2 <= p[..., 2] ** 2) & (p[..., 2] >= 0) & (p[..., 2] <= 1),
}
SCENE = """
VIEW  RESOLUTION {size} {size}  WINDOW -5 -4 4 5  OBS 3 4 20  VPN .2 .1 1  VRP 0 1 2  VUP 0 1 0
CSG-TREE {shape} 0
SURFACE 0 material lambertiano kd .5
TRANSFORM 0 SCALE (2 3 2.5) ROTATE-X (-70) ROTATE-Y (25) TRANSLATE (.5 -1 1)
END
"""


@pytest.mark.slow
@pytest.mark.parametrize("shape", INSIDE)
def test_silhouette(variant_rgb, tmp_path, shape):
    """Against the solid itself, by points along the rays of the formula; only pixels on the outline may differ."""
    path = tmp_path / "one.scn"
    path.write_text(SCENE.format(size=SIZE, shape=shape))
    with pytest.warns(prosim_scene.SceneWarning):  # no lights
        scene = mi.load_dict(prosim_scene.load(path))
    j, i = np.mgrid[:SIZE, :SIZE]
    position = mi.Point2f(((i + 0.5) / SIZE).ravel(), ((j + 0.5) / SIZE).ravel())
    rays, _ = scene.sensors()[0].sample_ray(0, 0.5, position, mi.Point2f(0.5))
    seen = np.array(scene.ray_test(rays)).reshape(SIZE, SIZE)

    eye, reference, normal, up = map(np.array, ((3.0, 4, 20), (0.0, 1, 2), (0.2, 0.1, 1), (0.0, 1, 0)))
    n = normal / np.linalg.norm(normal)
    u = np.cross(up, n)
    u /= np.linalg.norm(u)
    v = np.cross(n, u)
    plane = reference + u * (-5 + (i[..., None] + 0.5) * 9 / SIZE) + v * (5 - (j[..., None] + 0.5) * 9 / SIZE)
    linear = rotation(1, 25) @ rotation(0, -70) @ np.diag([2, 3, 2.5])
    expected = np.zeros((SIZE, SIZE), bool)
    for t in np.linspace(0.7, 1.6, 1200):
        point = eye + t * (plane - eye)
        expected |= INSIDE[shape]((point - [0.5, -1, 1]) @ np.linalg.inv(linear).T)

    outline = np.zeros_like(expected)
    for axis in (0, 1):
        edge = np.diff(expected, axis=axis)
        outline[: -1 if axis == 0 else None, : -1 if axis == 1 else None] |= edge
        outline[1 if axis == 0 else 0 :, 1 if axis == 1 else 0 :] |= edge
    assert 300 < expected.sum() < SIZE**2 / 2
    assert not np.any((seen != expected) & ~outline)
    assert np.mean(seen != expected) < 0.005
