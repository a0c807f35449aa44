"""Records the rays of all samples of a pixel, and the light that each ray adds.

The recorder observes the light transport that renders the image, so the recorded samples are those of the image. Each
lane of an array is one sample.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Any, NamedTuple, TypeAlias

import drjit as dr
import mitsuba as mi
import numpy as np

from ..compat import shape_number
from ..masks import but_not
from ..optics.nested import all_shapes
from ..transport import lobes
from ..transport.ray import Ray, Vertex
from ..transport.transport import Transport
from .nodes import Emission, LampSample, LobeShare, Node, Numbers

#: Id of a shape or emitter -> its name, and its line in the scene file.
Places: TypeAlias = "Mapping[str, tuple[str, str]]"
#: The parts of a node's light that are known only as sums.
SUMS = ("ambient", "background", "photons")


class Record(NamedTuple):
    """The values of one computation; the last axis of each array is that of the samples."""

    event: str
    values: dict[str, Any]


class Recorder:
    """Records the computations of ``transport`` for ``width`` samples (:attr:`.Context.observer`).

    ``channels`` converts the radiance along the camera rays to the values of the film's channels. ``places`` are the
    names and lines of shapes and emitters in the scene file.
    """

    def __init__(
        self, transport: Transport, width: int, channels: Callable[[mi.Spectrum], Sequence[mi.Float]], places: Places
    ) -> None:
        self.transport, self.width, self.channels, self.lines = transport, width, channels, dict(places.values())
        self.records: list[Record] = []
        shapes, words = all_shapes(transport.scene), {key: name for key, (name, _) in places.items()}
        names = [name_of(shape, number, words) for number, shape in enumerate(shapes)]
        #: Number of a shape in Dr.Jit -> its name; and the names of the lamps, in the order of their numbers.
        self.shapes = {shape_number(mi.ShapePtr(shape)): name for shape, name in zip(shapes, names)}
        self.lamps = [lamp_name(lamp, k, self.shapes, words) for k, lamp in enumerate(transport.lights.emitters)]
        self.black = (0.0,) * len(channels(mi.Spectrum(0)))

    def __call__(self, event: str, ray: Ray, **values: Any) -> None:
        """Stores the values of one computation, see :meth:`.Context.observe`."""
        if event == "lamp":
            values = self._lamp_values(**values)
        if "value" in values:
            values["contribution"] = self.channels(ray.throughput * values.pop("value"))
        if event == "scatter":
            after, bs = values.pop("after"), values.pop("bs")
            values |= {"d": after.d, "throughput": after.throughput, "pdf": bs.pdf, "type": bs.sampled_type}
        if event == "ray":
            si = values.pop("si")
            normal = si.sh_frame.n * dr.select(si.wi.z < 0, mi.Float(-1), 1)
            values |= {"d": ray.d, "arriving": ray.throughput, "p": si.p, "shape": si.shape, "normal": normal}
            values |= {"o": ray.o, "level": ray.level, "valid": si.is_valid()}
        values["number"] = ray.node
        dr.schedule(values)  # the loop evaluates these values together with its state, in one kernel
        self.records.append(Record(event, values))

    def finish(self) -> None:
        """Converts all values to NumPy arrays."""
        dr.eval()
        self.records = [Record(event, self._numpy(values)) for event, values in self.records]

    def _lamp_values(
        self, vertex: Vertex, sample: Any, terms: Any, f: mi.Spectrum, visible: mi.Bool, lamp: Any, value: Any
    ) -> dict[str, Any]:
        """Returns the values of a lamp's sample, and traces which shape hides it."""
        ds, weight = sample
        scatters = vertex.smooth & (ds.pdf > 0) & (dr.max(dr.abs(f * weight)) > 0)
        hidden = but_not(scatters, visible)
        shadow_ray = vertex.si.spawn_ray_to(ds.p)
        blocker = self.transport.scene.ray_intersect(shadow_ray, mi.RayFlags.Minimal, coherent=False, active=hidden)
        shares = [
            (lobe_names(lobe.type_mask), bsdf, pdf, dr.select(vertex.inseparable & (number > 0), mi.Float(0), part))
            for number, (lobe, bsdf, pdf, part) in enumerate(terms)
            if lobe is not None
        ]
        state = dr.select(scatters, dr.select(visible, mi.UInt32(0), 1), 2)
        values = {"active": vertex.smooth, "lamp": mi.UInt32(lamp), "p": ds.p, "pdf": ds.pdf, "radiance": weight}
        return values | {"state": state, "occluder": blocker.shape, "shares": shares, "value": value}

    def _numpy(self, value: Any) -> Any:
        """Converts Dr.Jit arrays in nested lists and dictionaries to NumPy arrays with an entry for each sample."""
        if isinstance(value, dict):
            return {name: self._numpy(one) for name, one in value.items()}
        if isinstance(value, (list, tuple)):
            return [self._numpy(one) for one in value]
        if isinstance(value, str):
            return value
        array = np.array(dr.reinterpret_array(mi.UInt32, value) if isinstance(value, mi.ShapePtr) else value)
        return np.broadcast_to(array, (*array.shape[:-1], self.width))

    # ---------------------------------------------------------------- the nodes of a sample

    def nodes(self, i: int) -> tuple[Node, ...]:
        """Returns the nodes of the sample in lane ``i``, in the order in which the rays were followed."""
        rays: list[tuple[Record, list[Record]]] = []
        follows = False
        for record in self.records:
            if record.event == "ray":
                follows = bool(record.values["active"][i])
                rays += [(record, [])] if follows else []
            elif follows and ("active" not in record.values or record.values["active"][i]):
                rays[-1][1].append(record)
        return tuple(self._nodes(i, rays))

    def _nodes(self, i: int, rays: Sequence[tuple[Record, list[Record]]]) -> Iterator[Node]:
        """Yields the nodes of the sample ``i``; ``rays`` are its rays, each with the other records of the node."""
        leaving, last = dict[int, list[Record]](), 0
        for ray, records in rays:
            number = int(ray.values["number"][i])
            parent = number // 2 if self.transport.settings.follows_tree else last
            leaving[number] = [record for record in records if record.event == "scatter"]
            yield self._node(i, ray.values, records, number, parent, leaving.get(parent, []))
            last = number

    def _node(
        self, i: int, values: dict[str, Any], records: list[Record], number: int, parent: int, left: list[Record]
    ) -> Node:
        met = bool(values["valid"][i])
        shape = self.shapes.get(int(values["shape"][i]), "a shape without a name") if met else None
        sums: dict[str, Any] = {r.event: at(r.values["contribution"], i) for r in records if r.event in SUMS}
        lamps = tuple(self._lamp(i, record.values) for record in records if record.event == "lamp")
        found = [self._emission(i, record.values) for record in records if record.event == "emission"]
        emission = next((one for one in found if any(one.radiance)), None)
        parts = [*sums.values(), *(one.contribution for one in lamps), *([emission.contribution] if emission else [])]
        return Node(
            number=number,
            parent=parent,
            level=int(values["level"][i]),
            shape=shape,
            line=self.lines.get(shape or ""),
            origin=at(values["o"], i),
            direction=at(values["d"], i),
            position=at(values["p"], i) if met else None,
            normal=at(values["normal"], i) if met else None,
            **self._chosen(i, values, left),
            throughput=at(values["attenuated"], i),
            lamps=lamps,
            emission=emission,
            **{name: sums.get(name, self.black) for name in SUMS},
            contribution=tuple(map(sum, zip(self.black, *parts))),
        )

    @staticmethod
    def _chosen(i: int, ray: dict[str, Any], left: list[Record]) -> dict[str, Any]:
        """Returns the fields ``lobe``, ``density``, ``probability`` and ``survival`` of a node.

        ``left`` are the rays that were sampled at the parent: the reflected and the refracted one of a tree, of which
        both may be followed, or the specular and the diffuse one of a path, of which one is followed.
        """
        if not left:
            return {"lobe": "camera", "density": None, "probability": None, "survival": 1.0}
        one = min((r.values for r in left), key=lambda v: float(np.abs(v["d"] - ray["d"])[:, i].sum()))
        flags, pdf = int(one["type"][i]), float(one["pdf"][i])
        ideal = bool(lobes.has_any(flags, *lobes.IDEAL))
        sampled, followed = (at(x, i) for x in (one["throughput"], ray["arriving"]))
        survival = max(sampled) / max(followed) if max(followed) > 0 else 1.0
        chosen = {"density": None, "probability": pdf} if ideal else {"density": pdf, "probability": None}
        return {"lobe": lobe_names(flags), "survival": survival, **chosen}

    def _lamp(self, i: int, values: dict[str, Any]) -> LampSample:
        state = ("visible", "hidden", "dark")[int(values["state"][i])]
        return LampSample(
            self.lamps[int(values["lamp"][i])],
            at(values["p"], i),
            state,
            self.shapes.get(int(values["occluder"][i]), "a shape without a name") if state == "hidden" else None,
            float(values["pdf"][i]),
            at(values["radiance"], i),
            tuple(LobeShare(name, at(f, i), float(pdf[i]), float(w[i])) for name, f, pdf, w in values["shares"]),
            at(values["contribution"], i),
        )

    def _emission(self, i: int, values: dict[str, Any]) -> Emission:
        number = min(int(values["lamp"][i]), len(self.lamps) - 1)
        weight, density = float(values["weight"][i]), float(values["pdf"][i])
        return Emission(self.lamps[number], at(values["radiance"], i), density, weight, at(values["contribution"], i))


def at(value: Any, i: int) -> Numbers:
    """Returns the components of ``value`` in lane ``i`` as finite Python numbers."""
    return tuple(float(np.nan_to_num(one[i])) for one in value)


def lobe_names(flags: int) -> str:
    """Returns the names of the lobes in the BSDF ``flags``, such as "glossy reflection"; "all lobes" for all."""
    kinds = {"diffuse": lobes.DIFFUSE, "glossy": lobes.GLOSSY, "ideal": lobes.IDEAL[:2]}
    if all(lobes.has_any(flags, *names) for names in kinds.values()):
        return "all lobes"
    found = [kind for kind, names in kinds.items() if lobes.has_any(flags, *names)]
    ways = [way for way in ("Reflection", "Transmission") if flags & lobes.mask(*(k + way for k in WAYS))]
    passes = lobes.has_any(flags, "Null") and not found
    return "straight through" if passes else f"{' and '.join(found)} {' and '.join(ways).lower()}"


#: Beginnings of the names of ``mi.BSDFFlags``.
WAYS = ("Diffuse", "Glossy", "Delta")


def name_of(thing: mi.Object, number: int, words: Mapping[str, str]) -> str:
    """Returns the name of a shape or emitter: the one of its id in ``words``, else its id; if it has no id in the scene
    file, its class and its ``number``.
    """
    key = thing.id()
    return words.get(key, key) if key and not key.startswith("__") else f"{thing.class_name()} {number}"


def lamp_name(emitter: mi.Emitter, number: int, shapes: Mapping[int, str], words: Mapping[str, str]) -> str:
    """Returns the name of the emitter's shape, or the name of an emitter without a shape."""
    shape = emitter.get_shape()
    return name_of(emitter, number, words) if shape is None else shapes[shape_number(mi.ShapePtr(shape))]
