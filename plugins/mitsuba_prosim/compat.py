"""Code that relies on undocumented properties of Mitsuba and Dr.Jit.

The comment above a function or constant describes the property on which the code relies, and names the version and, if
there is one, the upstream issue. Other workarounds are in the modules ``alone`` (one thread at a time), ``registry``
(variants), ``llvm``, ``light.emitter_methods`` and ``transport.workarounds`` (BSDFs that ignore the type mask), and in
the package ``stock_command``.
"""

from __future__ import annotations

import ctypes
import platform
import re
import signal
import sys
import threading
from collections import Counter
from collections.abc import Collection, Iterable, Iterator, MutableMapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any, cast

import drjit as dr
import mitsuba as mi

if TYPE_CHECKING:
    import numpy as np

# ---------------------------------------------------------------- transforms
# Up to Mitsuba 3.9 the transform of a sensor or a shape is an AffineTransform4f. From 3.10 on the transform is an
# AnimatedTransform4f, which has `eval(time)`, but no `matrix`, `@` or `translation()`. The parameter of the transform
# is called `to_world.transform` (https://github.com/mitsuba-renderer/mitsuba3/pull/1869).

#: Names of the parameter with the transform, newest first.
TO_WORLD = ("to_world.transform", "to_world")


def world_transform(sensor: mi.Sensor, time: float | mi.Float = 0.0) -> mi.AffineTransform4f:
    """Returns the transform of ``sensor`` from camera space to world space at ``time``."""
    return _at(sensor.world_transform(), time)


def world_matrix(sensor: mi.Sensor) -> np.ndarray:
    """Returns the matrix of :func:`world_transform` at time 0: shape (4, 4), double precision."""
    import numpy as np  # slow to import, and not needed before the first image

    return np.array(world_transform(sensor).matrix, dtype=float).reshape(4, 4)


def object_transform(thing: mi.Shape | mi.ShapePtr | mi.Emitter) -> mi.AffineTransform4f:
    """Returns the transform, with derivatives, from object to world space. Raises KeyError for a mesh."""
    parameters = mi.traverse(thing)
    return _at(parameters[to_world_name(parameters)], 0.0)


def to_world_name(parameters: MutableMapping[str, Any], prefix: str = "") -> str:
    """Returns ``prefix``, such as "lamp.", followed by the first of the names :data:`TO_WORLD` that the
    ``parameters`` of ``mi.traverse`` contain; by the last name if they contain none.
    """
    return next((prefix + name for name in TO_WORLD if prefix + name in parameters), prefix + TO_WORLD[-1])


def set_world_transform(sensor: mi.Sensor, parameters: MutableMapping[str, Any], matrix: np.ndarray) -> None:
    """Sets the transform of ``sensor``, whose ``parameters`` of ``mi.traverse`` the caller then updates.

    A sensor in Python that does not expose its transform gets the attribute ``m_to_world``.
    """
    name = to_world_name(parameters)
    if name in parameters:
        parameters[name] = mi.AffineTransform4f(matrix)
    else:
        own: Any = sensor
        own.m_to_world = mi.ScalarAffineTransform4f(matrix)
        dr.make_opaque(own.m_to_world)


def _at(transform: Any, time: float | mi.Float) -> mi.AffineTransform4f:
    return transform.eval(time) if hasattr(transform, "eval") else transform


# ---------------------------------------------------------------- boxes
# Scalar variants have no name `ScalarBoundingBox3f` (3.9): there it is `BoundingBox3f`.


def box_of_point(p: mi.ScalarPoint3f) -> mi.ScalarBoundingBox3f:
    """Returns the bounding box that contains only the point ``p``."""
    return getattr(mi, "ScalarBoundingBox3f", mi.BoundingBox3f)(p)


# ---------------------------------------------------------------- meshes
# Up to 3.9 the vertices of a mesh are the flat parameter `vertex_positions`, from 3.10 on the tensor `positions`
# (release notes of 3.10, "Redesigned mesh representation").


def mesh_positions(shape: mi.Shape) -> np.ndarray | None:
    """Returns the vertices in world coordinates, shape (n, 3), double precision; None if ``shape`` is no mesh."""
    import numpy as np

    parameters = exposed(shape)
    name = next((name for name in ("positions", "vertex_positions") if name in parameters), None)
    return None if name is None else np.array(parameters[name], dtype=np.float64).reshape(-1, 3)


# ---------------------------------------------------------------- the order of meshes
# Mitsuba merges the meshes of a scene that share a BSDF (shape "merge"). The merged meshes are in the order of a hash
# of addresses, which differs between processes (3.9 and 3.10, src/shapes/merge.cpp). All other objects are in the order
# of the scene's description.

#: Places of meshes are rounded to the size of the scene divided by this number, because machines round transforms
#: differently.
STEPS = 4096


def shapes_in_order(scene: mi.Scene) -> list[mi.Shape]:
    """Returns the shapes of ``scene`` in an order that is the same in every process: meshes are last."""
    return _meshes_in_order([(shape, shape) for shape in scene.shapes()])


def emitters_in_order(scene: mi.Scene) -> list[mi.Emitter]:
    """Returns the emitters of ``scene`` in an order that is the same in every process: those on meshes are last. Those
    that Mitsuba never samples, because their ``sampling_weight`` is 0, are left out if no ray meets them, and those of
    users, whose methods may differ from what a ray meets.
    """
    delta = mi.EmitterFlags.Delta
    emitters = [
        e for e in scene.emitters() if e.sampling_weight() > 0 or not (mi.has_flag(e.flags(), delta) or is_users(e))
    ]
    return _meshes_in_order([(emitter, emitter.get_shape()) for emitter in emitters])


def emitter_pointers(scene: mi.Scene, emitters: Sequence[mi.Emitter]) -> mi.EmitterPtr:
    """Returns pointers to the ``emitters`` of ``scene``, as one Dr.Jit array in the order of ``emitters``."""
    numbers = {emitter: i for i, emitter in enumerate(scene.emitters())}
    return dr.gather(mi.EmitterPtr, scene.emitters_dr(), mi.UInt32([numbers[emitter] for emitter in emitters]))


def _meshes_in_order(things: Sequence[tuple[Any, mi.Shape | None]]) -> list[Any]:
    """Returns the objects of the pairs ``things`` of an object and its shape: first those that are not on meshes, in
    their order, then the others, sorted by the ids, the rounded bounding boxes, the numbers of triangles and, where all
    these are equal, the contents of the meshes.
    """
    import numpy as np

    result = [thing for thing, shape in things if shape is None or not shape.is_mesh()]
    meshes = [(thing, shape) for thing, shape in things if shape is not None and shape.is_mesh()]
    if len(meshes) < 2:
        return result + [thing for thing, _ in meshes]
    boxes = np.array([[*shape.bbox().min, *shape.bbox().max] for _, shape in meshes], dtype=float)
    low, high = boxes[:, :3].min(axis=0), boxes[:, 3:].max(axis=0)
    places = np.rint((boxes - np.tile(low, 2)) * (STEPS / max(float((high - low).max()), 1e-30))).tolist()
    keys = [(s.id(), *place, s.primitive_count()) for (_, s), place in zip(meshes, places)]
    times = Counter(keys)
    contents = [_content(shape) if times[key] > 1 else [] for (_, shape), key in zip(meshes, keys)]
    order = sorted(range(len(meshes)), key=lambda i: (keys[i], contents[i]))
    return result + [meshes[i][0] for i in order]


def _content(shape: mi.Shape) -> list[tuple[str, bytes]]:
    import numpy as np

    values = {name: np.array(getattr(value, "matrix", value)) for name, value in exposed(shape)}
    return sorted((name, value.tobytes()) for name, value in values.items() if value.dtype != object)


# ---------------------------------------------------------------- loading
# Mitsuba 3.9 makes the objects of a scene in parallel. If a scene has plugins in Python, this
# sometimes fails with a meaningless string or allocation, most often in the first scene of a process.
#
# Mitsuba's integrators choose an emitter by the number of the emitter, and merging gives meshes another order in every
# process, as above. So shapes that emit are not merged.


def instantiate(config: mi.parser.ParserConfig, state: mi.parser.ParserState, in_python: Collection[str]) -> mi.Scene:
    """Creates the scene of the parser state ``state``, which cannot be used again.

    Meshes that share a BSDF are merged, unless they emit light. A scene with a plugin ``in_python`` is not created in
    parallel.
    """
    config.parallel = not any(node.props.plugin_name() in in_python for node in state.nodes)
    config.merge_meshes = False
    mi.parser.transform_all(config, state)
    if state.root.type == mi.ObjectType.Scene:
        root, emitters = state.root.props, []
        # Takes emitters, and shapes with an emitter, out of the scene, merges the other meshes, and puts them back.
        for name, child in children(root):
            node = state.nodes[child.index()]
            if mi.ObjectType.Emitter in (node.type, *(state.nodes[c.index()].type for _, c in children(node.props))):
                emitters.append(child)
                del root[name]
        mi.parser.transform_merge_meshes(config, state)
        for number, emitter in enumerate(emitters):
            state.root.props[f"emitter_{number}"] = emitter
    return cast(mi.Scene, mi.parser.instantiate(config, state))


def children(props: mi.Properties) -> list[tuple[str, Any]]:
    """Returns ``(name, reference)`` for each child object among the properties ``props`` of a parsed object."""
    items = mi.Properties(props).items()  # of a copy: a property that has been read does not count as unknown any more
    return [(name, value) for name, value in items if isinstance(value, mi.Properties.ResolvedReference)]


# ---------------------------------------------------------------- pointers
# A ShapePtr has no way back to the object in Python. The bits of a ShapePtr are the number of the shape in Dr.Jit's
# registry (1.5).


def shape_number(pointer: mi.ShapePtr) -> int:
    """Returns the number by which Dr.Jit's registry identifies the shape that ``pointer`` points to."""
    return int(dr.reinterpret_array(mi.UInt32, pointer)[0])


# ---------------------------------------------------------------- class names
# Only class names distinguish these kinds of objects in Mitsuba 3.9. A test compares the names with the classes.

#: Class names of shapes, sensors and emitters.
INSTANCE, GROUP, SPHERE, CYLINDER, RECTANGLE = "Instance", "ShapeGroupPlugin", "Sphere", "Cylinder", "Rectangle"
PERSPECTIVE, FLAT_SENSOR = "PerspectiveCamera", "FlatSensor"
CONSTANT, AREA = "ConstantBackgroundEmitter", "AreaLight"

#: Class names of a texture that only rays can evaluate, and of the shapes whose points each have their own texture
#: coordinates in the unit square, by which Mitsuba finds them: not on a cylinder that is turned (3.9).
MESH_ATTRIBUTE, UNIQUE_UV = "MeshAttribute", ("Disk", RECTANGLE, SPHERE)

#: Class names of the emitter that may sample only its bright parts (``mis_compensation``), and of the sky with a sun.
ENVMAP, SUNSKY = "EnvironmentMapEmitter", "SunskyEmitter"

#: Class names of the integrator that computes further channels, and of the path tracer.
AOV, PATH = "AOVIntegrator", "PathIntegrator"

#: Class names of BSDFs that contain other BSDFs; of these, the last two change the normal by a texture.
MASK, BLEND, TWO_SIDED, MAPS = "MaskBSDF", "BlendBSDF", "TwoSidedBRDF", ("BumpMap", "NormalMap")

#: Class names of BSDFs some of whose derivatives are wrong: ``roughplastic``, ``principled``, and those that choose an
#: ideal lobe.
ROUGH_PLASTIC, PRINCIPLED, CHOOSERS = "RoughPlastic", "Principled", ("SmoothPlastic", "ThinDielectric")

#: Class names of BSDFs that name their components, but evaluate all of them together.
EVALUATED_TOGETHER = PRINCIPLED, "PrincipledThin"


def is_users(thing: mi.Object) -> bool:
    """Tells whether the class of ``thing`` is a user's: not of Mitsuba, nor derived from a plugin of this package."""
    packages = [base.__module__.partition(".")[0] for base in type(thing).__mro__]
    return packages[0] != "mitsuba" and __package__ not in packages


def exposed(thing: mi.Object) -> Any:
    """Returns ``mi.traverse(thing)``; nothing if the method ``traverse`` of a user's plugin in ``thing`` raises an
    error, such as by ``put_parameter``, which Mitsuba 3.9 lacks. Mitsuba's integrators never call it.
    """
    try:
        return mi.traverse(thing)
    except Exception:  # noqa: BLE001 (a user's method may raise anything)
        return mi.SceneParameters()


def description(thing: Any) -> str:
    """Returns ``str(thing)``; the name of the class alone if it is a user's in Python without ``to_string``, or
    contains such an object. Then ``str`` is an error in Mitsuba 3.9, which also calls ``moment`` a scene.
    """
    try:
        return re.sub(r"^Scene\b", "MomentIntegrator", str(thing)) if isinstance(thing, mi.Integrator) else str(thing)
    except RuntimeError:
        return f"{type(thing).__name__ if is_users(thing) else thing.class_name()}[]"


def name_of(thing: mi.Object, number: int | str = "") -> str:
    """Returns the id of ``thing``; without one, as in many XML files, its file, or its class and ``number``. Meshes
    that Mitsuba has merged have several files; rectangles among them have none.
    """
    if thing.id() and not thing.id().startswith("__"):
        return str(thing.id())
    named = re.findall(r"^\w+\[\n  name = \"(.*\w.*)\"", description(thing))
    (read,) = named or [f"{thing.class_name()} {number}".strip()]
    parts = read.split(" + ")
    return next(filter(str.strip, parts)) + ", ..." * (len(parts) > 1)


def names_of(things: Iterable[mi.Object]) -> str:
    """Returns the names of ``things`` for a message: at most eight, in quotes; of :func:`named_by` for an emitter."""
    names = [*dict.fromkeys(repr(name_of(named_by(one) if isinstance(one, mi.Emitter) else one)) for one in things)]
    return ", ".join([*names[:8], *(["..."] if names[8:] else [])])


def warn(text: str) -> None:
    """Logs the warning ``text``."""
    mi.Log(mi.LogLevel.Warn, f"prosim: {text}")


def warn_of(things: Iterable[mi.Object], text: str) -> None:
    """Logs the warning ``text``, in which {} stands for the names of ``things``, if there are any."""
    if names := names_of(things):
        warn(text.format(names))


def named_by(emitter: mi.Emitter) -> mi.Object:
    """Returns what names ``emitter``: its shape, or itself if it has none, or alone has an id."""
    shape = emitter.get_shape()
    return emitter if shape is None or (emitter.id() and not shape.id()) else shape


def emitter_samples(integrator: mi.Integrator) -> int:
    """Returns the number of emitter samples of Mitsuba's ``direct``, which does not expose it; 1 for all others."""
    found = re.match(r"DirectIntegrator\[\s*emitter_samples = (\d+)", description(integrator))
    return int(found[1]) if found else 1


# ---------------------------------------------------------------- emitters
# A virtual function call is compiled for all emitters that exist. An emitter without the method `eval_direction`, as
# Mitsuba's "directionalarea" (3.9) and many of users, raises an error, which would end the call for all others too.


def eval_direction(
    emitter: mi.Emitter | mi.EmitterPtr, it: mi.Interaction3f, ds: mi.DirectionSample3f, active: mi.Bool
) -> mi.Spectrum:
    """Returns ``emitter.eval_direction(it, ds, active)``; if the emitter lacks this method, the value of ``eval``, 0
    for points and single directions.
    """

    def value(one: mi.Emitter, it: mi.Interaction3f, ds: mi.DirectionSample3f, active: mi.Bool) -> mi.Spectrum:
        try:
            return mi.Spectrum(one.eval_direction(it, ds, active))
        except Exception:  # noqa: BLE001 (that of a user may raise any error, as Mitsuba's path never calls it)
            if mi.has_flag(one.flags(), mi.EmitterFlags.Delta):
                return mi.Spectrum(0)
        si = mi.SurfaceInteraction3f(ds, it.wavelengths)
        si.wi = -ds.d if mi.has_flag(one.flags(), mi.EmitterFlags.Infinite) else si.to_local(-ds.d)
        return mi.Spectrum(one.eval(si, active))

    if not dr.is_jit_v(mi.Float) or isinstance(emitter, mi.Emitter):
        return value(emitter, it, ds, active)
    return dr.dispatch(emitter, value, it, ds, active)


# ---------------------------------------------------------------- threads

#: Minimum number of threads: with fewer threads Mitsuba 3.9 waits forever when it reads or writes an EXR.
EXR_THREADS = 3


# ---------------------------------------------------------------- files
# Mitsuba has no list of the files that it searches in its search path.

#: Suffixes of a plugin's file on Linux, macOS and Windows.
LIBRARIES = (".so", ".dylib", ".dll")

#: Names of arguments of Mitsuba's Python parser: parameters of a scene with these names cannot be set.
RESERVED = ("config", "filename")

#: The files of a conductor's ``material`` in Mitsuba's search path; {} is the name of the material.
MATERIAL_FILES = ("data/ior/{}.eta.spd", "data/ior/{}.k.spd")


def native_plugins() -> set[str]:
    """Returns the names of Mitsuba's plugins that are not written in Python."""
    return {path.stem for path in Path(mi.__file__).parent.glob("plugins/*") if path.suffix in LIBRARIES}


#: The plugins of Mitsuba 3.9 that end the process without a message unless they have one of these parameters.
REQUIRED = {"bitmap": ("filename", "bitmap", "data"), "blendbsdf": ("weight",)}


# ---------------------------------------------------------------- the words of errors
# An error has no attributes, only a text (as of 3.9).

#: Python traceback within a message of Mitsuba, and a source line of Mitsuba.
TRACEBACK = re.compile(r"Traceback \(most recent call last\):\n(?: .*\n)+(?:\w+: )?")
SOURCE_LINE = re.compile(r"\[\w+\.(?:cpp|h):\d+\] ")

#: File, line and column of a place: `While loading FILE (line 3, col 6)`, `At FILE (...)`, or `Parsing of XML file
#: "FILE" failed: ... (...)`.
PLACE = re.compile(r'(?:[Ll]oading|XML file|At) "?([^"\n]+?)"?(?: failed: [^\n]*?)? \(line (\d+), col (\d+)\)')

#: A plugin does not have some parameters: name of the plugin, and a line or more for each parameter.
NO_PARAMETER = re.compile(
    r'(?:While loading dictionary node "root": )?Found \d+ unreferenced \w+ in \w+ plugin of type "([^"\n]+)":'
    r'((?:\s+- \w+ "[^"\n]+": [^\n]*(?:\n(?!\s*- \w+ ")[ \]][^\n]*)*)+)'
)

#: A plugin is missing: its tag in XML, and its name.
NOT_FOUND = re.compile(r'failed to instantiate (\w+) plugin of type "([^"\n]+)": [^\n]*Plugin "[^"\n]*" not found!')

#: Tag in XML -> name of the kind of plugin, where both differ.
TAGS = {"rfilter": "reconstructionfilter", "phase": "phasefunction"}


# ---------------------------------------------------------------- arrays
# Dr.Jit 1.5 derives the alignment of a NumPy array from its address, and makes the alignment part of a kernel: so the
# same code is compiled again for another address. Dr.Jit's own arrays begin at multiples of 64 bytes.
ALIGNED = 64


def dr_array(values: np.ndarray) -> Any:
    """Returns ``values`` as a flat Dr.Jit array, row by row: a ``mi.UInt32``, a ``mi.Int32``, a ``mi.Float`` for 32
    bits, or of the type :func:`double` for floats of 64 bits.
    """
    import numpy as np

    values = np.asarray(values)
    room = np.empty(values.nbytes + ALIGNED, dtype=np.uint8)
    begin = -room.ctypes.data % ALIGNED
    own = room[begin : begin + values.nbytes].view(values.dtype)
    own[:] = values.ravel()
    kinds = {np.dtype(np.uint32): mi.UInt32, np.dtype(np.int32): mi.Int32, np.dtype(np.float64): double()}
    return kinds.get(values.dtype, mi.Float)(own)


# Apple's GPUs have no floats of 64 bits (Dr.Jit 1.5).


def double() -> Any:
    """Returns the type of Dr.Jit arrays of 64-bit floats: ``mi.Float64``, but ``mi.Float`` (32 bits) with Metal."""
    return mi.Float if dr.backend_v(mi.Float) == dr.JitBackend.Metal else mi.Float64


# ---------------------------------------------------------------- denormal numbers
# Dr.Jit's threads round denormal numbers to zero on x86, except with Microsoft's compiler (nanothread, `FTZGuard`). But
# the thread that launches a small kernel runs it itself, as it does with one thread, and keeps denormal numbers.

#: Bits 15 and 6 of the register MXCSR: denormal results and operands are zero.
DENORMALS_ARE_ZERO = 0x8040

#: Index of MXCSR in the type ``fenv_t`` of the C library, seen as 32-bit numbers.
MXCSR = {"linux": 7, "darwin": 1}.get(sys.platform, 0) if platform.machine() == "x86_64" and sys.maxsize >> 32 else 0


@contextmanager
def denormals_rounded() -> Iterator[None]:
    """Rounds denormal numbers to zero in this thread, as Dr.Jit's own threads do, so that all have the same bits."""
    if not MXCSR:
        yield
        return
    library, before = ctypes.CDLL(None), (ctypes.c_uint32 * 8)()
    library.fegetenv(before)
    inside = type(before)(*before)
    inside[MXCSR] |= DENORMALS_ARE_ZERO
    library.fesetenv(inside)
    try:
        yield
    finally:
        library.fesetenv(before)


# ---------------------------------------------------------------- turned shapes
# If a sphere is rotated or mirrored, Mitsuba 3.9 samples points with normals of the sphere before that, and from 90
# degrees on `eval_parameterization` finds other points. Normals of sampled points of a mirrored cylinder, and those by
# `eval_parameterization` of a rectangle with `flip_normals`, are on the wrong side.


def outer_normal(shape: mi.Shape, p: mi.Point3f, n: mi.Normal3f) -> mi.Normal3f:
    """Returns the normal that a ray meets at the sampled point ``p`` of ``shape``, whose sampled normal is ``n``."""
    import numpy as np

    if shape.class_name() == CYLINDER:
        return mi.Normal3f(dr.mulsign(n, dr.det(mi.Matrix3f(object_transform(shape).matrix))))
    if shape.class_name() != SPHERE:
        return n
    if not dr.flag(dr.JitFlag.FreezingScope):  # while dr.freeze records a function, no transform can be read
        m = linear_part(shape)
        if np.allclose(m, abs(m[0, 0]) * np.eye(3), rtol=0, atol=1e-6 * np.abs(m).max()):
            return n
    out = dr.normalize(p - object_transform(shape) @ mi.Point3f(0))
    return mi.Normal3f(-out if shape.has_flipped_normals() else out)


def is_mirrored_cylinder(shape: mi.Shape) -> bool:
    """Tells whether ``shape`` is a cylinder whose transform mirrors it."""
    import numpy as np

    return shape.class_name() == CYLINDER and bool(np.linalg.det(linear_part(shape)) < 0)


def has_unique_uv(shape: mi.Shape) -> bool:
    """Tells whether ``shape`` is no mesh, each of its points has its own texture coordinates in the unit square, and
    ``eval_parameterization`` finds this point.
    """
    import numpy as np

    name, m = shape.class_name(), linear_part(shape)
    if name == SPHERE:
        return bool(np.linalg.eigvalsh(m + m.T).min() > 0)  # turned by less than 90 degrees
    return name in UNIQUE_UV and not (name == RECTANGLE and shape.has_flipped_normals())


def linear_part(thing: mi.Object) -> np.ndarray:
    """Returns the transform of a shape or emitter without its translation, shape (3, 3); zeros if it exposes none."""
    import numpy as np

    parameters = exposed(thing)
    if (name := to_world_name(parameters)) not in parameters:
        return np.zeros((3, 3))
    matrix = dr.detach(_at(parameters[name], 0.0).matrix)  # read by elements, as a symbolic loop allows
    return np.array([[dr.slice(matrix[i, j]) for j in range(3)] for i in range(3)], dtype=float)


# ---------------------------------------------------------------- textures


def samples_elsewhere(parameters: mi.SceneParameters, prefix: str = "") -> bool:
    """Tells whether the texture with these ``parameters``, whose names begin with ``prefix``, is a bitmap whose
    transform ``to_uv`` is not the identity. Mitsuba 3.9 samples bright points of a bitmap without this transform.
    """
    if prefix + "data" not in parameters:
        return False
    to_uv = parameters[prefix + "to_uv"].matrix
    return not dr.allclose(to_uv, dr.identity(type(to_uv)))


# ---------------------------------------------------------------- signals


def take_back_interrupts() -> None:
    """Installs Python's handler of SIGINT (Ctrl-C) again, in the main thread, if it was installed from Python.

    Mitsuba 3.9 replaces it during its own method ``render``, but does not restore it after a ``render`` within another
    ``render``. It would then handle Ctrl-C forever, for an integrator that may not exist any more.
    """
    handler = signal.getsignal(signal.SIGINT)
    if handler is not None and threading.current_thread() is threading.main_thread():
        signal.signal(signal.SIGINT, handler)
