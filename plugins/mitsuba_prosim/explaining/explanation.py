"""Explains why a pixel has its value: the function ``explain`` and its result."""

from __future__ import annotations

import json
import re
from collections.abc import Mapping, Sequence
from contextlib import nullcontext
from dataclasses import asdict, dataclass, field, replace
from functools import partial
from html import escape
from pathlib import Path
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from .. import atomic
from ..alone import alone
from ..compat import PLACE, denormals_rounded
from ..engine.camera import coarse_film, is_perspective, without_crop_window
from ..engine.estimator import Estimator
from ..engine.plan import Plan
from ..engine.render import Render
from ..registry import PLUGINS, create
from ..scene.scene_file import SceneFile, pick_sensor
from . import explanation_page, noise, page_data
from .nodes import Node, Numbers
from .recorder import Places, Recorder

#: Maximum number of samples of an explanation.
MOST_SAMPLES = 1 << 14
#: Maximum number of samples that the sentences on the noise are about.
MOST_OUTLIERS = 8
#: Maximum number of pixels of the image on the page, and number of samples of each pixel.
PREVIEW_PIXELS, PREVIEW = 1 << 17, 4
#: An unlimited depth in Mitsuba's integrators.
UNLIMITED = (1 << 32) - 1


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
    #: What the page draws besides: the patterns of random numbers, lobes, and boxes of shapes.
    drawing: dict[str, Any] = field(default_factory=dict, repr=False)

    def json(self) -> str:
        """Returns the explanation as JSON text."""
        return json.dumps(asdict(self))

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
    the image also has a part of the samples of the pixels around, and a note says so. If ``spp`` is 0, an adaptive
    image has the first of these samples. An integrator of Mitsuba that follows paths is explained by paths of
    ``prosim``, which a note says, too.

    Raises ValueError for a pixel outside the image, a sample that does not exist, and an integrator without samples of
    its own, and RuntimeError in scalar variants.
    """
    with atomic.scratch() as folder:
        file = None if isinstance(scene, mi.Scene) else SceneFile(scene, folder)
        loaded, names = (scene, None) if file is None else (file.load(), places(file))
        samples = Samples.of(loaded, pixel, spp, sensor, integrator, seed, names)
        told = samples.explanation(sample)
        return replace(told, drawing=samples.drawing({told.sample: told.nodes}))


@dataclass
class Samples:
    """The samples of one pixel, with the records of all their rays."""

    recorder: Recorder
    estimator: Estimator
    plan: Plan
    pixel: tuple[int, int]
    #: Column and row of the pixel in the whole film.
    where: tuple[int, int]
    channels: tuple[str, ...]
    values: np.ndarray
    notes: list[str]
    shares: dict[str, float] = field(default_factory=dict)
    #: Sum of the channels of the brightest of the further samples from which the shares are estimated.
    brightest: float = 0.0

    @classmethod
    def of(
        cls,
        scene: Any,
        pixel: tuple[int, int],
        spp: int,
        sensor: int | mi.Sensor = 0,
        integrator: mi.Integrator | None = None,
        seed: int = 0,
        names: Places | None = None,
    ) -> Samples:
        """Takes all samples of a pixel; ``names`` are the file's :func:`places`. Errors: those of :func:`explain`."""
        if not dr.is_jit_v(mi.Float):
            raise RuntimeError("explain: scalar variants record no rays; use an llvm or cuda variant.")
        camera, notes = sensor if isinstance(sensor, mi.Sensor) else pick_sensor(scene, sensor), list[str]()
        film = camera.film()
        size, (x, y) = tuple(map(int, film.crop_size())), pixel
        if not (0 <= x < size[0] and 0 <= y < size[1]):
            raise ValueError(
                f"the pixel {x},{y} is outside the image, whose pixels are 0,0 to {size[0] - 1},{size[1] - 1}"
            )
        if not 0 <= spp <= MOST_SAMPLES:
            raise ValueError(f"spp is {spp}; give a number from 1 to {MOST_SAMPLES}, or 0 for the integrator's own")
        integrator = explained_integrator(integrator or scene.integrator(), notes)
        if not film.rfilter().is_box_filter():
            notes.append("The film's filter also adds samples of the pixels around to the pixel's value in the image.")
        stored = re.search(r"pixel_format = (\w+)", str(film))
        if stored and not stored[1].startswith("rgb") and not mi.is_monochromatic:
            notes.append("The film converts these colours to those of its pixel_format.")
        window = nullcontext() if is_perspective(camera) else without_crop_window(camera)
        with alone(), denormals_rounded(), dr.suspend_grad():
            estimator = integrator.estimator(scene, camera)
            sampling = integrator.sampling.uniform(spp) if spp else integrator.sampling
            plan = Plan.of(sampling, film, seed, spp)
            if plan.policy.first_samples < plan.max_samples:
                notes.append("The image is adaptive: this pixel may have fewer or more samples there.")
            left, top = map(int, film.crop_offset())
            recorder, where = Recorder(estimator.transport, names or {}), (x + left, y + top)
            kept = [name for name in estimator.channels.names[: estimator.channels.names.index("W")] if name != "A"]
            samples = cls(recorder, estimator, plan, pixel, where, tuple(kept), np.empty((0,)), notes)
            with window:  # a render takes its samples without it, too
                samples._take(spp or min(plan.noisy_samples, MOST_SAMPLES))
                samples.shares, samples.brightest = noise.shares(estimator, plan, *where, len(kept))
        return samples

    def _take(self, count: int) -> None:
        estimator, plan, recorder, values = self.estimator, self.plan, self.recorder, list[np.ndarray]()
        caustics, channels_kept = estimator.transport.caustics, slice(len(self.channels))
        size = count if caustics is None else caustics.maps(plan.n)
        for first in range(0, count, size):
            if caustics is not None:
                caustics.use_pass(plan.photon_seed, first // size, plan.n)
            width = min(size, count - first)
            t = dr.opaque(mi.UInt32, first) + dr.arange(mi.UInt32, width)
            x, y = (dr.opaque(mi.Int32, value, width) for value in self.where)
            points = plan.points(x, y, t)
            if caustics is not None:
                points.division = t, caustics.n
            ray, weight, _ = estimator.camera_ray(x, y, points)

            def channels(L: mi.Spectrum, ray: Any = ray, weight: Any = weight) -> Sequence[mi.Float]:
                return estimator.channels.values(L * weight, ray.wavelengths, mi.Float(0))[channels_kept]

            recorder.t, recorder.channels = t, channels
            taken = recorder.record(partial(estimator.sample, plan, x, y, t))[0][channels_kept]
            values.append(np.array([np.broadcast_to(np.array(value), width) for value in taken], np.float64).T)
        self.values = np.concatenate(values)

    def explanation(self, sample: int | None = None) -> Explanation:
        """Returns the explanation of the pixel with the nodes of one sample; the default is the brightest sample."""
        count = len(self.values)
        if sample is None:
            sample = int(np.argmax(self.values.sum(axis=1)))
        if not 0 <= sample < count:
            raise ValueError(f"the sample {sample} does not exist; the pixel has the samples 0 to {count - 1}")
        values = tuple(tuple(map(float, value)) for value in self.values)
        mean = tuple(map(float, self.values.mean(axis=0)))
        nodes, notes = self.recorder.nodes(sample), list(self.notes)
        if not any(values[sample]) and any(any(node.contribution) for node in nodes):
            notes.append(f"The light of sample {sample} is not finite, so the sample counts as black.")
        seed = int(self.plan.seed[0])
        brighter = self.brightest / max(float(self.values.sum(axis=1).max()), 1e-30)
        told = noise.sentences(self.shares, brighter, self.recorder, *self.deviations())
        light = noise.origins(self.recorder, count)
        return Explanation(
            self.pixel, seed, self.channels, values, mean, sample, nodes, light, self.shares, told, tuple(notes)
        )

    def deviations(self) -> tuple[np.ndarray, int]:
        """Returns weights of the samples, and a number of samples: those that are farthest from the mean and make 90 %
        of the squared error, at most :data:`MOST_OUTLIERS`. Each of them has the weight 1, and the middle sample minus
        their number, so that the weighted sum of a light is its difference.
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
                "patterns": page_data.patterns(estimator, plan, self.where, len(self.values), trees.values()),
                "lobes": page_data.lobe_directions(estimator, trees),
                "camera": explanation_page.pinhole(estimator),
                "size": list(map(int, estimator.sensor.film().crop_size())),
                "boxes": [[list(box.min), list(box.max)] for box in boxes],
            }


def page(file: SceneFile, scene: Any = None, image: Any = None, **arguments: Any) -> str:
    """Returns an HTML page that explains a pixel of the scene in ``file``.

    ``scene`` is the scene if it is loaded already. ``image`` holds the colours of the image, shape (height, width, 3)
    of the film or of a coarse image; None: the function renders it. The other ``arguments`` are those of
    :meth:`Samples.of`.
    """
    samples = Samples.of(scene or file.load(), names=places(file), **arguments)
    told, estimator, plan = samples.explanation(), samples.estimator, samples.plan
    order = np.argsort(-samples.values.sum(axis=1), kind="stable")
    shown = dict.fromkeys([*order[: explanation_page.BRIGHTEST].tolist(), int(order[len(order) // 2]), int(order[-1])])
    if image is None:
        image = preview(estimator, plan)
    trees = {sample: samples.recorder.nodes(sample) for sample in shown}
    pictured = {"name": file.path.name, "image": explanation_page.picture(image)}
    return explanation_page.html(asdict(told), trees, **pictured, **samples.drawing(trees))


def preview(estimator: Estimator, plan: Plan) -> Any:
    """Returns a coarse image of the scene, rendered with the photons of the samples."""
    sensor = estimator.sensor
    with alone(), coarse_film(sensor, PREVIEW_PIXELS):
        coarse = Estimator(estimator.scene, sensor, estimator.transport, estimator.channels)
        few = Plan.of(plan.sampling.uniform(PREVIEW), sensor.film(), plan.seed, PREVIEW)
        return Render(replace(few, n=plan.n), coarse).run().image()


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
        if PLUGINS["prosim_denoised"] in outer:
            notes.append("The image is denoised; these are the samples before.")
        if PLUGINS["prosim_adaptive"] in outer:
            notes.append("The image has other samples, because prosim_adaptive gives prosim other random numbers.")
        return integrator
    kind, _, parameters = str(integrator).partition("[")  # class_name() is not that of a class in Python
    depth, direct = re.match(r"\s*max_depth = (-?\d+)", parameters), kind == "DirectIntegrator"
    if not (isinstance(integrator, mi.SamplingIntegrator) and (depth or direct)):
        raise ValueError(f"the integrator {kind} has no samples of pixels that can be explained; give prosim or path")
    most = 2 if direct or depth is None else int(depth[1])
    level = -1 if most in (-1, UNLIMITED) else max(most - 2, 0)
    found = "the same light, except light that media scatter," if "Vol" in kind else "the same light"
    notes.append(
        f"The integrator {kind} keeps no record of its rays; these are paths of prosim, which find {found} with other "
        "random numbers."
    )
    return create("prosim", max_level=level, diffuse_bounces=-1, hide_emitters=integrator.hide_emitters)


def places(file: SceneFile) -> Places:
    """Returns the name in the scene file, and the line, of each shape or emitter that has an id."""
    if file.document is not None:  # the translator names the line in a comment
        text = file.xml.read_text(encoding="utf-8")
        found = re.findall(r"<!-- ([^>]*?) \(line (\d+)\) -->\s*<(?:shape|emitter) [^>]*\bid=\"([^\"]+)\"", text)
        # The numbers of surfaces are those of the scene; lamps have no numbers.
        names = {key: what.partition(" of ")[0] for what, _, key in found}
        names |= {key: f"{what} (line {line})" for what, line, key in found if key.startswith("light")}
        return {key: (names[key], f"{file.path.name}, line {line} ({what})") for what, line, key in found}
    shapes = [node for node in file.state.nodes if node.type == mi.ObjectType.Shape and node.props.id()]
    lines = {node.props.id(): PLACE.search("At " + mi.parser.file_location(file.state, node)) for node in shapes}
    return {name: (name, f"{Path(line[1]).name}, line {line[2]}") for name, line in lines.items() if line}
