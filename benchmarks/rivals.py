"""Accuracy of the noise thresholds of Cycles and LuxCore, and their processor time at equal error.

Cycles and LuxCore are Python packages. They need an environment of their own and one process each:

    python -m venv RIVALS && RIVALS/bin/pip install bpy pyluxcore
    RIVALS/bin/python benchmarks/rivals.py cycles FILE [--size 64] [--rounds 2]
    RIVALS/bin/python benchmarks/rivals.py luxcore FILE
    python benchmarks/rivals.py ours FILE

The first two append the threshold, the true error and the processor seconds of each image to FILE. The last one renders
the same scenes to each of these errors and prints a table for each renderer, raw and denoised: the range over the
scenes of the mean ratio true error / threshold; its spread, the greatest mean over the least; the range of all images;
and the range over the scenes of the median ratio of the processor times. The error is the RMS difference between the
displayed luminances of an image and of the renderer's own converged image.
"""

from __future__ import annotations

import argparse
import json
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

LUMINANCE = np.array([0.212671, 0.715160, 0.072169])
WHITE, RED, GREEN = (0.73, 0.73, 0.73), (0.6, 0.06, 0.05), (0.14, 0.45, 0.09)
DEPTH, MOST = 8, 1024
#: A scene has the position of the eye, the point that it sees, the field of view in degrees, the radiance of the sky,
#: rectangles (corner, two edges, reflectance, emitted radiance) and balls (centre, radius, reflectance, roughness of
#: the metal; 0: diffuse).
SCENES: dict[str, dict[str, Any]] = {
    "box": {
        "view": ((0, 1, 4), (0, 1, 0), 38),
        "sky": 0.0,
        "rectangles": [
            ((-1, 0, 1), (2, 0, 0), (0, 0, -2), WHITE, 0),
            ((-1, 2, -1), (2, 0, 0), (0, 0, 2), WHITE, 0),
            ((-1, 0, -1), (2, 0, 0), (0, 2, 0), WHITE, 0),
            ((-1, 0, 1), (0, 0, -2), (0, 2, 0), RED, 0),
            ((1, 0, -1), (0, 0, 2), (0, 2, 0), GREEN, 0),
            ((-0.25, 1.98, -0.25), (0.5, 0, 0), (0, 0, 0.5), (0, 0, 0), 15),
        ],
        "balls": [((-0.4, 0.4, -0.3), 0.4, WHITE, 0), ((0.4, 0.4, 0.2), 0.4, WHITE, 0)],
    },
    "penumbra": {
        "view": ((0, 2.2, 6), (0, 0.7, 0), 40),
        "sky": 0.05,
        "rectangles": [
            ((-6, 0, 6), (12, 0, 0), (0, 0, -12), WHITE, 0),
            ((-3, 3.5, 0), (1, 0, 0), (0, 0, 1), (0, 0, 0), 60),
        ],
        "balls": [((0, 0.8, 0), 0.8, RED, 0)],
    },
    "metal": {
        "view": ((0, 2.2, 6), (0, 0.7, 0), 40),
        "sky": 0.4,
        "rectangles": [
            ((-6, 0, 6), (12, 0, 0), (0, 0, -12), WHITE, 0),
            ((-2, 4, 1), (1, 0, 0), (0, 0, 1), (0, 0, 0), 30),
        ],
        "balls": [((-0.9, 0.8, 0), 0.8, (0.9, 0.6, 0.4), 0.2), ((0.9, 0.8, 0), 0.8, GREEN, 0)],
    },
}


def luminance(image: np.ndarray) -> np.ndarray:
    """Returns the displayed luminance, as in promises.py."""
    return np.sqrt(np.maximum(image @ LUMINANCE, 0) + 0.01)


def ball(center: tuple[float, ...], radius: float, steps: int = 48) -> tuple[np.ndarray, np.ndarray]:
    """Returns the vertices and the triangles of a ball."""
    u, v = np.meshgrid(np.linspace(0, 2 * np.pi, steps + 1), np.linspace(0, np.pi, steps // 2 + 1))
    points = np.stack([np.cos(u) * np.sin(v), np.cos(v), -np.sin(u) * np.sin(v)], axis=-1).reshape(-1, 3)
    k = np.add.outer(np.arange(steps // 2) * (steps + 1), np.arange(steps)).ravel()
    corners = np.stack([k, k + steps + 1, k + steps + 2, k, k + steps + 2, k + 1], axis=-1).reshape(-1, 3)
    return np.array(center) + radius * points, corners


def meshes(scene: dict[str, Any]) -> list[tuple[np.ndarray, np.ndarray, tuple[float, ...], float, float]]:
    """Returns the vertices, triangles, reflectance, roughness (0: diffuse) and radiance of each object."""
    found = []
    for corner, u, v, colour, radiance in scene["rectangles"]:
        p, u, v = np.array([corner, u, v], dtype=float)
        found.append((np.array([p, p + u, p + u + v, p + v]), np.array([[0, 1, 2], [0, 2, 3]]), colour, 0, radiance))
    return found + [(*ball(center, radius), colour, rough, 0) for center, radius, colour, rough in scene["balls"]]


def cycles(scene: dict[str, Any], size: int) -> Callable[..., np.ndarray]:
    """Loads the scene into Blender; returns a function of threshold (0: none), seed and denoise that renders it."""
    import bpy
    from mathutils import Matrix, Vector

    bpy.ops.wm.read_factory_settings(use_empty=True)
    stage = bpy.context.scene
    for n, (points, faces, colour, rough, radiance) in enumerate(meshes(scene)):
        mesh = bpy.data.meshes.new(f"mesh{n}")
        mesh.from_pydata(points.tolist(), [], faces.tolist())
        if len(faces) > 2:
            mesh.shade_smooth()
        material = bpy.data.materials.new(f"material{n}")
        material.use_nodes = True
        shader = material.node_tree.nodes["Principled BSDF"].inputs
        shader["Base Color"].default_value = (*colour, 1)
        shader["Metallic"].default_value = float(rough > 0)
        shader["Roughness"].default_value = np.sqrt(rough) if rough else 1
        shader["Specular IOR Level"].default_value = 0.5 * (rough > 0)
        if radiance:
            shader["Emission Color"].default_value = (1, 1, 1, 1)
            shader["Emission Strength"].default_value = radiance
        mesh.materials.append(material)
        stage.collection.objects.link(bpy.data.objects.new(f"object{n}", mesh))
    eye, at, fov = scene["view"]
    camera = bpy.data.cameras.new("camera")
    camera.angle = np.radians(fov)
    stage.camera = bpy.data.objects.new("camera", camera)
    stage.collection.objects.link(stage.camera)
    z = (Vector(eye) - Vector(at)).normalized()
    x = Vector((0, 1, 0)).cross(z).normalized()
    stage.camera.matrix_world = Matrix.Translation(eye) @ Matrix([x, z.cross(x), z]).transposed().to_4x4()
    stage.world = bpy.data.worlds.new("world")
    stage.world.use_nodes = True
    stage.world.node_tree.nodes["Background"].inputs["Color"].default_value = (*[scene["sky"]] * 3, 1)
    render, path = stage.render, Path(tempfile.mkdtemp()) / "image.exr"
    render.engine, render.resolution_x, render.resolution_y = "CYCLES", size, size
    render.image_settings.file_format, render.image_settings.color_depth = "OPEN_EXR", "32"
    render.filepath, render.filter_size = str(path), 1.0
    settings = stage.cycles
    settings.pixel_filter_type, settings.max_bounces = "BOX", DEPTH - 1
    for kind in ("diffuse", "glossy"):
        setattr(settings, f"{kind}_bounces", DEPTH - 1)
    settings.sample_clamp_indirect = 0

    def image(threshold: float, seed: int, denoise: bool) -> np.ndarray:
        settings.samples, settings.seed, settings.use_denoising = MOST, seed, denoise
        settings.use_adaptive_sampling, settings.adaptive_threshold = threshold > 0, threshold
        bpy.ops.render.render(write_still=True)
        loaded = bpy.data.images.load(str(path))
        pixels = np.array(loaded.pixels).reshape(size, size, -1)[..., :3]
        bpy.data.images.remove(loaded)
        return pixels

    return image


def luxcore(scene: dict[str, Any], size: int) -> Callable[..., np.ndarray]:
    """Loads the scene into LuxCore; returns a function of threshold (0: none), seed and denoise that renders it."""
    import pyluxcore

    pyluxcore.Init()
    pyluxcore.SetLogHandler(lambda _: None)
    loaded, (eye, at, fov) = pyluxcore.Scene(), scene["view"]
    camera = {"lookat.orig": list(eye), "lookat.target": list(at), "up": [0, 1, 0], "fieldofview": fov}
    everything: dict[str, Any] = {f"scene.camera.{name}": value for name, value in camera.items()}
    everything |= {"scene.camera.type": "perspective", "scene.camera.screenwindow": [-1, 1, -1, 1]}
    if scene["sky"]:
        everything |= {"scene.lights.sky.type": "constantinfinite", "scene.lights.sky.color": [scene["sky"]] * 3}
    for n, (points, faces, colour, rough, radiance) in enumerate(meshes(scene)):
        corners = [tuple(row) for row in points.tolist()]
        loaded.DefineMesh(f"mesh{n}", corners, [tuple(row) for row in faces.tolist()], None, None, None, None)
        name = f"scene.materials.material{n}"
        if rough:
            everything |= {
                f"{name}.type": "metal2",
                f"{name}.fresnel": f"fresnel{n}",
                f"{name}.uroughness": rough,
                f"{name}.vroughness": rough,
                f"scene.textures.fresnel{n}.type": "fresnelcolor",
                f"scene.textures.fresnel{n}.kr": list(colour),
            }
        else:
            everything |= {f"{name}.type": "matte", f"{name}.kd": list(colour)}
        if radiance:
            everything[f"{name}.emission"] = [float(radiance)] * 3
        everything |= {
            f"scene.objects.object{n}.shape": f"mesh{n}",
            f"scene.objects.object{n}.material": f"material{n}",
        }
    loaded.Parse(properties(pyluxcore, everything))

    def image(threshold: float, seed: int, denoise: bool) -> np.ndarray:
        pipeline = ["NOP", *(["INTEL_OIDN"] if denoise else [])]
        config = {
            "renderengine.type": "PATHCPU",
            "renderengine.seed": seed,
            "path.pathdepth.total": DEPTH - 1,
            "path.pathdepth.diffuse": DEPTH - 1,
            "path.pathdepth.glossy": DEPTH - 1,
            "sampler.type": "SOBOL",
            "sampler.sobol.adaptive.strength": 0.9 if threshold else 0.0,
            "film.noiseestimation.warmup": 32,
            "film.noiseestimation.step": 32,
            "film.width": size,
            "film.height": size,
            "film.filter.type": "NONE",
            "film.outputs.0.type": "RGB_IMAGEPIPELINE",
            "film.outputs.0.filename": "image.exr",
            "batch.haltspp": MOST,
        }
        config |= {f"film.imagepipelines.0.{k}.type": kind for k, kind in enumerate(pipeline)}
        if threshold:
            halt = {"": threshold, ".warmup": 32, ".step": 32}
            config |= {f"batch.haltnoisethreshold{name}": value for name, value in halt.items()}
        session = pyluxcore.RenderSession(pyluxcore.RenderConfig(properties(pyluxcore, config), loaded))
        session.Start()
        while not session.HasDone():
            time.sleep(0.02)
            session.UpdateStats()
        session.Stop()
        pixels = np.zeros((size, size, 3), dtype=np.float32)
        session.GetFilm().GetOutputFloat(pyluxcore.FilmOutputType.RGB_IMAGEPIPELINE, pixels, 0, True)
        return pixels.astype(float)

    return image


def properties(pyluxcore: Any, values: dict[str, Any]) -> Any:
    """Returns ``values`` as LuxCore's properties."""
    found = pyluxcore.Properties()
    for name, value in values.items():
        found.Set(pyluxcore.Property(name, value))
    return found


#: Renderer -> the function that loads a scene, and the measured thresholds.
RENDERERS: dict[str, tuple[Callable[..., Callable[..., np.ndarray]], tuple[float, ...]]] = {
    "cycles": (cycles, (0.1, 0.03, 0.01)),
    "luxcore": (luxcore, (0.2, 0.1, 0.05)),
}


def measure(options: argparse.Namespace) -> None:
    """Appends the threshold, the true error and the processor seconds of each image of one renderer to the file."""
    load, thresholds = RENDERERS[options.renderer]
    for name, scene in SCENES.items():
        render = load(scene, options.size)
        truth = [luminance(render(0.0, seed, False)) for seed in (100, 101)]
        for denoise in (False, True):
            for threshold in thresholds:
                for seed in range(1, options.rounds + 1):
                    begun = time.process_time()
                    image = luminance(render(threshold, seed, denoise))
                    seconds = time.process_time() - begun
                    error = np.sqrt(max(np.mean((image - truth[0]) * (image - truth[1])), 0))
                    row = [options.renderer, name, denoise, threshold, float(error), seconds]
                    with options.file.open("a", encoding="utf-8") as file:
                        print(json.dumps(row), file=file)
                    print(*row, flush=True)


def described(scene: dict[str, Any], size: int) -> dict[str, Any]:
    """Returns the scene as a dictionary for Mitsuba."""
    import mitsuba as mi
    from subjects import diffuse, rgb, sphere, with_film

    eye, at, fov = scene["view"]
    look = mi.ScalarTransform4f().look_at(list(eye), list(at), [0, 1, 0])
    found: dict[str, Any] = {"type": "scene", "integrator": {"type": "path", "max_depth": DEPTH}}
    if scene["sky"]:
        found["sky"] = {"type": "constant", "radiance": rgb(scene["sky"])}
    for n, (corner, u, v, colour, radiance) in enumerate(scene["rectangles"]):
        p, u, v = np.array(corner), np.array(u) / 2, np.array(v) / 2
        matrix = np.eye(4)
        matrix[:3] = np.stack([u, v, np.cross(u, v), p + u + v], axis=1)
        found[f"rectangle{n}"] = {"type": "rectangle", "to_world": mi.ScalarTransform4f(matrix)} | (
            {"emitter": {"type": "area", "radiance": rgb(radiance)}} if radiance else {"bsdf": diffuse(*colour)}
        )
    for n, (center, radius, colour, rough) in enumerate(scene["balls"]):
        metal = {"type": "roughconductor", "alpha": rough, "specular_reflectance": rgb(*colour)}
        found[f"ball{n}"] = sphere(list(center), radius, bsdf=metal if rough else diffuse(*colour))
    sensor = {"type": "perspective", "fov": fov, "to_world": look}
    return with_film(found | {"sensor": sensor}, {"width": size, "height": size})


def ours(options: argparse.Namespace) -> None:
    """Renders each scene to the errors in the file, and prints the table."""
    import mitsuba as mi

    mi.set_variant("llvm_ad_rgb")
    import mitsuba_prosim

    rows = [json.loads(line) for line in options.file.read_text(encoding="utf-8").splitlines()]
    scenes = {name: mi.load_dict(described(scene, options.size)) for name, scene in SCENES.items()}
    warm: set[tuple[str, bool]] = set()
    print("| | image | error / threshold | spread | all images | time / ours |\n|---|---|---:|---:|---:|---:|")
    for renderer, denoise in dict.fromkeys((row[0], row[2]) for row in rows):
        ratios, times, every = [], [], []
        for name in SCENES:
            chosen = [row for row in rows if (row[0], row[1], row[2]) == (renderer, name, denoise)]
            every += [row[4] / row[3] for row in chosen]
            ratios.append(np.mean([row[4] / row[3] for row in chosen]))
            found = []
            for seed, row in enumerate(chosen):
                for _ in range(2 - ((name, denoise) in warm)):
                    begun = time.process_time()
                    mitsuba_prosim.render(scenes[name], row[4], denoise=denoise, seed=seed, progress=False)
                warm.add((name, denoise))
                found.append(row[5] / (time.process_time() - begun))
            times.append(np.median(found))
        kind, wide = "denoised" if denoise else "raw", max(ratios) / min(ratios)
        cells = [f"{min(ratios):.3f}–{max(ratios):.3f}", f"{wide:.1f}", f"{min(every):.3f}–{max(every):.3f}"]
        print("|", " | ".join([renderer, kind, *cells, f"{min(times):.1f}–{max(times):.1f}"]), "|", flush=True)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("renderer", choices=[*RENDERERS, "ours"])
    parser.add_argument("file", type=Path)
    parser.add_argument("--size", type=int, default=64, help="width in pixels")
    parser.add_argument("--rounds", type=int, default=2, help="number of images, each with another seed")
    options = parser.parse_args()
    (ours if options.renderer == "ours" else measure)(options)


if __name__ == "__main__":
    main()
