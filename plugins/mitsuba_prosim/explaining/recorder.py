"""Records the rays of all samples of a pixel, and the light that each ray adds.

The recorder observes the light transport that renders the image, so the recorded samples are those of the image. The
kernel of the samples itself writes the values as rows of tables, in any order, so the number of kernels does not depend
on the numbers of rays and lamps.

The rays of one sample are nodes, which are plain data. Numbers of a light or of a throughput are tuples: the values of
a contribution are those of the film's channels (linear red, green and blue); all others have one value per colour or
wavelength of the variant. Densities are per solid angle.
"""

from __future__ import annotations

from collections import Counter, defaultdict
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, fields
from functools import partial
from typing import Any, TypeAlias

import drjit as dr
import mitsuba as mi
import numpy as np

from ..compat import description, name_of, named_by, shape_number
from ..masks import but_not
from ..optics.nested import all_shapes
from ..transport import lobes
from ..transport.ray import Ray, Vertex
from ..transport.transport import Transport

Numbers: TypeAlias = "tuple[float, ...]"
#: A row of a table, and its values as numbers and tuples of Python.
Row: TypeAlias = "dict[str, Any]"
#: Id of a shape or emitter -> its name, and its line in the scene file.
Places: TypeAlias = "Mapping[str, tuple[str, str]]"
#: The parts of a node's light that are known only as sums.
SUMS = ("ambient", "background", "photons")
#: The light that a ray finds, not the surface where it ends.
FOUND_BY_RAYS = ("emission", "background")
#: The states of a lamp's point, by number; "on its back" and "its cone" are those of the lamp.
STATES = "visible", "hidden", "below the surface", "on its back", "not lit", "outside its cone", "not scattered"
VISIBLE, HIDDEN, BELOW, BACK, UNLIT, OUTSIDE, UNSCATTERED = range(len(STATES))
#: The states of points whose light would be scattered if nothing were in the way.
LIT = STATES[: HIDDEN + 1]
#: Number of rows for which a table first has room.
CAPACITY = 1 << 15
#: A lamp whose direction has a smaller product of cosines counts as below the surface.
GRAZING = 1e-6


@dataclass(frozen=True)
class LobeShare:
    """The share of one group of lobes in the light that a surface scatters from a sampled point of a lamp."""

    name: str
    #: BSDF value times the cosine.
    bsdf: Numbers
    #: Density with which the lobes sample the direction of the point; 0 for lobes whose rays do not look for lamps.
    density: float
    #: MIS weight of the lamp's sample against the rays of the lobes, and against photons.
    weight: float


@dataclass(frozen=True)
class LampSample:
    """A sampled point of a lamp, and the light that a surface scatters from this point."""

    lamp: str
    point: Numbers
    #: "visible", "hidden", or why the point adds no light even if nothing is in the way, see :data:`STATES`.
    state: str
    #: The shape that is in the way, if there is one.
    occluder: str | None
    #: Density of the point, with the probability of the choice of the lamp; 1 for a lamp without extent.
    density: float
    #: Radiance of the point, divided by ``density``.
    weighted_radiance: Numbers
    lobes: tuple[LobeShare, ...]
    #: The light that the point adds to the sample of the pixel.
    contribution: Numbers


@dataclass(frozen=True)
class Emission:
    """The light of a lamp that a ray meets."""

    lamp: str
    radiance: Numbers
    #: Density with which light sampling takes the direction of the ray; 0 if it never does.
    density: float
    #: MIS weight of the ray against light sampling, and against photons.
    weight: float
    contribution: Numbers


@dataclass(frozen=True)
class Node:
    """A ray of a tree or path, the surface point that it meets, and the light that it adds to the sample."""

    #: Number of the node; 1 is the camera ray. In a tree, node n reflects node 2 n and refracts node 2 n + 1.
    number: int
    #: Number of the node where the ray begins; 0 is the camera.
    parent: int
    #: Number of reflections and refractions before the ray.
    level: int
    #: The shape that the ray meets, and its line in the scene file where known; None if the ray leaves the scene.
    shape: str | None
    line: str | None
    origin: Numbers
    direction: Numbers
    #: Where the ray meets the shape, and the shading normal on the ray's side; None if the ray leaves the scene.
    position: Numbers | None
    normal: Numbers | None
    #: The lobe through which the ray leaves its parent, such as "glossy reflection"; "camera" for the camera ray.
    lobe: str
    #: Density of the direction; None for the camera ray and for a lobe with a single direction.
    density: float | None
    #: Probability of the choice of a lobe with a single direction among the lobes that share one random number; None
    #: for other lobes.
    probability: float | None
    #: Probability that the ray survives Russian roulette, times the probability of the choice of its lobe in a path.
    survival: float
    #: Factor from the radiance of the ray at its end to the radiance of the camera ray.
    throughput: Numbers
    lamps: tuple[LampSample, ...]
    emission: Emission | None
    #: The light that the ambient term, the background and photons add.
    ambient: Numbers
    background: Numbers
    photons: Numbers
    #: The light that the node adds to the sample: the sum of all contributions above.
    contribution: Numbers


@dataclass
class Table:
    """The values of one computation at all rays of all samples: a row for each ray, a column for each value."""

    event: str
    #: Number of rows.
    count: mi.UInt32
    #: Columns of Dr.Jit; after :meth:`converted`, NumPy arrays, whose last axis is that of the rows. The rows of a
    #: sample follow each other in the order of their computation.
    columns: dict[str, Any]

    def converted(self) -> Table:
        """Returns the table with NumPy arrays as columns."""
        columns = each(lambda value: np.array(value)[..., : int(self.count[0])], self.columns)
        order = np.argsort(columns["sample"], kind="stable")
        return Table(self.event, self.count, each(lambda value: np.nan_to_num(value[..., order]), columns))

    def rows(self, sample: int) -> Iterator[Row]:
        """Yields the rows of a sample, with tuples and numbers of Python."""
        for i in range(*np.searchsorted(self.columns["sample"], [sample, sample + 1]).tolist()):
            yield each(partial(as_numbers, i), self.columns)


class Recorder:
    """Records the computations of ``transport`` for a pixel's samples; ``places``: lines of shapes and emitters."""

    def __init__(self, transport: Transport, places: Places) -> None:
        self.transport, self.lines = transport, dict(places.values())
        #: The tables of all samples, and those of the samples that are being taken.
        self.tables, self.new = list[Table](), list[Table]()
        #: Indices of the samples that are taken, and whether they are recorded; the function that converts the radiance
        #: along their camera rays to the values of the film's channels; maximum number of rows of a table.
        self.t, self.recorded, self.capacity = mi.UInt32(0), mi.Bool(True), CAPACITY
        self.channels: Callable[[mi.Spectrum], Sequence[mi.Float]] = list
        words = {key: name for key, (name, _) in places.items()}
        #: Number of a shape in Dr.Jit -> its name; and the names of the lamps, in the order of their numbers.
        self.shapes = shape_names(transport.scene, words)
        lamps = transport.lights.emitters
        self.lamps = [lamp_name(lamp, k, self.shapes, words) for k, lamp in enumerate(lamps)]
        #: Number of a shape in Dr.Jit -> the flags of its material.
        things = [(shape, shape.bsdf()) for shape in all_shapes(transport.scene)]
        self.flags = {shape_number(mi.ShapePtr(shape)): int(bsdf.flags()) for shape, bsdf in things if bsdf}
        #: Number of a lamp -> the state of points that the lamp does not light.
        self.unlit = mi.UInt32([OUTSIDE if "angle = " in description(lamp) else UNLIT for lamp in lamps])

    def record(self, take: Callable[[], Any]) -> Any:
        """Returns ``take()``, which takes samples, and adds their tables."""
        self.transport.observer = self
        try:
            while True:
                self.new = list[Table]()
                taken = take()
                dr.eval(taken, [(table.count, table.columns) for table in self.new])
                most = max(int(table.count[0]) for table in self.new)
                if most <= self.capacity:
                    break
                self.capacity = most
        finally:
            self.transport.observer = None
        self.tables += [table.converted() for table in self.new if int(table.count[0])]
        return taken

    def __call__(self, event: str, ray: Ray, active: mi.Bool | bool = True, **values: Any) -> None:
        """Adds a table with the values of one computation, see :meth:`.Context.observe`."""
        if event == "lamp":
            active, values = values["vertex"].smooth, self._lamp_values(**values)
        if "value" in values:
            values["contribution"] = (*self.channels(ray.throughput * values.pop("value")),)
        if event == "scatter":
            after, bs = values.pop("after"), values.pop("bs")
            values |= {"direction": after.d, "throughput": after.throughput, "pdf": bs.pdf, "type": bs.sampled_type}
        if event == "ray":
            si, values["throughput"] = values.pop("si"), values.pop("attenuated")
            normal = si.sh_frame.n * dr.select(si.wi.z < 0, mi.Float(-1), 1)
            values |= {"origin": ray.o, "direction": ray.d, "position": si.p, "normal": normal, "valid": si.is_valid()}
            values |= {"arriving": ray.throughput, "shape": number_of(si.shape)}
        values |= {"number": ray.node, "level": ray.level, "sample": self.t}
        table = Table(event, dr.opaque(mi.UInt32, 0), each(lambda v: dr.empty(type(v), self.capacity), values))
        active = dr.full(mi.Bool, True, dr.width(self.t)) & active & self.recorded
        row = dr.scatter_inc(table.count, dr.zeros(mi.UInt32, dr.width(self.t)), active)
        dr.scatter(table.columns, values, row, active & (row < dr.opaque(mi.UInt32, self.capacity)))
        self.new.append(table)

    def _lamp_values(
        self, vertex: Vertex, sample: Any, terms: Any, f: mi.Spectrum, visible: mi.Bool, lamp: Any, value: Any
    ) -> dict[str, Any]:
        """Returns the values of a lamp's sample, and traces which shape is in its way."""
        (ds, weight), si, lamp = sample, vertex.si, mi.UInt32(lamp)
        sent = (ds.pdf > 0) & (dr.max(dr.abs(weight)) > 0)
        scattered = sent & (dr.max(dr.abs(f * weight)) > 0)
        cosines = mi.Frame3f.cos_theta(si.wi) * mi.Frame3f.cos_theta(si.to_local(ds.d))
        below = but_not(cosines < GRAZING, mi.Bool(vertex.receiver.both_sides))
        unlit = dr.gather(mi.UInt32, self.unlit, lamp, vertex.smooth)
        state = dr.select(sent, mi.UInt32(UNSCATTERED), dr.select(dr.dot(ds.n, ds.d) > 0, BACK, unlit))
        state = dr.select(scattered, dr.select(visible, mi.UInt32(VISIBLE), HIDDEN), dr.select(below, BELOW, state))
        hidden = but_not(vertex.smooth & self.recorded & (ds.pdf > 0), visible)
        shadow_ray = si.spawn_ray_to(ds.p)
        blocker = self.transport.scene.ray_intersect(shadow_ray, mi.RayFlags.Minimal, coherent=False, active=hidden)
        shares = {
            lobe.type_mask: [bsdf, pdf, dr.select(vertex.inseparable & (number > 0), mi.Float(0), part)]
            for number, (lobe, bsdf, pdf, part) in enumerate(terms)
            if lobe is not None
        }
        values = {"lamp": lamp, "point": ds.p, "density": ds.pdf, "weighted_radiance": weight, "value": value}
        return values | {"state": state, "occluder": number_of(blocker.shape), "lobes": shares}

    def shape(self, number: Any) -> str:
        """Returns the name of the shape with this number in Dr.Jit."""
        return self.shapes.get(int(number), "a shape without a name")

    # ---------------------------------------------------------------- sums over samples

    def sums(self, event: str, keys: Sequence[str], weights: np.ndarray | None = None) -> Counter[tuple[int, ...]]:
        """Groups all rows of an event by their values in the columns ``keys``; returns values -> number of rows, or,
        with ``weights`` of the samples, values -> sum of the contributions times the weights.

        The column "shape" is the number of the shape at which the ray ends, or, if the ray itself finds the light (as
        in emission and background), of the shape at which the ray begins; 0 without a shape.
        """
        found = Counter[tuple[int, ...]]()
        for rows in (table.columns for table in self.tables if table.event == event):
            number = self._parent(rows["number"]) if event in FOUND_BY_RAYS else rows["number"]
            columns = rows | {"shape": self._shape_at(rows["sample"], number)}
            wanted = np.stack([columns[key].astype(np.int64) for key in keys], axis=1)
            groups, where = np.unique(wanted, axis=0, return_inverse=True)
            amounts = None if weights is None else sum(map(np.float64, rows["contribution"])) * weights[rows["sample"]]
            found.update(dict(zip(map(tuple, groups.tolist()), np.bincount(where, amounts).tolist())))
        return found

    def _parent(self, number: Any) -> Any:
        return number // 2 if self.transport.settings.follows_tree else number - 1

    def _shape_at(self, sample: np.ndarray, number: np.ndarray) -> np.ndarray:
        """Returns the numbers of the shapes where rays end; 0 where a ray does not exist."""
        rays = [table.columns for table in self.tables if table.event == "ray"]
        key, shape = (
            np.concatenate(parts) for parts in zip(*((ray_key(r["sample"], r["number"]), r["shape"]) for r in rays))
        )
        order, wanted = np.argsort(key), ray_key(sample, number)
        at = order[np.minimum(np.searchsorted(key, wanted, sorter=order), len(key) - 1)]
        return np.where(key[at] == wanted, shape[at], 0)

    # ---------------------------------------------------------------- the nodes of a sample

    def nodes(self, sample: int) -> tuple[Node, ...]:
        """Returns the nodes of a sample, in the order in which the rays were followed."""
        rows = defaultdict[tuple[str, int], list[Row]](list)
        for table in self.tables:
            for row in table.rows(sample):
                rows[table.event, row["number"]].append(row)
        black = (0.0,) * len(self.channels(mi.Spectrum(0)))
        return tuple(self._node(ray, rows, black) for (kind, _), rays in rows.items() if kind == "ray" for ray in rays)

    def _node(self, ray: Row, rows: Mapping[tuple[str, int], list[Row]], black: Numbers) -> Node:
        def found(event: str, number: int = ray["number"]) -> list[Row]:
            return rows.get((event, number), [])

        parent, shape = int(self._parent(ray["number"])), self.shape(ray["shape"]) if ray["valid"] else None
        sums = {name: next((row["contribution"] for row in found(name)), black) for name in SUMS}
        lamps = tuple(map(self._lamp, found("lamp")))
        emission = next((self._emission(row) for row in found("emission") if any(row["radiance"])), None)
        parts = [*sums.values(), *(one.contribution for one in (*lamps, emission) if one)]
        names = {"parent": parent, "shape": shape, "line": self.lines.get(shape or "")}
        light = {"lamps": lamps, "emission": emission, "contribution": tuple(map(sum, zip(black, *parts)))}
        missing = {} if shape else {"position": None, "normal": None}
        return made(Node, ray | missing | names | self._chosen(ray, found("scatter", parent)) | sums | light)

    @staticmethod
    def _chosen(ray: Row, left: Sequence[Row]) -> Row:
        """Returns the fields ``lobe``, ``density``, ``probability`` and ``survival`` of a node.

        ``left`` are the rays that were sampled at the parent: the reflected and the refracted one of a tree, of which
        both may be followed, or the specular and the diffuse one of a path, of which one is followed.
        """
        if not left:
            return {"lobe": "camera", "density": None, "probability": None, "survival": 1.0}
        one = min(left, key=lambda row: float(np.abs(np.subtract(row["direction"], ray["direction"])).sum()))
        ideal = bool(lobes.has_any(one["type"], *lobes.IDEAL))
        sampled, followed = max(one["throughput"]), max(ray["arriving"])
        chosen = {"density": None if ideal else one["pdf"], "probability": one["pdf"] if ideal else None}
        return {"lobe": lobe_names(one["type"]), "survival": sampled / followed if followed > 0 else 1.0, **chosen}

    def _lamp(self, row: Row) -> LampSample:
        shares = tuple(LobeShare(lobe_names(mask), *share) for mask, share in row["lobes"].items())
        occluder = self.shape(row["occluder"]) if row["occluder"] else None
        names = {"lamp": self.lamps[row["lamp"]], "state": STATES[row["state"]]}
        return made(LampSample, row | names | {"occluder": occluder, "lobes": shares})

    def _emission(self, row: Row) -> Emission:
        return made(Emission, row | {"lamp": self.lamps[min(row["lamp"], len(self.lamps) - 1)]})


def made(kind: type[Any], values: Row) -> Any:
    """Returns an object of the data class ``kind``, whose fields have the ``values`` of the same names."""
    return kind(**{field.name: values[field.name] for field in fields(kind)})


def as_numbers(i: int, column: np.ndarray) -> Any:
    """Returns row ``i`` of a column as a number or a tuple of numbers of Python."""
    return tuple(column[..., i].tolist()) if column.ndim > 1 else column[i].item()


def each(function: Callable[[Any], Any], value: Any) -> Any:
    """Applies a function to the arrays in dictionaries, lists and tuples."""
    if isinstance(value, dict):
        return {name: each(function, one) for name, one in value.items()}
    return type(value)(each(function, one) for one in value) if isinstance(value, list | tuple) else function(value)


def number_of(shape: mi.ShapePtr) -> mi.UInt32:
    """Returns registry indices of shapes in Dr.Jit."""
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
    """Returns the names of all shapes (:func:`title`), also of those within instances: number in Dr.Jit -> name."""
    return {shape_number(mi.ShapePtr(s)): title(s, number, words) for number, s in enumerate(all_shapes(scene))}


def title(thing: mi.Object, number: int | str, words: Mapping[str, str]) -> str:
    """Returns the name of a shape or emitter: from ``words``, or by :func:`.name_of` with its material from
    ``words``.
    """
    name, material = name_of(thing, number), words.get(thing.bsdf().id()) if isinstance(thing, mi.Shape) else None
    return words.get(name, name) if name == thing.id() or not material else f"{name} of {material}"


def lamp_name(emitter: mi.Emitter, number: int, shapes: Mapping[int, str], words: Mapping[str, str]) -> str:
    """Returns the name of the emitter's shape, or of the emitter (:func:`.named_by`)."""
    thing = named_by(emitter)
    return shapes[shape_number(mi.ShapePtr(thing))] if isinstance(thing, mi.Shape) else title(thing, number, words)
