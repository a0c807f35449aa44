"""One scene with several integrators and samplers."""

from __future__ import annotations

import difflib
import gc
import json
from typing import Any

import mitsuba as mi

from ..compat import UNREFERENCED
from ..engine import origin
from ..scene import scene_file
from ..scene.overrides import SAMPLING
from .runs import Contestant

#: The text of a contestant.
FORM = "INTEGRATOR[:SAMPLER][,PARAMETER=VALUE...]"

#: Parameters of integrators, for suggestions.
PARAMETERS = (*SAMPLING, "caustics", "diffuse_bounces", "hide_emitters", "max_depth", "max_level", "rr_depth")


class Spec:
    """The text of a contestant, such as ``path:multijitter,max_depth=5``, and its parts."""

    def __init__(self, text: str) -> None:
        head, *parameters = text.split(",")
        self.text = text
        self.integrator, _, sampler = head.partition(":")
        self.sampler = sampler or None
        self.parameters: dict[str, Any] = {}
        for parameter in parameters:
            name, equals, value = parameter.partition("=")
            if not (name and equals and value):
                raise ValueError(f"{parameter!r} in {text!r} is not of the form PARAMETER=VALUE")
            self.parameters[name.strip()] = typed(value.strip())
        if not self.integrator:
            raise ValueError(f"{text!r} is not of the form {FORM}")

    def but(self, **parameters: Any) -> Spec:
        """The same with other values of some parameters."""
        result = Spec(self.text)
        result.parameters |= parameters
        return result

    def until(self, noise: float) -> Spec:
        """The same with a goal for the noise, if the integrator :attr:`is_adaptive`."""
        return self.but(**{"adaptive": "graded"} | self.parameters | {"noise": noise}) if self.is_adaptive else self

    @property
    def is_adaptive(self) -> bool:
        """Whether the integrator decides on the number of samples."""
        return self.integrator == "prosim"

    @property
    def transport(self) -> str | None:
        """The transport of light that the integrator computes; None for one that can compute any."""
        return {"prosim": None, "direct": "direct"}.get(self.integrator, "paths")


class Scene:
    """The scene of a file, from which contestants are made."""

    def __init__(self, file: scene_file.SceneFile) -> None:
        self.file, self.scene = file, file.load()
        self._sensors: dict[str | None, mi.Sensor] = {None: scene_file.pick_sensor(self.scene, 0)}
        self._lit: mi.Scene | None = None
        own: Any = self.scene.integrator()
        #: The ambient term and the background of the scene's ``prosim`` integrator: textures or None.
        self.ambient, self.background = getattr(own, "ambient", None), getattr(own, "background", None)
        props = next(n.props for n in file.state.nodes if n.type == mi.ObjectType.Integrator)
        #: Name and plain parameters of the scene's integrator.
        self.integrator = props.plugin_name()
        self.settings = {name: value for name, value in props.items() if isinstance(value, (bool, int, float, str))}
        here = origin.here()
        #: Identifies the image, for cached references.
        self.key = json.dumps([file.digest(), file.changes, [here[name] for name in origin.EXACT]], sort_keys=True)

    def sensor(self, sampler: str | None = None) -> mi.Sensor:
        """The first sensor, with another sampler if one is named."""
        if sampler not in self._sensors:
            self._sensors[sampler] = self.file.load(sampler).sensors()[0]
            gc.collect()  # Dr.Jit traces the BSDFs of all scenes that exist
        return self._sensors[sampler]

    def lit(self) -> mi.Scene:
        """The scene with the integrator's background as an emitter, which other integrators need."""
        if self._lit is None:
            self._lit = self.scene if self.background is None else lit(self.scene, self.background)
        return self._lit

    def contestant(self, spec: Spec, transport: str, **overrides: Any) -> Contestant:
        """The :class:`Contestant` of ``spec`` for a ``transport``: "scene" (that of the scene file), "paths" or
        "direct".

        ``overrides``: parameters of the integrator, before those of the spec; ``spp`` for the sample count.
        """
        spp, settings = overrides.pop("spp", 0), dict[str, Any](type=spec.integrator)
        if spec.integrator == self.integrator:
            settings |= self.settings
        if transport != "scene":
            settings.pop("hide_emitters", None)
        elif spec.integrator == "prosim":
            given = {"ambient": self.ambient, "background": self.background}
            settings |= {name: value for name, value in given.items() if value is not None}
        if transport != "scene" and spec.integrator == "prosim":
            settings |= {"max_level": 0} if transport == "direct" else {"max_level": -1, "diffuse_bounces": -1}
        settings |= overrides | spec.parameters
        sensor = self.sensor(spec.sampler)
        counting = mi.load_dict(settings | {"aovs": "samples"}) if spec.is_adaptive else None
        if not spec.is_adaptive and not spp:
            spp = sensor.sampler().sample_count()
        scene = self.scene if transport == "scene" else self.lit()
        return Contestant(spec.text, scene, sensor, mi.load_dict(settings), spp, counting)


def can_light(background: Any) -> bool:
    """Whether ``background`` (a texture or None) can be turned into an emitter."""
    return background is None or not background.is_spatially_varying() or "data" in mi.traverse(background)


def lit(scene: mi.Scene, background: mi.Texture) -> mi.Scene:
    """A scene of the same objects and of an emitter that corresponds to ``background``, without a sensor.

    The objects are shared, as Dr.Jit traces all BSDFs and emitters that exist. Raises ValueError for a texture that is
    not a bitmap.
    """
    if not can_light(background):
        raise ValueError(
            f"a background of {background.class_name()} can't light the scene for other integrators; use a colour or a "
            "bitmap"
        )
    sky = {"type": "constant", "radiance": background}
    if background.is_spatially_varying():
        sky = {"type": "envmap", "bitmap": mi.Bitmap(mi.traverse(background)["data"])}
    parts = {f"shape_{i}": shape for i, shape in enumerate(scene.shapes())}
    parts |= {f"emitter_{i}": emitter for i, emitter in enumerate(scene.emitters()) if emitter.get_shape() is None}
    names = {part: part.id() for part in parts.values()}
    try:
        return mi.load_dict({"type": "scene", **parts, "background": sky})
    finally:
        for part, name in names.items():  # load_dict renames them
            part.set_id(name)


def unknown_parameter(spec: Spec, error: RuntimeError) -> str | None:
    """The message for a parameter that the integrator does not have; None for another ``error``."""
    found = UNREFERENCED.search(str(error))
    if not found or found[2] not in spec.parameters:
        return None
    near = difflib.get_close_matches(found[2], PARAMETERS, n=1)
    return f"{spec.text!r}: {found[1]} has no parameter {found[2]!r}." + (f" Did you mean {near[0]}?" if near else "")


def typed(text: str) -> bool | int | float | str:
    """``text`` as a truth value, a number, or itself."""
    if text.lower() in ("true", "false"):
        return text.lower() == "true"
    for kind in (int, float):
        try:
            return kind(text)
        except ValueError:
            pass
    return text
