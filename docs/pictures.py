"""Draws docs/pictures: one for each plugin, with the parameters of the example in its documentation, and one for each
step of docs/walkthrough.md, called ``walkthrough-1`` and so on.

``python docs/pictures.py [NAME...]``; needs matplotlib.
"""

import re
import sys
from pathlib import Path

import mitsuba as mi
import mitsuba_prosim  # noqa: F401  (registers the plugins)
import numpy as np
import prosim_scene
from matplotlib.figure import Figure
from prosim_scene import document_of

DOCS = Path(__file__).parent
sys.path[:0] = [str(DOCS / "extensions"), str(DOCS.parent / "examples")]
from plugin_pages import example, plugins

SIZE = 288


def film():
    return {"type": "hdrfilm", "width": SIZE, "height": SIZE, "rfilter": {"type": "gaussian"}}


def camera(origin, target, fov):
    T = mi.ScalarTransform4f
    return {
        "type": "perspective",
        "fov": fov,
        "film": film(),
        "to_world": T().look_at(origin=origin, target=target, up=[0, 1, 0]),
    }


def lambertian(reflectance):
    return {"type": "prosim_lambertian", "reflectance": reflectance}


def rgb(*value):
    return {"type": "rgb", "value": list(value)}


def checkerboard(a, b, scale):
    return {
        "type": "checkerboard",
        "color0": rgb(*a),
        "color1": rgb(*b),
        "to_uv": mi.ScalarTransform4f().scale([scale, scale, 1]),
    }


def floor(bsdf, size=12):
    T = mi.ScalarTransform4f
    return {"type": "rectangle", "to_world": T().rotate([1, 0, 0], -90) @ T().scale(size), "bsdf": bsdf}


def wall(bsdf, z, size=12):
    T = mi.ScalarTransform4f
    return {"type": "rectangle", "to_world": T().translate([0, 0, z]) @ T().scale(size), "bsdf": bsdf}


def ball(bsdf):
    T = mi.ScalarTransform4f  # with its pole on top
    return {"type": "sphere", "to_world": T().translate([0, 1, 0]) @ T().rotate([1, 0, 0], -90), "bsdf": bsdf}


def lamp(center=(-3, 5, 4), radius=0.9, radiance=28):
    return {
        "type": "sphere",
        "center": list(center),
        "radius": radius,
        "emitter": {"type": "prosim_area", "radiance": radiance},
    }


def studio(**more):
    """A checkered floor under a blue sky and a spherical lamp."""
    return {
        "type": "scene",
        "sensor": camera([0, 1.9, 5.2], [0, 0.92, 0], 28),
        "lamp": lamp(),
        "integrator": {
            "type": "prosim",
            "samples": 7,
            "threshold": 0.003,
            "max_level": 5,
            "ambient": 0.25,
            "background": rgb(0.30, 0.42, 0.58),
        },
        "floor": floor(lambertian(checkerboard((0.45, 0.42, 0.38), (0.12, 0.14, 0.2), 14))),
        **more,
    }


def material(entry):
    return studio(ball=ball(entry))


def texture(entry):
    return studio(ball=ball(lambertian(entry)), floor=floor(lambertian(entry), 4))


def source(entry):
    """Above a floor before a wall, and seen itself; a ball beside its beam's axis."""
    return {
        "type": "scene",
        "sensor": camera([0, 4, 15], [0, 2.7, 0], 28),
        "source": entry,
        "integrator": {"type": "prosim", "samples": 7, "threshold": 0.003, "ambient": 0.04},
        "floor": floor(lambertian(0.6)),
        "wall": wall(lambertian(0.5), -2.2),
        "ball": {"type": "sphere", "center": [0.9, 0.8, 0.4], "radius": 0.8, "bsdf": lambertian(rgb(0.6, 0.3, 0.15))},
    }


def view(entry):
    entry["film"] = film()
    entry["to_world"] = mi.ScalarTransform4f().look_at(origin=[0, 1.9, 5.2], target=[0, 0.92, 0], up=[0, 1, 0])
    return studio(ball=ball({"type": "prosim_conductor", "material": "Cu", "alpha": 0.15}), sensor=entry)


def renderer(entry):
    return prosim_scene.load(DOCS.parent / "examples" / "palito.scn", resolution=(SIZE, SIZE))


FOLDERS = {"bsdfs": material, "emitters": source, "textures": texture, "sensors": view, "integrators": renderer}


def sampler():
    """Both jitters of the sampler's 25 samples, pass by colour."""
    from drawing.sampling import nrook_points, square

    figure = Figure(figsize=(2.88, 2.88), layout="constrained")
    axes = square(figure, (1, 1, 1), 5)
    for r in range(5):
        axes.plot(*nrook_points(5, r, 0).T, "o", ms=5, color=f"C{r}", clip_on=False)
    return figure


def passes():
    from drawing.sampling import nrook_points, square

    figure = Figure(figsize=(7.2, 1.6), layout="constrained")
    for r in range(5):
        axes = square(figure, (1, 5, r + 1), 4, f"pass {r + 1}" if r < 4 else "all")
        for shown in [r] if r < 4 else range(4):
            axes.plot(*nrook_points(4, shown, 0).T, "o", ms=5, color=f"C{shown}", clip_on=False)
    return figure


def association():
    """Which sample of the lamp each sample of the pixel meets, were the order always the same, and as it is."""
    from drawing.sampling import nrook_points, square

    figure = Figure(figsize=(6, 2.2), layout="constrained")
    pixel, lamp = nrook_points(5, 0, 0), nrook_points(5, 0, 1)
    spaces = {"pixel": pixel, "lamp, were i to meet i": pixel, "lamp, as it is": lamp}
    for place, (title, points) in enumerate(spaces.items()):
        axes = square(figure, (1, 3, place + 1), 5)
        axes.set_title(title, fontsize=10)
        for i, point in enumerate(points):
            axes.text(*np.clip(point, 0.04, 0.96), str(i + 1), color=f"C{i}", ha="center", va="center", weight="bold")
    return figure


def turntable():
    """Every sixth frame of the example."""
    path, size = DOCS.parent / "examples" / "volta.scn", (96, 96)
    frames = [prosim_scene.load(path, resolution=size, define={"frame": n}) for n in range(0, 48, 6)]
    return np.concatenate([np.array(mi.render(mi.load_dict(scene), seed=1)) for scene in frames], axis=1)


def steps():
    """The scenes of docs/walkthrough.md."""
    return re.findall(r"```scn\n(.*?)```", (DOCS / "walkthrough.md").read_text("utf-8"), re.DOTALL)


def main(only):
    mi.set_variant("llvm_ad_rgb")
    if not only or "volta" in only:
        bitmap = mi.Bitmap(turntable()).convert(component_format=mi.Struct.Type.UInt8, srgb_gamma=True)
        bitmap.write(str(DOCS / "pictures" / "volta.jpg"), quality=92)
    if not only or "copo" in only:
        image = mi.render(mi.load_dict(prosim_scene.load(DOCS.parent / "examples" / "copo.scn")))
        mi.Bitmap(image).convert(component_format=mi.Struct.Type.UInt8, srgb_gamma=True).write(
            str(DOCS / "pictures" / "copo.jpg"), quality=90
        )
    for folder, scene_of in FOLDERS.items():
        for name, docstring in plugins(folder):
            if not only or name in only:
                scene = mi.load_dict(scene_of(example(docstring)))
                image = np.array(mi.render(scene, seed=1))[:, :, :3]
                exposure = 1.4 if folder in ("bsdfs", "textures", "sensors") else 1 / np.quantile(image, 0.99)
                mi.Bitmap(image * np.float32(exposure)).convert(
                    mi.Bitmap.PixelFormat.RGB, mi.Struct.Type.UInt8, srgb_gamma=True
                ).write(str(DOCS / "pictures" / f"{name}.jpg"), quality=88)
    for number, text in enumerate(steps(), start=1):
        name = f"walkthrough-{number}"
        if not only or name in only:
            size = (320, 240) if "RESOLUTION" in text else (240, 240)
            image = mi.render(mi.load_dict(prosim_scene.load(document_of(text, name), resolution=size)))
            mi.Bitmap(image).convert(mi.Bitmap.PixelFormat.RGB, mi.Struct.Type.UInt8, srgb_gamma=True).write(
                str(DOCS / "pictures" / f"{name}.jpg"), quality=88
            )
    for name, draw in {"nrook.jpg": sampler, "passes.png": passes, "association.png": association}.items():
        if not only or Path(name).stem in only:
            draw().savefig(DOCS / "pictures" / name, dpi=100)


if __name__ == "__main__":
    main(sys.argv[1:])
