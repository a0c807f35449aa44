"""Records the rays of all samples of a pixel, and the light that each ray adds.

The recorder observes the light transport that renders the image, so the recorded samples are those of the image. The
kernel of the samples itself writes the values as rows of tables, in any order, so the number of kernels does not depend
on the numbers of rays and lamps.
"""

from __future__ import annotations

from collections import Counter, defaultdict
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, TypeAlias

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
#: The light that a ray finds, not the surface where it ends.
FOUND_BY_RAYS = ("emission", "background")
#: The states of a lamp's point, by number.
STATES = ("visible", "hidden", "dark")
VISIBLE, HIDDEN, DARK = range(3)
#: Number of rows for which a table first has room.
CAPACITY = 1 << 15


@dataclass
class Table:
    """The values of one computation at all rays of all samples: a row for each ray, a column for each value."""

    event: str
    #: Number of rows, and columns of Dr.Jit.
    count: mi.UInt32
    columns: dict[str, Any]
    #: The columns as NumPy arrays, whose last axis is that of the rows. The rows of a sample follow each other in the
    #: order of their computation.
    rows: dict[str, Any] = field(default_factory=dict)

    def convert(self) -> None:
        """Sets :attr:`rows`."""
        count = int(self.count[0])
        order = np.argsort(np.array(self.columns["sample"])[:count], kind="stable")

        def rows(value: Any) -> np.ndarray:
            array = np.array(value)[..., :count][..., order]
            return np.nan_to_num(array) if array.dtype.kind == "f" else array

        self.rows, self.columns = each(rows, self.columns), {}


class Recorder:
    """Records the computations of ``transport`` for a pixel's samples; ``places``: lines of shapes and emitters."""

    def __init__(self, transport: Transport, places: Places) -> None:
        self.transport, self.lines = transport, dict(places.values())
        self.tables: list[Table] = []
        #: Indices of the samples that are taken; the function that converts the radiance along their camera rays to the
        #: values of the film's channels; maximum number of rows of a table.
        self.t, self.capacity = mi.UInt32(0), CAPACITY
        self.channels: Callable[[mi.Spectrum], Sequence[mi.Float]] = list
        words = {key: name for key, (name, _) in places.items()}
        #: Number of a shape in Dr.Jit -> its name; and the names of the lamps, in the order of their numbers.
        self.shapes = shape_names(transport.scene, words)
        self.lamps = [lamp_name(lamp, k, self.shapes, words) for k, lamp in enumerate(transport.lights.emitters)]

    def record(self, take: Callable[[], Any]) -> Any:
        """Returns ``take()``, which takes samples, and adds their tables."""
        begin = len(self.tables)
        while True:
            del self.tables[begin:]
            self.transport.observer = self
            try:
                taken = take()
            finally:
                self.transport.observer = None
            dr.eval(taken, [(table.count, table.columns) for table in self.tables[begin:]])
            most = max(int(table.count[0]) for table in self.tables[begin:])
            if most <= self.capacity:
                break
            self.capacity = most
        self.tables[begin:] = [table for table in self.tables[begin:] if int(table.count[0])]
        for table in self.tables[begin:]:
            table.convert()
        return taken

    def __call__(self, event: str, ray: Ray, active: mi.Bool | bool = True, **values: Any) -> None:
        """Adds a table with the values of one computation, see :meth:`.Context.observe`."""
        if event == "lamp":
            active, values = values["vertex"].smooth, self._lamp_values(**values)
        if "value" in values:
            values["contribution"] = [*self.channels(ray.throughput * values.pop("value"))]
        if event == "scatter":
            after, bs = values.pop("after"), values.pop("bs")
            values |= {"d": after.d, "throughput": after.throughput, "pdf": bs.pdf, "type": bs.sampled_type}
        if event == "ray":
            si = values.pop("si")
            normal = si.sh_frame.n * dr.select(si.wi.z < 0, mi.Float(-1), 1)
            values |= {"d": ray.d, "arriving": ray.throughput, "p": si.p, "shape": number_of(si.shape)}
            values |= {"normal": normal, "o": ray.o, "level": ray.level, "valid": si.is_valid()}
        values |= {"number": ray.node, "sample": self.t}
        columns = each(lambda value: dr.empty(type(value), self.capacity), values)
        table = Table(event, dr.opaque(mi.UInt32, 0), columns)
        active = dr.full(mi.Bool, True, dr.width(self.t)) & active
        row = dr.scatter_inc(table.count, dr.zeros(mi.UInt32, dr.width(self.t)), active)
        dr.scatter(table.columns, values, row, active & (row < dr.opaque(mi.UInt32, self.capacity)))
        self.tables.append(table)

    def _lamp_values(
        self, vertex: Vertex, sample: Any, terms: Any, f: mi.Spectrum, visible: mi.Bool, lamp: Any, value: Any
    ) -> dict[str, Any]:
        """Returns the values of a lamp's sample, and traces which shape hides it."""
        ds, weight = sample
        scatters = vertex.smooth & (ds.pdf > 0) & (dr.max(dr.abs(f * weight)) > 0)
        hidden = but_not(scatters, visible)
        shadow_ray = vertex.si.spawn_ray_to(ds.p)
        blocker = self.transport.scene.ray_intersect(shadow_ray, mi.RayFlags.Minimal, coherent=False, active=hidden)
        shares = {
            lobe.type_mask: [bsdf, pdf, dr.select(vertex.inseparable & (number > 0), mi.Float(0), part)]
            for number, (lobe, bsdf, pdf, part) in enumerate(terms)
            if lobe is not None
        }
        state = dr.select(scatters, dr.select(visible, mi.UInt32(VISIBLE), HIDDEN), DARK)
        values = {"lamp": mi.UInt32(lamp), "p": ds.p, "pdf": ds.pdf, "radiance": weight, "state": state, "value": value}
        return values | {"occluder": number_of(blocker.shape), "shares": shares}

    def shape(self, number: Any) -> str:
        """Returns the name of the shape with this number in Dr.Jit."""
        return self.shapes.get(int(number), "a shape without a name")

    # ---------------------------------------------------------------- sums over samples

    def sums(self, event: str, keys: Sequence[str], weights: np.ndarray | None = None) -> Counter[tuple[int, ...]]:
        """Returns the sums over all rows of an event: the values of the columns ``keys`` -> the number of their rows;
        or, with ``weights`` of the samples, the sum of their contributions times the weights.

        The column "shape" is the number of the shape at which the ray ends; if the ray itself finds the light, as in
        emission and background, the shape at which it begins. It is 0 where there is no shape.
        """
        found = Counter[tuple[int, ...]]()
        for rows in (table.rows for table in self.tables if table.event == event):
            number = self._parent(rows["number"]) if event in FOUND_BY_RAYS else rows["number"]
            columns = rows | {"shape": self._shape_at(rows["sample"], number)}
            chosen = [columns[key].astype(np.int64) for key in keys]
            sizes = [int(column.max()) + 1 for column in chosen]
            codes, where = np.unique(np.ravel_multi_index(tuple(chosen), sizes), return_inverse=True)
            amounts = None if weights is None else sum(map(np.float64, rows["contribution"])) * weights[rows["sample"]]
            totals = np.bincount(where, amounts).tolist()
            found.update(dict(zip(zip(*(key.tolist() for key in np.unravel_index(codes, sizes))), totals)))
        return found

    def _parent(self, number: Any) -> Any:
        return number // 2 if self.transport.settings.follows_tree else number - 1

    def _shape_at(self, sample: np.ndarray, number: np.ndarray) -> np.ndarray:
        """Returns the numbers of the shapes where rays end; 0 where a ray does not exist."""
        rays = [table.rows for table in self.tables if table.event == "ray"]
        key, shape = (
            np.concatenate(parts) for parts in zip(*((ray_key(r["sample"], r["number"]), r["shape"]) for r in rays))
        )
        order, wanted = np.argsort(key), ray_key(sample, number)
        at = order[np.minimum(np.searchsorted(key, wanted, sorter=order), len(key) - 1)]
        return np.where(key[at] == wanted, shape[at], 0)

    # ---------------------------------------------------------------- the nodes of a sample

    def nodes(self, sample: int) -> tuple[Node, ...]:
        """Returns the nodes of a sample, in the order in which the rays were followed."""
        rays, others = list[tuple[Table, int]](), defaultdict[tuple[str, int], list[tuple[Table, int]]](list)
        for table in self.tables:
            for i in range(*np.searchsorted(table.rows["sample"], [sample, sample + 1]).tolist()):
                if table.event == "ray":
                    rays.append((table, i))
                else:
                    others[table.event, int(table.rows["number"][i])].append((table, i))
        return tuple(self._node(ray.rows, i, others) for ray, i in rays)

    def _node(self, values: Any, i: int, others: Mapping[tuple[str, int], list[tuple[Table, int]]]) -> Node:
        number, met = int(values["number"][i]), bool(values["valid"][i])
        parent = int(self._parent(number))
        shape = self.shape(values["shape"][i]) if met else None
        black = (0.0,) * len(self.channels(mi.Spectrum(0)))
        sums: dict[str, Any] = dict.fromkeys(SUMS, black)
        for name in SUMS:
            for table, k in others.get((name, number), ()):
                sums[name] = at(table.rows["contribution"], k)
        lamps = tuple(self._lamp(table.rows, k) for table, k in others.get(("lamp", number), ()))
        found = [self._emission(table.rows, k) for table, k in others.get(("emission", number), ())]
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
            **self._chosen(values, i, others.get(("scatter", parent), [])),
            throughput=at(values["attenuated"], i),
            lamps=lamps,
            emission=emission,
            **sums,
            contribution=tuple(map(sum, zip(black, *parts))),
        )

    @staticmethod
    def _chosen(ray: Any, i: int, left: Sequence[tuple[Table, int]]) -> dict[str, Any]:
        """Returns the fields ``lobe``, ``density``, ``probability`` and ``survival`` of a node.

        ``left`` are the rays that were sampled at the parent: the reflected and the refracted one of a tree, of which
        both may be followed, or the specular and the diffuse one of a path, of which one is followed.
        """
        if not left:
            return {"lobe": "camera", "density": None, "probability": None, "survival": 1.0}
        d = ray["d"][:, i]
        one, k = min(((t.rows, k) for t, k in left), key=lambda it: float(np.abs(it[0]["d"][:, it[1]] - d).sum()))
        flags, pdf = int(one["type"][k]), float(one["pdf"][k])
        ideal = bool(lobes.has_any(flags, *lobes.IDEAL))
        sampled, followed = max(at(one["throughput"], k)), max(at(ray["arriving"], i))
        chosen = {"density": None, "probability": pdf} if ideal else {"density": pdf, "probability": None}
        return {"lobe": lobe_names(flags), "survival": sampled / followed if followed > 0 else 1.0, **chosen}

    def _lamp(self, values: Any, i: int) -> LampSample:
        state, shares = STATES[values["state"][i]], values["shares"].items()
        return LampSample(
            self.lamps[int(values["lamp"][i])],
            at(values["p"], i),
            state,
            self.shape(values["occluder"][i]) if state == "hidden" else None,
            float(values["pdf"][i]),
            at(values["radiance"], i),
            tuple(LobeShare(lobe_names(k), at(f, i), float(pdf[i]), float(w[i])) for k, (f, pdf, w) in shares),
            at(values["contribution"], i),
        )

    def _emission(self, values: Any, i: int) -> Emission:
        number = min(int(values["lamp"][i]), len(self.lamps) - 1)
        weight, density = float(values["weight"][i]), float(values["pdf"][i])
        return Emission(self.lamps[number], at(values["radiance"], i), density, weight, at(values["contribution"], i))


def at(column: Any, i: int) -> Numbers:
    """Returns the components of a column in row ``i`` as Python numbers."""
    return tuple(float(one[i]) for one in column) if isinstance(column, list) else tuple(column[..., i].tolist())


def each(function: Callable[[Any], Any], value: Any) -> Any:
    """Applies a function to the arrays in lists and dictionaries."""
    if isinstance(value, dict):
        return {name: each(function, one) for name, one in value.items()}
    return [each(function, one) for one in value] if isinstance(value, list) else function(value)


def number_of(shape: mi.ShapePtr) -> mi.UInt32:
    """Returns the numbers of shapes in Dr.Jit."""
    return dr.reinterpret_array(mi.UInt32, shape)


def ray_key(sample: np.ndarray, number: np.ndarray) -> np.ndarray:
    """Returns numbers that identify the rays."""
    return sample.astype(np.uint64) << 32 | number.astype(np.uint32)


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


def shape_names(scene: mi.Scene, words: Mapping[str, str]) -> dict[int, str]:
    """Returns the names of all shapes (:func:`name_of`), also of those within instances: number in Dr.Jit -> name."""
    return {shape_number(mi.ShapePtr(s)): name_of(s, number, words) for number, s in enumerate(all_shapes(scene))}


def name_of(thing: mi.Object, number: int, words: Mapping[str, str]) -> str:
    """Returns the name of a shape or emitter: from ``words``, its id, or its class and ``number``."""
    key = thing.id()
    return words.get(key, key) if key and not key.startswith("__") else f"{thing.class_name()} {number}"


def lamp_name(emitter: mi.Emitter, number: int, shapes: Mapping[int, str], words: Mapping[str, str]) -> str:
    """Returns the name of the emitter's shape, or the name of an emitter without a shape."""
    shape = emitter.get_shape()
    return name_of(emitter, number, words) if shape is None else shapes[shape_number(mi.ShapePtr(shape))]
