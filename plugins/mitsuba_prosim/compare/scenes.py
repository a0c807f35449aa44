"""One scene under several integrators and samplers, and under either transport of light."""

import hashlib
from pathlib import Path

import mitsuba as mi
import prosim_scene

from ..command import session
from .runs import Contestant


class Scene:
    """A scene file, XML or in the thesis's language, that contestants are made from.

    ``folder``: where a translation is written; ``resolution``, ``samples``: (width, height) and N instead of the
    scene's; ``definitions``: values for the ``$key`` constants of XML; ``language``: options of the translation.
    """

    def __init__(self, path, folder, resolution=None, samples=None, definitions=None, **language):
        self.path, self.resolution, self.definitions = Path(path), resolution, definitions or {}
        self.xml = self.path
        if self.path.suffix.lower() != ".xml":
            self.xml = prosim_scene.translate(self.path, Path(folder), resolution=resolution, **language)
        self.loaded = {}
        state = self._parse(None)
        node = next((n for n in state.nodes if n.type == mi.ObjectType.Integrator), None)
        own = self._instance(None).integrator()
        self.settings = {}
        if node is not None:
            self.settings["type"] = node.props.plugin_name()
            self.settings |= {name: node.props[name] for name in node.props
                              if isinstance(node.props[name], (bool, int, float, str)) and name not in ("id", "type")}
        if samples and self.settings.get("type") == "prosim":
            self.settings["samples"] = samples
        self.ambient, self.background = getattr(own, "ambient", None), getattr(own, "background", None)
        self.key = self._key(state)

    def _parse(self, sampler):
        with session.search_paths(first=[self.xml.parent, self.path.parent]):
            state = session.parse(self.xml, self.definitions)
        for node in state.nodes:
            if node.type == mi.ObjectType.Film and self.resolution:
                node.props["width"], node.props["height"] = self.resolution
            elif node.type == mi.ObjectType.Sampler and sampler:
                count = node.props.get("sample_count", 4)
                props = mi.Properties(sampler)
                props["sample_count"] = count
                node.props = props
        return state

    def _instance(self, sampler):
        if sampler not in self.loaded:
            with session.search_paths(first=[self.xml.parent, self.path.parent]):
                scene = session.instantiate(self._parse(sampler))
            session.pick_sensor(scene, 0)
            self.loaded[sampler] = scene if sampler is None else seen_by(scene.sensors()[0], self._instance(None))
        return self.loaded[sampler]

    def _key(self, state):
        """Identifies what is rendered: the file and those that it names."""
        digest = hashlib.sha256(self.xml.read_bytes())
        for node in state.nodes:
            for name in node.props:
                if isinstance(value := node.props[name], str):
                    for file in (self.xml.parent / value, self.path.parent / value):
                        if file.is_file():
                            digest.update(file.read_bytes())
                            break
        return f"{digest.hexdigest()} {self.resolution} {sorted(self.definitions.items())} {mi.variant()} {mi.__version__}"

    def scene(self, sampler=None, lit_by_background=False):
        """The scene with another sampler, and the integrator's background made an emitter, as other integrators need
        it to be."""
        if not lit_by_background or self.background is None:
            return self._instance(sampler)
        key = sampler, "lit"
        if key not in self.loaded:
            if self.background.is_spatially_varying():
                light = {"type": "envmap", "bitmap": mi.Bitmap(mi.traverse(self.background)["data"])}
            else:
                light = {"type": "constant", "radiance": self.background}
            lit = self.loaded.get((None, "lit")) or seen_by(self._sensor(None), self._instance(None), background=light)
            self.loaded[None, "lit"] = lit
            self.loaded[key] = lit if sampler is None else seen_by(self._sensor(sampler), lit)
        return self.loaded[key]

    def _sensor(self, sampler):
        return self._instance(sampler).sensors()[0]

    def contestant(self, spec, transport, **overrides):
        """The :class:`Contestant` that ``spec`` describes, under a ``transport``: "scene" (what the scene file says), or
        that of another integrator, "paths" or "direct".

        ``overrides``: parameters of the integrator, before those of the spec; ``spp`` for the sample count.
        """
        spp = overrides.pop("spp", 0)
        settings = dict(self.settings) if self.settings.get("type") == spec.integrator else {"type": spec.integrator}
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


def seen_by(sensor, scene, **more):
    """A scene of the parts of ``scene`` and ``more``, with ``sensor``.

    The parts are shared, not loaded again: Dr.Jit traces and compiles every BSDF and emitter that is alive, in whichever
    scene, for every image.
    """
    parts = {f"shape_{i}": shape for i, shape in enumerate(scene.shapes())}
    parts |= {f"emitter_{i}": e for i, e in enumerate(scene.emitters()) if e.get_shape() is None}
    return mi.load_dict({"type": "scene", "sensor": sensor, **parts, **more})


class Spec:
    """A contestant in words: INTEGRATOR[:SAMPLER][,PARAMETER=VALUE...], such as ``path:multijitter,max_depth=5``."""

    def __init__(self, text):
        head, *parameters = text.split(",")
        self.text = text
        self.integrator, _, self.sampler = (part or None for part in head.partition(":"))
        self.parameters = {}
        for parameter in parameters:
            name, equals, value = parameter.partition("=")
            if not (name and equals and value):
                raise ValueError(f"{parameter!r} in {text!r} is not of the form PARAMETER=VALUE")
            self.parameters[name.strip()] = typed(value.strip())
        if self.integrator is None:
            raise ValueError(f"{text!r} is not of the form INTEGRATOR[:SAMPLER][,PARAMETER=VALUE...]")

    @property
    def counts_itself(self):
        """Whether the integrator decides on the number of samples."""
        return self.integrator == "prosim"

    @property
    def transport(self):
        """The transport that the integrator is bound to; None for one that can follow any."""
        return {"prosim": None, "direct": "direct"}.get(self.integrator, "paths")


def typed(text):
    """``text`` as the truth value or number that it spells, or itself."""
    if text.lower() in ("true", "false"):
        return text.lower() == "true"
    for kind in (int, float):
        try:
            return kind(text)
        except ValueError:
            pass
    return text
