"""Draws docs/pictures: one for each plugin, with the parameters of the example in its documentation; one for each step
of docs/walkthrough.md, called ``walkthrough-1`` and so on; and those of the functions below. Also draws the pictures of
docs/gallery.md, called ``chess`` and so on, by the commands of this page.

``python docs/pictures.py [NAME...]``; needs matplotlib, playwright with a browser, and the extras ``denoise`` and
``watch``.
"""

import os
import re
import shlex
import subprocess
import sys
import time
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory

import mitsuba as mi
import mitsuba_prosim
import numpy as np
import prosim_scene
from matplotlib.figure import Figure
from mitsuba_prosim.scene.images import compress, luminance
from prosim_scene import document_of

DOCS = Path(__file__).parent
EXAMPLES = DOCS.parent / "examples"
TESTS = DOCS.parent / "tests"
sys.path[:0] = [str(DOCS / "extensions"), str(TESTS / "live"), str(TESTS), str(EXAMPLES)]
from plugin_pages import example, plugins
from walkthrough import steps

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
    """Above a floor before a wall, and hidden, because the camera would see its dark side; a ball beside the axis."""
    return {
        "type": "scene",
        "sensor": camera([0, 4, 15], [0, 2.7, 0], 28),
        "source": entry,
        "integrator": {"type": "prosim", "samples": 7, "threshold": 0.003, "ambient": 0.04, "hide_emitters": True},
        "floor": floor(lambertian(0.6)),
        "wall": wall(lambertian(0.5), -2.2),
        "ball": {"type": "sphere", "center": [0.9, 0.8, 0.4], "radius": 0.8, "bsdf": lambertian(rgb(0.6, 0.3, 0.15))},
    }


def view(entry):
    entry["film"] = film()
    entry["to_world"] = mi.ScalarTransform4f().look_at(origin=[0, 1.9, 5.2], target=[0, 0.92, 0], up=[0, 1, 0])
    return studio(ball=ball({"type": "prosim_conductor", "material": "Cu", "alpha": 0.15}), sensor=entry)


def renderer(entry):
    return prosim_scene.load(EXAMPLES / "palito.scn", resolution=(SIZE, SIZE))


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
    """The five samples of a pixel and of a lamp: with the same order of the rows, and with a permutation of its own."""
    from drawing.sampling import nrook_points, square

    figure = Figure(figsize=(6, 2.2), layout="constrained")
    pixel, lamp = nrook_points(5, 0, 0), nrook_points(5, 0, 1)
    spaces = {"pixel": pixel, "lamp, same order": pixel, "lamp, permuted": lamp}
    for place, (title, points) in enumerate(spaces.items()):
        axes = square(figure, (1, 3, place + 1), 5)
        axes.set_title(title, fontsize=10)
        for i, point in enumerate(points):
            axes.text(*np.clip(point, 0.04, 0.96), str(i + 1), color=f"C{i}", ha="center", va="center", weight="bold")
    return figure


def rendered(scene, spp=0):
    """The image of a scene's dictionary, shape (height, width, 3)."""
    return np.array(mi.render(mi.load_dict(scene), seed=1, spp=spp))[..., :3]


def turntable():
    """Every sixth frame of the example."""
    path, size = EXAMPLES / "volta.scn", (96, 96)
    frames = [prosim_scene.load(path, resolution=size, define={"frame": n}) for n in range(0, 48, 6)]
    return np.concatenate([rendered(scene) for scene in frames], axis=1)


def tumbler():
    return rendered(prosim_scene.load(EXAMPLES / "copo.scn"))


def materials():
    """A ball of each material, from smooth to rough; Phong's exponent is that of an equally wide lobe."""
    rows = []
    for name, parameters in {
        "conductor": {"material": "Cu"},
        "dielectric": {"int_ior": 1.5},
        "composite": {"diffuse_reflectance": rgb(0.1, 0.2, 0.5), "specular_reflectance": 0.5},
        "phong": {"diffuse_reflectance": rgb(0.1, 0.3, 0.1), "specular_reflectance": 0.5},
        "lambertian": {"reflectance": rgb(0.6, 0.3, 0.2)},
    }.items():
        for m in (0.02, 0.1, 0.2, 0.4, 0.6):
            rough = {"phong": {"exponent": (2 / m**2 - 2) / 4}, "lambertian": {}}.get(name, {"alpha": m})
            scene = studio(ball=ball({"type": f"prosim_{name}", **parameters, **rough}))
            scene["sensor"]["film"] |= {"width": 96, "height": 96}
            scene["sensor"]["fov"] = 24
            rows.append(1.4 * rendered(scene, spp=1024))
    return np.concatenate([np.concatenate(rows[i : i + 5], axis=1) for i in range(0, 25, 5)])


def rough_metals():
    """Copper balls of five roughnesses; above without, below with reflections between the facets."""
    rows = []
    for many in (False, True):
        row = []
        for m in (0.2, 0.4, 0.6, 0.8, 1.0):
            scene = studio(
                ball=ball({"type": "prosim_conductor", "material": "Cu", "alpha": m, "multiple_scattering": many})
            )
            scene["integrator"] = {"type": "path", "max_depth": 4}
            scene["sky"] = {"type": "constant", "radiance": rgb(0.55, 0.6, 0.7)}
            scene["sensor"]["film"] |= {"width": 192, "height": 192}
            scene["sensor"]["fov"] = 24
            row.append(0.75 * rendered(scene, 256))
        rows.append(np.concatenate(row, axis=1))
    return np.concatenate(rows)


def csg():
    """Union, difference and intersection of a box and a ball."""
    text = """LIGHTS AREA position 12 30 20 radius 3 Intensity 150000 150000 150000
        AMBIENT 18000 18000 20000 BACKGROUND 60000 61000 64000 NSAMPLES 6
        VIEW RESOLUTION 160 140 EYE 14 12 20 VRP 0 0 0 WINDOW -4.8 -4.2 4.8 4.2
        CSG-TREE {} CUBE 0 SPHERE 1
        SURFACE 0 kd = .6 .3 .15 SURFACE 1 material composite kd = .1 .25 .5 n-refr = 1.5
        TRANSFORM 0 SCALE (5 5 5) TRANSLATE (-2.5 -2.5 -2.5)
        TRANSFORM 1 SCALE (2.2 2.2 2.2) TRANSLATE (1.5 1.5 2.2) END"""
    if_one = {"*": text.replace("SCALE (2.2 2.2 2.2)", "SCALE (3.2 3.2 3.2)").replace("1.5 1.5 2.2", "0 0 0")}
    documents = [document_of(if_one.get(operator, text).format(operator), operator) for operator in "+-*"]
    return np.concatenate([rendered(prosim_scene.load(document)) for document in documents], axis=1)


def shapes():
    """A truncated cone, a torus, and a ball that two planes cut."""
    text = """LIGHTS AREA position 12 30 20 radius 3 Intensity 150000 150000 150000
        AMBIENT 18000 18000 20000 BACKGROUND 60000 61000 64000 NSAMPLES 6
        VIEW RESOLUTION 160 140 EYE 6 9 20 VRP 0 0 0 WINDOW -1.6 -1.4 1.6 1.4
        CSG-TREE {}
        SURFACE 0 kd = .6 .3 .15 SURFACE 1 material composite kd = .1 .25 .5 n-refr = 1.5
        TRANSFORM 0 SCALE (1 1 -2) TRANSLATE (0 0 1) ROTATE-X (-90) TRANSFORM 1 ROTATE-X (-60) TRANSFORM 2
        TRANSFORM 3 ROTATE-X (-90) TRANSLATE (0 -.4 0) TRANSFORM 4 ROTATE-X (-45) TRANSLATE (0 .1 .1)
        SURFACE 2 kd = .3 .4 .2 SURFACE 3 kd = .6 .3 .15 SURFACE 4 kd = .7 .7 .6 END"""
    trees = "CONE 0 radius .5", "TORUS 1 radius .3", "- * SPHERE 2 PLANE 4 PLANE 3"
    scenes = [prosim_scene.load(document_of(text.format(tree), tree)) for tree in trees]
    return np.concatenate([rendered(scene) for scene in scenes], axis=1)


def pawns():
    return rendered(prosim_scene.load(DOCS / "pawns.scn"))


def samples():
    """The same scene with N = 2, 5 and 8."""
    path = EXAMPLES / "esfera-metalica.scn"
    scenes = [prosim_scene.load(path, resolution=(240, 180), samples=n) for n in (2, 5, 8)]
    return compress(np.concatenate([rendered(scene) for scene in scenes], axis=1))


def displayed(image):
    """The displayed luminance whose RMS error ``noise`` limits."""
    return np.sqrt(np.maximum(luminance(image), 0) + 0.01)


def hero():
    """A scene with all light paths by ``volpath`` and, in equal processor time, by ``prosim`` with an error target."""
    scene = prosim_scene.load(EXAMPLES / "wine-glass.scn", resolution=(480, 360))
    settings = scene.pop("integrator") | {"diffuse_bounces": -1, "ambient": 0.0, "max_level": -1}
    ours = mi.load_dict(scene | {"integrator": settings | {"adaptive": "graded", "noise": 0.02}})
    scene["view"]["sampler"] = {"type": "multijitter"}
    theirs = mi.load_dict(scene | {"integrator": {"type": "volpath", "max_depth": -1, "hide_emitters": True}})

    def timed(render, scene, **options):
        begun = time.process_time()
        result = render(scene, **options)
        return result, time.process_time() - begun

    def prosim(scene, **options):
        return mitsuba_prosim.render(scene, progress=False, **options)

    def volpath(scene, **options):
        return np.array(mi.render(scene, **options))[..., :3]

    prosim(ours, spp=1), volpath(theirs, spp=1)  # compiles the kernels
    result, seconds = timed(prosim, ours, seed=1)
    _, other = timed(volpath, theirs, spp=64, seed=1)
    beside, other = timed(volpath, theirs, spp=round(64 * seconds / other), seed=2)
    spp = theirs.sensors()[0].sampler().sample_count()
    images = beside, np.array(result)
    differences = [
        [displayed(image) - displayed(np.array(prosim(ours, seed=seed))) for image in images] for seed in (2, 3)
    ]
    # The product of the differences from two independent images has no error of theirs.
    reached = [np.sqrt(np.mean(a * b)) for a, b in zip(*differences)]
    print(f"prosim: {result.verdict}; {seconds:.0f} s; volpath: {spp} samples, {other:.0f} s; true errors {reached}")
    return hero_figure(images, [np.abs(a + b) / 2 for a, b in zip(*differences)], result.samples, [
        f"Mitsuba's volpath: {spp} samples in each pixel, {other:.0f} s",
        f"prosim --noise 0.02: {result.samples.mean():.0f} samples on average, {seconds:.0f} s",
        f"true error {reached[0]:.3f}", f"true error {reached[1]:.4f}",
        f"samples: {result.samples.min():.0f} (dark) to {result.samples.max():.0f}",
    ])  # fmt: skip


def hero_figure(images, errors, samples, captions):
    """Two images above three maps, each with its caption below."""
    width, height = 1300, 896
    figure = Figure(figsize=(width / 100, height / 100))
    places = [(0, 0, 640, 480), (660, 0, 640, 480), (0, 530, 420, 315), (440, 530, 420, 315), (880, 530, 420, 315)]
    shown = [{}, {}, {"cmap": "inferno", "vmax": 0.1}, {"cmap": "inferno", "vmax": 0.1}, {"cmap": "viridis"}]
    images = np.array(mi.util.convert_to_bitmap(compress(np.concatenate(images))))  # with one tone curve
    panels = [*np.split(images, 2), *errors, np.log(samples)]
    for (x, y, w, h), panel, style, caption in zip(places, panels, shown, captions):
        axes = figure.add_axes((x / width, 1 - (y + h) / height, w / width, h / height))
        axes.imshow(panel, **style, aspect="auto")
        axes.axis("off")
        figure.text((x + w / 2) / width, 1 - (y + h + 26) / height, caption, ha="center", va="baseline", size=13.5)
    return figure


def hard_to_denoise():
    """Small tiles, wires thinner than one, a caustic by path, highlights smaller than a pixel."""
    rng = np.random.default_rng(1)
    tiles = {"type": "bitmap", "bitmap": mi.Bitmap(rng.random((96, 96, 3), np.float32)), "filter_type": "nearest"}
    wires = {
        f"wire_{i}": {
            "type": "cylinder",
            "p0": [-1.6, 0.16 * i, -1],
            "p1": [1.6, 1.8 - 0.13 * i, -1 + 0.03 * i],
            "radius": 0.006,
            "bsdf": {"type": "twosided", "bsdf": lambertian(0.9)},
        }
        for i in range(12)
    }
    copper = {"type": "prosim_conductor", "material": "Cu", "alpha": 0.05}
    balls = {
        f"ball_{i}": {"type": "sphere", "center": [x, y, 0], "radius": 0.06, "bsdf": copper}
        for i, (x, y) in enumerate(rng.uniform([-1.2, 0], [1.2, 2], (150, 2)))
    }
    caustic = prosim_scene.load(EXAMPLES / "caustica.scn", resolution=(SIZE, SIZE))
    caustic["integrator"] = {"type": "prosim_adaptive", "nested": {"type": "path", "max_depth": 8}}
    return [studio(wall=wall(lambertian(tiles), -2)), studio(**wires), caustic, studio(**balls)]


def denoising():
    """Raw, denoised, final, converged; the estimated and the true error of the final image, four times as bright."""
    from mitsuba_prosim import denoising

    rows = []
    for scene in hard_to_denoise():
        for part in scene.values():
            if isinstance(part, dict) and "film" in part:
                part["film"] = {"type": "hdrfilm", "width": 128, "height": 128, "rfilter": {"type": "box"}}
        scene["integrator"] |= {"adaptive": "none", "samples": 3}
        found = denoising.render(mi.load_dict(scene), seed=1)
        scene["integrator"] |= {"samples": 16}
        loaded = mi.load_dict(scene)
        truth = np.mean([np.array(mi.render(loaded, seed=2 + i))[..., :3] for i in range(12)], axis=0)
        white = np.percentile(truth, 99)
        square = np.mean((found.final - truth) ** 2, axis=2).reshape(16, 8, 16, 8).mean((1, 3))
        errors = found.final_error, np.kron(np.sqrt(square), np.ones((8, 8)))
        images = [found.raw, found.denoised, found.final, truth, *(4 * np.dstack([error] * 3) for error in errors)]
        rows.append(np.concatenate([np.clip(image / white, 0, 1) for image in images], axis=1))
    return np.concatenate(rows)


def step(name, text):
    size = (640, 480) if "RESOLUTION" in text else (480, 480)
    return rendered(prosim_scene.load(document_of(text, name), resolution=size))


def plugin(folder, entry):
    image = rendered(FOLDERS[folder](entry), spp=0 if folder == "integrators" else 400)
    return image * (1.4 if folder in ("bsdfs", "textures", "sensors") else 1 / np.quantile(image, 0.99))


def run(command, *more):
    program, *arguments = shlex.split(command)
    subprocess.run([Path(sys.executable).with_name(program), *arguments, *more], cwd=DOCS.parent, check=True)


def watch(browser):
    """The live page of a scene from a moved camera."""
    from little import watching

    page = browser.new_page(viewport={"width": 1100, "height": 700})
    with watching(EXAMPLES / "palito.scn") as (_, address):
        page.goto(address)
        page.locator("#camera:enabled").check(force=True)
        page.mouse.move(300, 300)
        page.mouse.down()
        page.mouse.move(312, 300)
        page.mouse.up()
        page.locator("#exposure").fill("-0.75")
        page.locator("#state", has_text="done").wait_for(timeout=300_000)
        page.mouse.move(420, 200)
        page.locator("#pixel", has_text="line").wait_for()
        page.screenshot(path=DOCS / "pictures" / "watch.jpg", quality=85)


def explain(browser):
    """The page about a pixel where a straw enters the water."""
    page, written = browser.new_page(viewport={"width": 1200, "height": 900}), EXAMPLES / "copo-explain.html"
    run("prosim explain examples/copo.scn --pixel 150,200")
    page.goto(f"file://{written}")
    page.screenshot(path=DOCS / "pictures" / "explain.jpg", quality=70, full_page=True)
    written.unlink()


def in_browser(draw):
    from little import BROWSER
    from playwright.sync_api import sync_playwright

    with sync_playwright() as playwright:
        draw(playwright.chromium.launch(executable_path=BROWSER, args=["--no-sandbox"]))


def gallery(name, command):
    """A JPEG of the PNG that the command writes; prints the processor time."""
    with TemporaryDirectory() as folder:
        before = os.times()
        run(command, "-t", "1", "-o", folder)
        print(f"{name}: {sum(os.times()[2:4]) - sum(before[2:4]):.0f} s")
        (png,) = Path(folder).glob("*.png")
        mi.Bitmap(str(png)).write(str(DOCS / "gallery" / f"{name}.jpg"), quality=90)


def main(only):
    mi.set_variant("llvm_ad_rgb")
    images = {
        "volta": turntable,
        "copo": tumbler,
        "materials": materials,
        "rough-metals": rough_metals,
        "csg": csg,
        "shapes": shapes,
        "lens": pawns,
        "samples": samples,
        "denoising": denoising,
    }
    for folder in FOLDERS:
        images |= {name: partial(plugin, folder, example(docstring)) for name, docstring in plugins(folder)}
    images |= {
        f"walkthrough-{i}": partial(step, f"walkthrough-{i}", text) for i, (text, _) in enumerate(steps(), start=1)
    }
    for name, draw in images.items():
        if not only or name in only:
            bitmap = mi.Bitmap(draw().astype(np.float32))
            bitmap = bitmap.convert(mi.Bitmap.PixelFormat.RGB, mi.Struct.Type.UInt8, srgb_gamma=True)
            bitmap.write(str(DOCS / "pictures" / f"{name}.jpg"), quality=88)
    for name, draw in {
        "hero.jpg": hero,
        "nrook.jpg": sampler,
        "passes.png": passes,
        "association.png": association,
    }.items():
        if not only or Path(name).stem in only:
            draw().savefig(
                DOCS / "pictures" / name, dpi=100, pil_kwargs={"quality": 88} if name.endswith(".jpg") else {}
            )
    for draw in (watch, explain):
        if not only or draw.__name__ in only:
            in_browser(draw)
    page = (DOCS / "gallery.md").read_text("utf-8")
    for name, command in re.findall(r"\(gallery/([\w-]+)\.jpg\).*?`(prosim render .*?)`", page, re.DOTALL):
        if not only or name in only:
            gallery(name, command)


if __name__ == "__main__":
    main(sys.argv[1:])
