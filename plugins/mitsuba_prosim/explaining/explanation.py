"""Explains why a pixel has its value: the function ``explain`` and its result."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from functools import partial
from html import escape
from numbers import Real
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from .. import atomic
from ..alone import alone
from ..compat import PLACE, denormals_rounded, description, dr_array, is_users
from ..engine.camera import coarse_film, without_crop_window
from ..engine.estimator import Estimator
from ..engine.plan import Plan
from ..parameters import check_whole, pick_sensor
from ..registry import PLUGINS, create
from ..scene.black import depth_limit, innermost
from ..scene.scene_file import SceneFile, require_scene
from . import explanation_page, noise
from .recorder import Node, Numbers, Places, Recorder

#: Maximum number of samples of an explanation.
MOST_SAMPLES = 1 << 14
#: Maximum number of samples that the sentences on the noise are about.
MOST_OUTLIERS = 8
#: Maximum number of pixels of the image on the page, and number of samples of each pixel.
PREVIEW_PIXELS, PREVIEW = 1 << 17, 2
#: The comment in which the translator names a shape or an emitter, and its line.
COMMENT = re.compile(r"<!-- ([^>]*?) \(line (\d+)\) -->\s*<(?:shape|emitter) [^>]*\bid=\"([^\"]+)\"")
#: Plugin around ``prosim`` -> how its image differs from the samples.
OUTER_NOTES = {
    "prosim_denoised": "The image is denoised; these are the samples before.",
    "prosim_adaptive": "The image has other samples, because prosim_adaptive gives prosim other random numbers.",
}


@dataclass(frozen=True)
class Explanation:
    """Why a pixel has its value, as plain data; the function :func:`explain` returns it."""

    #: Column and row of the pixel in the image, from the upper left corner; the seed of the image.
    pixel: tuple[int, int]
    seed: int
    #: Names of the film's channels, in the order of the values.
    channels: tuple[str, ...]
    #: The value of each sample of the pixel, and their mean.
    values: tuple[Numbers, ...] = field(repr=False)
    mean: Numbers
    #: Index of the explained sample, and the nodes of its tree or path, whose contributions sum to its value.
    sample: int
    nodes: tuple[Node, ...] = field(repr=False)
    #: Sentences on the light: where it comes from, and which shapes hide lamps.
    light: tuple[str, ...]
    #: Dimension of the random numbers -> its share in the variance (:mod:`.noise`); and sentences on the noise.
    shares: dict[str, float]
    noise: tuple[str, ...]
    #: Sentences on the differences between this explanation and the image of the scene; usually none.
    notes: tuple[str, ...]
    #: What the page draws besides: the patterns of random numbers, and boxes of shapes.
    drawing: dict[str, Any] = field(default_factory=dict, repr=False)

    def _repr_html_(self) -> str:
        """Returns the page of this explanation, without the image, within a frame for a notebook."""
        page = explanation_page.html(asdict(self), {self.sample: self.nodes}, **self.drawing)
        return f'<iframe srcdoc="{escape(page)}" style="width: 100%; height: 50rem; border: 0"></iframe>'


def explain(
    scene: mi.Scene | str | Path,
    pixel: tuple[int, int],
    sample: int | None = None,
    spp: int = 64,
    sensor: int = 0,
    integrator: mi.Integrator | None = None,
    seed: int = 0,
) -> Explanation:
    """Explains why a pixel is bright, dark or noisy: the rays of a sample, and the light that each ray adds.

    ``scene``
        A Mitsuba scene, or the path of a scene file in the thesis's scene language or in XML. Only a path gives the
        lines of shapes.
    ``pixel``
        Column and row of the pixel in the image, from the upper left corner.
    ``sample``
        Index of the sample whose rays are returned; None: the sample with the greatest sum of the film's channels.
    ``spp``
        Number of samples of the pixel; 0: that of the integrator, N².
    ``sensor``, ``integrator``, ``seed``
        As in ``mi.render``, whose image with the same ``spp`` and ``seed`` has the same samples.

    The mean of the samples is the value of the pixel in the image, if the film has a box filter. With another filter,
    the image also has a part of the samples of the pixels around, and a note says so. If ``spp`` is 0, an image with
    adaptive sampling may have only the first of these samples. An integrator of Mitsuba that follows paths is explained
    by paths of ``prosim``, which a note says, too.

    Raises ValueError for a pixel outside the image, a sample that does not exist, and an integrator without samples of
    its own, and RuntimeError in scalar variants.
    """
    with atomic.scratch() as folder:
        file = SceneFile(scene, folder) if isinstance(scene, (str, Path)) else None
        if file is None:
            require_scene("explain", scene)
        loaded, names = (scene, None) if file is None else (file.load(), places(file))
        samples = Samples(loaded, pixel, spp, sensor, integrator, seed, names)
        told = samples.explanation(sample)
        return replace(told, drawing=samples.drawing({told.sample: told.nodes}))


class Samples:
    """The samples of one pixel, with the records of all their rays."""

    def __init__(
        self,
        scene: Any,
        pixel: tuple[int, int],
        spp: int,
        sensor: int | mi.Sensor = 0,
        integrator: mi.Integrator | None = None,
        seed: int = 0,
        names: Places | None = None,
    ) -> None:
        """Takes all samples of a pixel; ``names`` are the file's :func:`places`. Errors: those of :func:`explain`."""
        if not dr.is_jit_v(mi.Float):
            raise RuntimeError("explain: scalar variants record no rays; use an llvm or cuda variant.")
        camera, spp = pick_sensor(scene, sensor), check_whole("spp", spp)
        film, self.notes = camera.film(), list[str]()
        (w, h), (left, top) = map(int, film.crop_size()), map(int, film.crop_offset())
        if np.shape(pixel) != (2,) or not all(isinstance(value, Real) for value in pixel):
            raise ValueError(f"pixel is {pixel!r}; give its column and row, such as (120, 80)")
        if not all(0 <= value < size and value == int(value) for value, size in zip(pixel, (w, h))):
            place = ",".join(map(str, pixel))
            raise ValueError(f"the pixel {place} is outside the image, whose pixels are 0,0 to {w - 1},{h - 1}")
        self.pixel = x, y = int(pixel[0]), int(pixel[1])
        if spp > MOST_SAMPLES:
            raise ValueError(f"spp is {spp}; give a number from 1 to {MOST_SAMPLES}, or 0 for the integrator's own")
        self.integrator = integrator = explained_integrator(integrator or scene.integrator(), self.notes)
        if not film.rfilter().is_box_filter():
            self.notes.append("The film's filter also adds samples of the pixels around to the pixel's value.")
        stored = re.search(r"pixel_format = (\w+)", description(film))
        if stored and not stored[1].startswith("rgb") and not mi.is_monochromatic:
            self.notes.append("The film converts these colours to those of its pixel_format.")
        #: Column and row of the pixel in the whole film.
        self.where = x + left, y + top
        with alone(), denormals_rounded(), dr.suspend_grad():
            self.estimator: Estimator = integrator.estimator(scene, camera)
            sampling = integrator.sampling.uniform(spp) if spp else integrator.sampling
            self.plan = plan = Plan.of(sampling, film, seed, spp)
            if plan.policy.first_samples < plan.max_samples:
                self.notes.append("The image is adaptive: this pixel may have fewer or more samples there.")
            self.recorder, stored_names = Recorder(self.estimator.transport, names or {}), self.estimator.channels.names
            self.channels = tuple(name for name in stored_names[: stored_names.index("W")] if name != "A")
            with without_crop_window(camera):  # a render takes its samples without it, too
                self._take_all(spp or min(plan.noisy_samples, MOST_SAMPLES))

    def _take_all(self, count: int) -> None:
        """Takes ``count`` samples of the pixel, and in the same kernel those that tell the shares."""
        caustics, values, found = self.estimator.transport.caustics, list[np.ndarray](), list[np.ndarray]()
        pairs = np.arange(noise.PAIRS * (noise.FURTHER + 1))
        more = [lanes(pairs // noise.PAIRS, pairs % noise.PAIRS, *self.where)]
        size = count if caustics is None else caustics.maps(self.plan.n)
        for first in range(0, count, size):
            if caustics is not None:
                caustics.use_pass(self.plan.photon_seed, first // size, self.plan.n)
            t = np.arange(first, min(first + size, count))
            own, *others = self._take(lanes(noise.OWN, t, *self.where), *more)
            values.append(own)
            found, more = others or found, []
        #: The values of all samples, shape (samples, channels), their luminance, and the :func:`.noise.shares`.
        self.values, self.luminance = np.concatenate(values)[:, 1:], np.concatenate(values)[:, 0]
        self.shares = noise.shares(found[0][:, 0])
        light = found[0][-noise.PAIRS :, 1:].sum(axis=1)
        #: Ratio of the brightest of the further samples to the brightest of the pixel.
        self.brighter = float(light.max()) / max(float(self.values.sum(axis=1).max()), 1e-30)

    def _take(self, *blocks: np.ndarray) -> list[np.ndarray]:
        """Takes the samples of :func:`lanes`, and records those whose first number is :data:`.noise.OWN`.

        Returns the luminance and the values of the channels of each sample of each block.
        """
        estimator, plan, recorder, kept = self.estimator, self.plan, self.recorder, slice(len(self.channels))
        caustics = estimator.transport.caustics
        which, t, x, y = map(dr_array, np.concatenate(blocks, axis=1))
        x, y = mi.Int32(x), mi.Int32(y)
        plans: Any = SimpleNamespace(noisy_samples=plan.noisy_samples)
        plans.points = lambda *where: noise.Points(plan, which, estimator.transport, *where)
        points = plans.points(x, y, t)
        if caustics is not None:
            points.division = t, caustics.n
        ray, weight, _ = estimator.camera_ray(x, y, points)

        def channels(L: mi.Spectrum) -> Sequence[mi.Float]:
            return estimator.channels.values(L * weight, ray.wavelengths, mi.Float(0))[kept]

        recorder.t, recorder.recorded, recorder.channels = t, which == dr.opaque(mi.UInt32, noise.OWN), channels
        taken, luminance, _ = recorder.record(partial(estimator.sample, plans, x, y, t))
        values = [np.broadcast_to(np.array(value, np.float64), len(t)) for value in (luminance, *taken[kept])]
        values[0] = np.nan_to_num(values[0])
        return np.split(np.stack(values, axis=1), np.cumsum([block.shape[1] for block in blocks])[:-1])

    def explanation(self, sample: int | None = None) -> Explanation:
        """Returns the explanation of the pixel with the nodes of one sample; the default is the brightest sample."""
        count = len(self.values)
        sample = int(np.argmax(self.values.sum(axis=1))) if sample is None else check_whole("sample", sample)
        if sample >= count:
            raise ValueError(f"the sample {sample} does not exist; the pixel has the samples 0 to {count - 1}")
        values, mean = tuple(map(tuple, self.values.tolist())), tuple(self.values.mean(axis=0).tolist())
        nodes, notes = self.recorder.nodes(sample), list(self.notes)
        if not any(values[sample]) and any(any(node.contribution) for node in nodes):
            notes.append(f"The light of sample {sample} is not finite, so the sample counts as black.")
        told = noise.sentences(self.shares, self.brighter, self.recorder, *self.deviations())
        light, known = noise.origins(self.recorder, count), (self.pixel, int(self.plan.seed[0]), self.channels)
        return Explanation(*known, values, mean, sample, nodes, light, self.shares, told, tuple(notes))

    def deviations(self) -> tuple[np.ndarray, int]:
        """Returns ``(weights, count)``: the outliers are the ``count`` samples that are farthest from the mean and make
        90 % of the squared error, at most :data:`MOST_OUTLIERS`. An outlier has the weight 1, and the middle sample the
        weight -``count``, so a weighted sum is the excess of the outliers over the middle sample.
        """
        light = self.values.sum(axis=1)
        errors = np.square(light - light.mean())
        order = np.argsort(-errors, kind="stable")
        count = min(int(np.searchsorted(np.cumsum(errors[order]), 0.9 * errors.sum())) + 1, MOST_OUTLIERS)
        weights = np.zeros(len(light))
        weights[order[:count]] += 1
        weights[np.argsort(light)[len(light) // 2]] -= count
        return weights, count

    def drawing(self, trees: Mapping[int, Sequence[Node]]) -> dict[str, Any]:
        """Returns what the page draws for the nodes of samples, ``trees``; see :attr:`Explanation.drawing`."""
        estimator, plan = self.estimator, self.plan
        boxes = [box for box in (shape.bbox() for shape in estimator.scene.shapes()) if box.valid()]
        with alone():
            return {
                "n": 0 if plan.uses_sobol else plan.n,
                "patterns": explanation_page.patterns(estimator, plan, self.where, len(self.values), trees.values()),
                "camera": explanation_page.pinhole(estimator),
                "size": list(map(int, estimator.sensor.film().crop_size())),
                "boxes": [[list(box.min), list(box.max)] for box in boxes],
            }


def lanes(*numbers: Any) -> np.ndarray:
    """Returns four integers for each lane, shape (4, lanes): ``which`` of :class:`.noise.Points`, the index of the
    sample, and x and y of the pixel.
    """
    return np.stack(np.broadcast_arrays(*numbers)).reshape(len(numbers), -1).astype(np.uint32)


def page(file: SceneFile, scene: Any = None, image: Any = None, command: str = "", **arguments: Any) -> str:
    """Returns an HTML page that explains a pixel of the scene in ``file``.

    ``scene`` is the scene if it is loaded already. ``image`` holds the colours of the image, shape (height, width, 3)
    of the film or of a coarse image; None: the function renders a coarse one. ``command`` is the command line that
    makes the page. The other ``arguments`` are those of :class:`Samples`.
    """
    scene = scene or file.load()
    samples = Samples(scene, names=places(file), **arguments)
    told, order = samples.explanation(), np.argsort(-samples.values.sum(axis=1), kind="stable").tolist()
    shown = [*order[: explanation_page.BRIGHTEST], order[len(order) // 2], order[-1]]
    trees = {told.sample: told.nodes} | {sample: samples.recorder.nodes(sample) for sample in shown}
    if image is None:
        with alone(), coarse_film(samples.estimator.sensor, PREVIEW_PIXELS):
            image = samples.integrator.render(scene, samples.estimator.sensor, spp=PREVIEW)
    pictured = {"name": file.path.name, "image": explanation_page.picture(image), "command": command}
    return explanation_page.html(asdict(told), trees, **pictured, **samples.drawing(trees))


def explained_integrator(integrator: Any, notes: list[str]) -> Any:
    """Returns the integrator ``prosim`` whose samples are explained: ``integrator`` itself, the one that it nests, or
    one that follows the same paths; then the function adds a sentence to ``notes``.

    Raises ValueError if no integrator ``prosim`` follows the paths of ``integrator``.
    """
    outer = set()
    while hasattr(integrator, "nested"):
        outer.add(type(integrator))
        integrator = integrator.nested
    if getattr(integrator, "name", "") == "prosim":
        notes.extend(note for name, note in OUTER_NOTES.items() if PLUGINS[name] in outer)
        return integrator
    if not is_users(integrator):
        integrator = innermost(integrator)  # of aov or moment
    kind, _, parameters = description(integrator).partition("[")  # class_name() is not that of a class in Python
    known = kind == "DirectIntegrator" or re.match(r"\s*max_depth = ", parameters)
    if not (isinstance(integrator, mi.SamplingIntegrator) and known) or is_users(integrator):
        raise ValueError(f"the integrator {kind} has no samples of pixels that can be explained; give prosim or path")
    level = depth_limit(integrator)[1]
    found = "the same light, except light that media scatter," if "Vol" in kind else "the same light"
    paths = f"these are paths of prosim, which find {found} with other random numbers"
    notes.append(f"The integrator {kind} keeps no record of its rays; {paths}.")
    most = -1 if math.isinf(level) else max(int(level), 0)
    return create("prosim", max_level=most, diffuse_bounces=-1, hide_emitters=integrator.hide_emitters)


def places(file: SceneFile) -> Places:
    """Returns the name in the scene file, and the line, of each shape or emitter that has an id, in XML also of each
    material.
    """
    kinds, document = (mi.ObjectType.Shape, mi.ObjectType.Emitter, mi.ObjectType.BSDF), file.document
    if document is None:
        nodes = [node for node in file.state.nodes if node.type in kinds and node.props.id()]
        found = {node.props.id(): PLACE.search("At " + mi.parser.file_location(file.state, node)) for node in nodes}
        lines = {key: (line[2], f"{Path(line[1]).name}, line {line[2]} ({key})") for key, line in found.items() if line}
        return {key: (f"{key} (line {number})", place) for key, (number, place) in lines.items()}
    leaf_lines = {document.name_of(node, whole=True): document.line("csg", node) for node, _ in document.scene.leaves}
    named = {}
    for what, line, key in COMMENT.findall(file.xml.read_text(encoding="utf-8")):
        of = what.partition(" of ")[2].partition(" towards ")[0]
        leaves = [f"{name} (line {leaf_lines[name]})" for name in of.split(", ") if name in leaf_lines]
        name = ", ".join(leaves) + ", ..." * of.endswith("...") if leaves else f"{what} (line {line})"
        named[key] = (name, f"{file.path.name}, line {line} ({what})")
    return named
