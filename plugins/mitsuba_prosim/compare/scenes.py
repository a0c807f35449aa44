"""One scene under several integrators and samplers, and under either transport of light."""

from __future__ import annotations

import difflib
import json
import re
from abc import ABC, abstractmethod
from typing import Any

import mitsuba as mi

from ..compat import UNREFERENCED
from ..engine import origin
from ..scene import scene_file
from ..scene.errors import nearest
from ..scene.overrides import SAMPLING
from .runs import Contestant

#: How a contestant is said.
FORM = "INTEGRATOR[:SAMPLER][,PARAMETER=VALUE...]"


class Scene(ABC):
    """A scene that contestants are made from.

    ``settings``: parameters of the integrators that the scene has its own for, by the integrator's name; ``ambient``
    and ``background``: those of its ``prosim`` integrator, textures or None; ``key``: text that identifies what is
    rendered.
    """

    def __init__(self, settings: dict[str, dict[str, Any]], key: str, ambient: Any = None, background: Any = None):
        self.settings, self.key, self.ambient, self.background = settings, key, ambient, background
        self._made: dict[tuple[str | None, bool], mi.Scene] = {}

    @abstractmethod
    def load(self, sampler: str | None) -> mi.Scene:
        """Makes the scene, its first sensor with another sampler if one is named."""

    def scene(self, sampler: str | None = None, lit_by_background: bool = False) -> mi.Scene:
        """The scene with another sampler, and the integrator's background made an emitter, as other integrators need
        it to be. Of equal arguments it is the same scene, and the parts are always the same.
        """
        lit = lit_by_background and self.background is not None
        if (sampler, lit) not in self._made:
            self._made[sampler, lit] = self._make(sampler, lit)
        return self._made[sampler, lit]

    def _make(self, sampler: str | None, lit: bool) -> mi.Scene:
        if sampler is not None:
            shared = self.scene(None, lit)
            return seen_by(self.scene(sampler).sensors()[0] if lit else self.load(sampler).sensors()[0], shared)
        if not lit:
            return self.load(None)
        unlit = self.scene(None)
        return seen_by(unlit.sensors()[0], unlit, background=sky(self.background))

    def contestant(self, spec: Spec, transport: str, **overrides: Any) -> Contestant:
        """The :class:`Contestant` that ``spec`` describes, under a ``transport``: "scene" (what the scene file says),
        or that of another integrator, "paths" or "direct".

        ``overrides``: parameters of the integrator, before those of the spec; ``spp`` for the sample count.
        """
        spp = overrides.pop("spp", 0)
        settings = {"type": spec.integrator} | self.settings.get(spec.integrator, {})
        if spec.integrator == "prosim":
            if self.ambient is not None:
                settings["ambient"] = self.ambient
            if self.background is not None:
                settings["background"] = self.background
        if transport != "scene":
            for name in ("ambient", "background", "hide_emitters"):
                settings.pop(name, None)
            if spec.integrator == "prosim":
                settings |= {"max_level": 0} if transport == "direct" else {"max_level": -1, "diffuse_bounces": -1}
        settings |= overrides | spec.parameters
        scene = self.scene(spec.sampler, lit_by_background=transport != "scene")
        counting = None
        if spec.integrator == "prosim":
            counting = mi.load_dict(settings | {"aovs": "samples"})
        elif not spp:
            spp = scene.sensors()[0].sampler().sample_count()
        return Contestant(spec.text, scene, mi.load_dict(settings), spp, counting)


class FileScene(Scene):
    """A scene of a file."""

    def __init__(self, file: scene_file.SceneFile):
        self.file = file
        first = file.load()
        scene_file.pick_sensor(first, 0)
        node = next((n for n in file.state.nodes if n.type == mi.ObjectType.Integrator), None)
        settings = {}
        if node is not None:
            settings[node.props.plugin_name()] = {
                name: node.props[name]
                for name in node.props
                if isinstance(node.props[name], (bool, int, float, str)) and name not in ("id", "type")
            }
        own = first.integrator()
        super().__init__(settings, reference_key(file), getattr(own, "ambient", None), getattr(own, "background", None))
        self._made[None, False] = first

    def load(self, sampler: str | None) -> mi.Scene:
        """Makes the scene of the file."""
        return self.file.load(sampler)


def reference_key(file: scene_file.SceneFile) -> str:
    """Text that is the same where a reference of ``file`` may be used again: its content, how it was changed, and the
    versions that render it.
    """
    versions = {name: version for name, version in origin.here().items() if name in origin.EXACT}
    return json.dumps([file.digest(), file.changes, versions], sort_keys=True)


def can_light(background: Any) -> bool:
    """Whether a background, a texture or None, can be made an emitter, where it is to be one."""
    return background is None or not background.is_spatially_varying() or "data" in mi.traverse(background)


def sky(background: mi.Texture) -> dict[str, Any]:
    """The emitter that a background is to other integrators. Raises ValueError for a texture that is no bitmap."""
    if not can_light(background):
        raise ValueError(
            f"a background of {background.class_name()} can't light the scene for other integrators; expected a "
            "colour or a bitmap"
        )
    if background.is_spatially_varying():
        return {"type": "envmap", "bitmap": mi.Bitmap(mi.traverse(background)["data"])}
    return {"type": "constant", "radiance": background}


def seen_by(sensor: mi.Sensor, scene: mi.Scene, **more: Any) -> mi.Scene:
    """A scene of the parts of ``scene`` and ``more``, with ``sensor``.

    The parts are shared, not loaded again: Dr.Jit traces and compiles every BSDF and emitter that is alive, in
    whichever scene, for every image.
    """
    parts = {f"shape_{i}": shape for i, shape in enumerate(scene.shapes())}
    parts |= {f"emitter_{i}": e for i, e in enumerate(scene.emitters()) if e.get_shape() is None}
    ids = {part: part.id() for part in parts.values()}
    try:
        return mi.load_dict({"type": "scene", "sensor": sensor, **parts, **more})
    finally:
        for part, name in ids.items():  # load_dict calls them after its keys
            part.set_id(name)


class Spec:
    """A contestant in words: INTEGRATOR[:SAMPLER][,PARAMETER=VALUE...], such as ``path:multijitter,max_depth=5``."""

    def __init__(self, text: str):
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
        """The same with other values of some parameters, under the same name."""
        result = Spec(self.text)
        result.parameters |= parameters
        return result

    def until(self, noise: float) -> Spec:
        """The same until the noise is so small, if the integrator :attr:`counts_itself`: by ``graded``, unless the
        words say otherwise.
        """
        return self.but(**{"adaptive": "graded"} | self.parameters | {"noise": noise}) if self.counts_itself else self

    @property
    def counts_itself(self) -> bool:
        """Whether the integrator decides on the number of samples."""
        return self.integrator == "prosim"

    @property
    def transport(self) -> str | None:
        """The transport that the integrator is bound to; None for one that can follow any."""
        return {"prosim": None, "direct": "direct"}.get(self.integrator, "paths")


#: Parameters of integrators, Mitsuba's and ours, that contestants are given.
PARAMETERS = (*SAMPLING, "caustics", "diffuse_bounces", "hide_emitters", "max_depth", "max_level", "rr_depth")


def unknown(spec: Spec, error: RuntimeError) -> str | None:
    """What is said where ``error`` is that Mitsuba knows no such integrator, sampler or parameter; None where it is
    another.
    """
    if (found := UNREFERENCED.search(str(error))) and found[2] in spec.parameters:
        near = difflib.get_close_matches(found[2], PARAMETERS, n=1)
        hint = f" Did you mean {near[0]}?" if near else ""
        return f"{spec.text!r}: {found[1]} has no parameter {found[2]!r}.{hint}"
    found = re.search(r'Plugin "(.+?)" not found', str(error))
    kinds = {spec.integrator: mi.ObjectType.Integrator, spec.sampler: mi.ObjectType.Sampler}
    if not found or (name := found[1]) not in kinds:
        return None
    meant = nearest(name, kinds[name].name.lower())
    return f"{spec.text!r}: there is no {kinds[name].name.lower()} {name!r}." + (
        f" Did you mean {meant}?" if meant else f" What is compared is {FORM}, such as path:multijitter."
    )


def typed(text: str) -> bool | int | float | str:
    """``text`` as the truth value or number that it spells, or itself."""
    if text.lower() in ("true", "false"):
        return text.lower() == "true"
    for kind in (int, float):
        try:
            return kind(text)
        except ValueError:
            pass
    return text
