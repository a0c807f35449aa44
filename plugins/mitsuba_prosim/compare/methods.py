"""Prepares the compared methods: integrators with parameters and samplers, which render one scene."""

from __future__ import annotations

import gc
import time
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from ..compat import PLACE
from ..optics import nested
from ..parameters import from_text, pick_sensor
from ..registry import create
from ..scene import rendering, scene_file
from ..scene.session import message

#: Light transport -> the parameters of ``prosim`` that select this transport.
TRANSPORT: dict[str, dict[str, Any]] = {"direct": {"max_level": 0}, "paths": {"max_level": -1, "diffuse_bounces": -1}}


class Spec:
    """The parsed specification of a method, such as ``path:multijitter,max_depth=5``."""

    def __init__(self, text: str) -> None:
        """Parses ``text``, of the form INTEGRATOR[:SAMPLER][,PARAMETER=VALUE...]; raises ValueError for another one."""
        head, *rest = text.split(",")
        parts = [[part.strip() for part in parameter.partition("=")] for parameter in rest]
        self.text, (self.integrator, _, sampler) = text, head.partition(":")
        self.sampler, self.parameters = sampler or None, {name: from_text(value) for name, _, value in parts}
        if not self.integrator or not all(all(part) for part in parts):
            raise ValueError(f"{text!r} is not of the form INTEGRATOR[:SAMPLER][,PARAMETER=VALUE...]")

    @property
    def is_adaptive(self) -> bool:
        """Whether the integrator is ``prosim``, whose parameters, not the sampler, determine the number of samples."""
        return self.integrator == "prosim"

    @property
    def transport(self) -> str | None:
        """The light paths that the integrator simulates: "paths" (all) or "direct"; None for ``prosim``, which can
        select them.
        """
        return {"prosim": None, "direct": "direct"}.get(self.integrator, "paths")


@dataclass(eq=False)
class Method:
    """A method of a comparison, which renders a scene. ``spp`` is the number of samples per pixel; 0 means that of the
    integrator's parameters.
    """

    name: str
    scene: mi.Scene
    sensor: mi.Sensor
    integrator: mi.Integrator
    spp: int = 0

    def render(self, seed: int) -> tuple[np.ndarray, np.ndarray, float, float]:
        """Renders an image; returns it (height, width, 3), the sample counts (height, width), the elapsed seconds, and
        the processor seconds per thread.
        """
        start, start_cpu = time.perf_counter(), time.process_time()
        spp = self.spp and rendering.samples_taken(self.integrator, self.sensor, self.spp)
        render = rendering.progressive(self.scene, self.sensor, self.integrator, seed, spp).run()
        image = render.half_images()[0]
        seconds, cpu = time.perf_counter() - start, time.process_time() - start_cpu
        return image[..., :3], render.counts(), seconds, cpu / max(dr.thread_count(), 1)


class ComparedScene:
    """A scene that different methods render, so that the methods can be compared."""

    def __init__(self, file: scene_file.SceneFile) -> None:
        self.file, self.scene = file, file.load()
        self._sensors: dict[str | None, mi.Sensor] = {None: pick_sensor(self.scene, 0)}
        textures = {name: getattr(self.scene.integrator(), name, None) for name in ("ambient", "background")}
        #: The ambient term and the background of the scene's ``prosim`` integrator, without missing ones.
        self.textures = {name: texture for name, texture in textures.items() if texture is not None}
        props = next(n.props for n in file.state.nodes if n.type == mi.ObjectType.Integrator)
        #: The plugin of the scene's integrator, and its parameters that are numbers, booleans or strings.
        self.integrator = props.plugin_name()
        self.settings = {name: value for name, value in props.items() if isinstance(value, (bool, int, float, str))}

    def sensor(self, sampler: str | None = None) -> mi.Sensor:
        """Returns the first sensor of the scene, with the sampler plugin ``sampler``, or that of the scene file."""
        if sampler not in self._sensors:
            self._sensors[sampler] = self.file.load(sampler).sensors()[0]
            gc.collect()  # deletes the loaded scene, because Dr.Jit traces the BSDFs of all existing scenes
        return self._sensors[sampler]

    @cached_property
    def lit(self) -> mi.Scene:
        """The scene with the background of ``prosim`` as an emitter, because other integrators have no background. A
        sky replaces the background, because Mitsuba allows only one of them.
        """
        background = self.textures.get("background")
        if background is None or self.scene.environment() is not None:
            return self.scene
        return with_background_emitter(self.scene, background)

    def settings_of(self, spec: Spec) -> dict[str, Any]:
        """Returns the parameters of the scene's integrator if the specification names it, and those of the
        specification.
        """
        return (self.settings if spec.integrator == self.integrator else {}) | spec.parameters

    def method(self, spec: Spec, transport: str, spp: int = 0, **changes: Any) -> Method:
        """Returns the :class:`Method` of a specification, whose parameters ``changes`` replace.

        For ``prosim``, ``transport`` selects the light paths: "scene" (as the scene file says), "paths" (all) or
        "direct". Unless it is "scene", the scene's background is an emitter (:attr:`lit`). The parameters of the
        scene's integrator apply, too, if the specification names it and does not replace them. ``spp`` is the number of
        samples per pixel; 0 means that of the parameters or of the sampler. Raises ValueError for a wrong
        specification.
        """
        settings = self.settings_of(spec)
        if transport != "scene":
            settings.pop("hide_emitters", None)  # the other method would not hide them
        if spec.is_adaptive:
            # Only "scene" has an ambient term and a background; otherwise the background is an emitter of ``lit``.
            settings |= TRANSPORT.get(transport, self.textures)
        settings |= {"type": spec.integrator, **spec.parameters, **changes}
        try:
            sensor, integrator = self.sensor(spec.sampler), mi.load_dict(settings)
        except RuntimeError as error:
            # The message names a line of the scene, but the error is in the specification: removes the line.
            raise ValueError(f"'{spec.text}': {PLACE.sub('', message(error)).removeprefix(': ')}") from None
        if not isinstance(integrator, mi.Integrator):
            raise ValueError(f"'{spec.text}': {spec.integrator} is no integrator; give one, such as path")
        if not spec.is_adaptive:
            spp = spp or sensor.sampler().sample_count()
        return Method(spec.text, self.scene if transport == "scene" else self.lit, sensor, integrator, spp)


def with_background_emitter(scene: mi.Scene, background: mi.Texture) -> mi.Scene:
    """Returns a new scene of the same shapes and emitters, with ``background`` as a further emitter, without a sensor.

    The objects are not copied, because Dr.Jit traces all BSDFs and emitters that exist. Raises ValueError if the
    background varies in space and is not a bitmap.
    """
    if not background.is_spatially_varying():
        sky = create("constant", radiance=background)
    elif "data" in (data := mi.traverse(background)):
        sky = create("envmap", bitmap=mi.Bitmap(data["data"]))
    else:
        name = background.class_name()
        raise ValueError(
            f"a background of {name} can't light the scene for other integrators; use a colour or a bitmap"
        )
    shapes = [*scene.shapes(), *(part for part in nested.parts(scene).values() if isinstance(part, mi.Shape))]
    shapes = [*dict.fromkeys(shapes)]  # also the groups of instances
    lamps = [emitter for emitter in scene.emitters() if emitter.get_shape() is None]
    return create("scene", **{f"part_{k}": part for k, part in enumerate([*shapes, *lamps, sky])})
