"""The denoised image beside the raw one, beside what Open Image Denoise makes of it, and beside its own map of errors.

    python benchmarks/denoise.py [--scene palito ...] [--size 128] [--samples 3 5 8] [--rounds 3]

For each scene and N two halves of about N²/2 samples (``samples``: what they have together) are denoised. Printed are
ratios of errors, each against the converged image: RMSE, tone-mapped (after a square root) and the 99th percentile of
that:

``one pattern``
    the raw image, which is the mean of the halves, over one image of N² samples, scaled to as many samples;
``raw``
    the final image over the raw one; and how much darker or brighter it is, in per cent;
``plain``
    the final image over that of Open Image Denoise with the albedo and the normals of Mitsuba's ``aov`` integrator;
``said``
    RMSE and noise as the maps of errors have them over the true ones, of the final image;
``seconds``
    of the processor, on each thread: rendering, features included, and denoising.
"""

from __future__ import annotations

import time

import drjit as dr
import mitsuba as mi
import mitsuba_prosim
import numpy as np
from mitsuba_prosim.compare import measures
from mitsuba_prosim.denoising import halves
from scenes import ball, copper, diffuse, floor, stage
from suite import NAMES, Reference, Subject, arguments, begin


def texture():
    """A wall of tiles of random colours about as large as a pixel, and a floor of squares that end as small."""
    tiles = np.random.default_rng(1).uniform(0.05, 0.95, (96, 96, 3)).astype(np.float32)
    T = mi.ScalarTransform4f
    wall = {"type": "bitmap", "bitmap": mi.Bitmap(tiles), "filter_type": "nearest"}
    squares = {"type": "checkerboard", "to_uv": T().scale([40, 40, 1])}
    return stage(
        wall={
            "type": "rectangle",
            "to_world": T().translate([0, 0, -2]).scale(6),
            "bsdf": {"type": "diffuse", "reflectance": wall},
        },
        floor=floor({"type": "diffuse", "reflectance": squares}),
    )


def lines():
    """White wires thinner than a pixel before a dark wall."""
    wires = {
        f"wire_{i}": {
            "type": "cylinder",
            "p0": [-3 + 0.25 * i, 0, -1.5],
            "p1": [3 - 0.2 * i, 2.5, -1.5 + 0.05 * i],
            "radius": 0.008,
            "bsdf": {"type": "twosided", "bsdf": diffuse(0.9, 0.9, 0.9)},
        }
        for i in range(24)
    }
    made = stage(**wires)
    made["wall"]["bsdf"] = diffuse(0.05, 0.05, 0.06)
    return made


def highlights():
    """Balls of polished copper, whose highlights are smaller than a pixel."""
    rng = np.random.default_rng(3)
    places = [(rng.uniform(-2.5, 2.5), rng.uniform(-1.8, 2.5)) for _ in range(150)]
    return stage(**{f"ball_{i}": ball([x, 0.1, z], 0.1, copper(0.05)) for i, (x, z) in enumerate(places)})


#: What is hard for a denoiser: the scene and ``max_level``.
HARD = {"texture": (texture, 0), "lines": (lines, 0), "highlights": (highlights, 3)}


class Hard(Subject):
    """A scene of :data:`HARD`, loaded."""

    def __init__(self, name: str, size: int) -> None:
        make, max_level = HARD[name]
        self.name, self.size, self.settings = name, size, {"type": "prosim", "max_level": max_level}
        film = {"type": "hdrfilm", "width": size, "height": size, "pixel_format": "rgb", "rfilter": {"type": "box"}}
        scene = make()
        scene["sensor"] = scene["sensor"] | {"film": film}
        self.scene = mi.load_dict({"type": "scene"} | scene)
        self.key = f"denoise {name} {size} {mi.variant()} {mi.__version__}"


def errors(image: np.ndarray, reference: Reference) -> np.ndarray:
    """RMSE, tone-mapped RMSE and its 99th percentile, the reference's own noise taken off the first two."""
    tone = measures.tone_mapped_error(image, reference.image)
    noise = measures.tone_mapped_error(reference.first, reference.second) / 2
    squares = [
        measures.rmse(image, reference.image) ** 2 - measures.rmse(reference.first, reference.second) ** 2 / 4,
        np.mean(tone**2) - np.mean(noise**2),
        np.percentile(tone, 99) ** 2,
    ]
    return np.sqrt(np.maximum(squares, 1e-12))


def noise(image: np.ndarray, reference: Reference) -> float:
    """What :meth:`.Denoised.noise` estimates."""
    tones = [np.sqrt(np.maximum(x, 0) + 0.01) for x in (image, reference.image, reference.first, reference.second)]
    return float(np.sqrt(max(np.mean((tones[0] - tones[1]) ** 2) - np.mean((tones[2] - tones[3]) ** 2) / 4, 1e-12)))


def plain(raw: np.ndarray, scene: mi.Scene) -> np.ndarray:
    """``raw`` as Open Image Denoise makes it with the features that Mitsuba has."""
    import mitsuba_oidn

    aov = mi.load_dict({"type": "aov", "aovs": "albedo:albedo,normal:sh_normal"})
    features = np.array(mi.render(scene, integrator=aov, spp=halves.FEATURE_SAMPLES**2))[..., -6:].astype(np.float32)
    albedo, normal = (np.ascontiguousarray(x) for x in (np.clip(features[..., :3], 0, 1), features[..., 3:]))
    return np.array(mitsuba_oidn.denoise(np.ascontiguousarray(raw), albedo, normal, hdr=True))


def row(subject: Subject, reference: Reference, n: int, rounds: int) -> str:
    """A line of the table."""
    integrator = subject.integrator(adaptive="none", samples=n)
    sensor, found, seconds = subject.scene.sensors()[0], [], []
    for k in range(rounds):
        begun = time.process_time()
        render = halves.Rendering(subject.scene, sensor, integrator, 2 * k, 0)
        for _ in render:
            pass
        both = render.halves
        rendered = time.process_time()
        result = both.denoised()
        seconds.append((rendered - begun, time.process_time() - rendered))
        samples = render.reached.samples
        one = subject.render(integrator, seed=1000 + k)[..., :3]
        final, raw = errors(result.final, reference), errors(result.raw, reference)
        rms = float(np.sqrt(np.mean(result.final_error.astype(np.float64) ** 2)))
        found.append(
            np.concatenate(
                [
                    raw / errors(one, reference) * np.sqrt(samples / n**2),
                    final / raw,
                    [100 * (result.final.mean() / result.raw.mean() - 1)],
                    final / errors(plain(result.raw, subject.scene), reference),
                    [rms / final[0], result.noise(result.final_error) / noise(result.final, reference)],
                ]
            )
        )
    mean = np.mean(found, axis=0)
    mean[6] = np.max(np.abs(found), axis=0)[6]
    cells = [f"{v:.2f}" for v in mean]
    rendering, denoising = np.min(seconds, axis=0) / dr.thread_count()
    return (
        f"| {subject.name} | {samples:.0f} | {' / '.join(cells[:3])} | {' / '.join(cells[3:6])} | {cells[6]} | "
        f"{' / '.join(cells[7:10])} | {' / '.join(cells[10:])} | {rendering:.1f} + {denoising:.1f} |"
    )


def main() -> None:
    """Prints a table."""
    parser = arguments(__doc__, 128)
    parser.add_argument("--scene", nargs="+", choices=[*NAMES, *HARD], default=[*NAMES[:6], "penumbra", *HARD])
    parser.add_argument("--samples", nargs="+", type=int, default=[3, 5, 8])
    parser.add_argument("--rounds", type=int, default=3)
    options = parser.parse_args()
    begin(options.variant, options.threads)
    assert mitsuba_prosim.denoise
    print("| scene | samples | raw / one pattern | final / raw | light, % | final / plain | said / true | seconds |")
    print("|---|---:|---:|---:|---:|---:|---:|---:|")
    for name in options.scene:
        subject = (Hard if name in HARD else Subject)(name, options.size)
        reference = subject.reference(options.cache, options.reference_seconds)
        for n in options.samples:
            print(row(subject, reference, n, options.rounds), flush=True)


if __name__ == "__main__":
    main()
