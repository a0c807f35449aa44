"""CSG by its definition: rays against the primitives' own equations, in double precision, without any mesh.

A ray is inside of a convex primitive on one interval, of a torus on two. Along the ray the tree is evaluated on both
sides of each end of an interval; the first end where the result begins is what is seen, and the face there belongs to
the primitive that stands first in the tree among those that bound the result there.
"""

import numpy as np
from prosim_scene.model import Leaf, Operator
from scipy.spatial.transform import Rotation

COINCIDENT = 1e-7  # ends of intervals that are nearer to each other are one surface; the scenes are 10 units wide


def placed(transform):
    """The linear part and the offset of a TRANSFORM."""
    result = np.eye(4)
    for kind, values in ((step.kind, step.values) for step in transform.steps):
        m = np.eye(4)
        if kind == "translate":
            m[:3, 3] = values
        elif kind == "matrix":
            m[:3] = np.reshape(values, (3, 4))
        elif kind == "scale":
            m[:3, :3] = np.diag(values)
        else:
            m[:3, :3] = Rotation.from_euler(kind[-1], values[0], degrees=True).as_matrix()
        result = m @ result
    return result[:3, :3], result[:3, 3]


def slab(o, d, low, high):
    """Where low <= o + t d <= high, as (entry, exit)."""
    with np.errstate(divide="ignore", invalid="ignore"):
        a, b = (low - o) / d, (high - o) / d
    flat = d == 0
    within = (o >= low) & (o <= high)
    return (
        np.where(flat, np.where(within, -np.inf, np.inf), np.minimum(a, b)),
        np.where(flat, np.where(within, np.inf, -np.inf), np.maximum(a, b)),
    )


def torus(radius, o, d):
    """The intervals of rays within (sqrt(x^2 + y^2) - 1)^2 + z^2 <= r^2, between the roots of a polynomial."""
    # |p|^2 = a t^2 + 2 b t + c, and (|p|^2 + 1 - r^2)^2 = 4 (x^2 + y^2).
    a, b, c = (d * d).sum(axis=1), (o * d).sum(axis=1), (o * o).sum(axis=1) + 1 - radius**2
    flat = [(d * d)[:, :2].sum(axis=1), (o * d)[:, :2].sum(axis=1), (o * o)[:, :2].sum(axis=1)]
    coefficients = [a * a, 4 * a * b, 4 * b * b + 2 * a * c - 4 * flat[0], 4 * b * c - 8 * flat[1], c * c - 4 * flat[2]]
    companion = np.zeros((len(o), 4, 4))
    companion[:, 1:, :3] = np.eye(3)
    companion[:, :, 3] = -np.stack(coefficients[:0:-1], axis=1) / coefficients[0][:, None]
    meets = b * b > a * ((o * o).sum(axis=1) - (1 + radius) ** 2)  # the ball around the torus
    roots = np.zeros((len(o), 4))
    roots[meets] = np.sort(np.linalg.eigvals(companion[meets]).real, axis=1)
    for near, far in zip(roots.T, roots.T[1:]):
        p = o + d * ((near + far) / 2)[:, None]
        within = (np.hypot(p[:, 0], p[:, 1]) - 1) ** 2 + p[:, 2] ** 2 < radius**2
        yield np.where(within, near, np.inf), np.where(within, far, -np.inf)


def pieces(leaf, o, d):
    """The intervals of rays (n, 3) within a leaf, in its own space."""
    if leaf.shape == "torus":
        return list(torus(leaf.radius or 0.25, o, d))
    if leaf.shape == "cone" and leaf.radius:
        r = leaf.radius  # x^2 + y^2 <= w^2, w = r + (1 - r) z
        return [interval("cone", o * [1, 1, 1 - r] + [0, 0, r], d * [1, 1, 1 - r], r)]
    return [interval(leaf.shape, o, d)]


def interval(shape, o, d, bottom=0.0):
    """Entry and exit of rays (n, 3) in a primitive's own space; entry > exit where they miss it."""
    if shape == "plane":
        return slab(o[:, 2], d[:, 2], -np.inf, 0.0)
    if shape == "cube":
        ends = [slab(o[:, i], d[:, i], 0.0, 1.0) for i in range(3)]
        return np.max([e[0] for e in ends], axis=0), np.min([e[1] for e in ends], axis=0)
    form = np.array({"sphere": (1, 1, 1), "cylinder": (1, 1, 0), "cone": (1, 1, -1)}[shape])
    a, b, c = (d * d) @ form, (o * d) @ form, (o * o) @ form - (shape != "cone")
    root = np.sqrt(np.maximum(b * b - a * c, 0))
    q = -(b + np.where(b < 0, -root, root))  # without cancellation
    with np.errstate(divide="ignore", invalid="ignore"):
        r = np.sort(np.stack([q / a, c / q]), axis=0)
    hit = b * b > a * c
    near, far = np.where(hit, r[0], np.inf), np.where(hit, r[1], -np.inf)
    if shape == "sphere":
        return near, far
    low, high = slab(o[:, 2], d[:, 2], bottom, 1.0)
    if shape == "cylinder":
        return np.maximum(near, low), np.minimum(far, high)
    # Between the roots of a flat ray; of a steep one beyond the root where it enters the nappe z > 0.
    middle = o[:, 2] + d[:, 2] * (r[0] + r[1]) / 2
    steep, up = a < 0, d[:, 2] > 0
    near = np.where(steep, np.where(up, r[1], -np.inf), np.where(middle > 0, near, np.inf))
    far = np.where(steep, np.where(up, np.inf, r[0]), far)
    return np.maximum(near, low), np.minimum(far, high)


def intervals(scene, origins, directions):
    """Entries and exits of rays (n, 3) for each leaf of the tree, a list of pairs, equal where they miss it."""
    ends = []
    for leaf in scene.csg:
        if isinstance(leaf, Leaf):
            linear, offset = placed(scene.transforms[leaf.index])
            inverse = np.linalg.inv(linear)
            own = pieces(leaf, (origins - offset) @ inverse.T, directions @ inverse.T)
            ends.append([(near, np.where(near < far, far, near)) for near, far in own])
    return ends


def surfaces(scene, origins, directions):
    """What rays meet one after the other: distances, whether they enter the result there, and the number of the leaf
    that owns the surface, in the order of the tree; -1 where there is none.
    """
    ends = intervals(scene, origins, directions)
    times = np.sort([t for leaf in ends for pair in leaf for t in pair], axis=0)  # (2 intervals, rays)
    for t in times:
        # The middle of the stretches before and after the ends that coincide with this one.
        earlier = np.where(times < t - COINCIDENT, times, -np.inf).max(axis=0)
        later = np.where(times > t + COINCIDENT, times, np.inf).min(axis=0)
        before = np.where(np.isfinite(earlier), (np.maximum(earlier, -1e9) + t) / 2, t - 1)
        after = np.where(np.isfinite(later), (later + t) / 2, t + 1)
        state = [tuple(np.any([(a < at) & (at < b) for a, b in leaf], 0) for at in (before, after)) for leaf in ends]
        first, second, owner = evaluate(scene.csg, state)
        yield t, ~first & second, np.where(np.isfinite(t) & (t > COINCIDENT), owner, -1)


def first_surfaces(scene, origins, directions):
    """Of each ray its first surface from outside: (number of the leaf that owns it, or -1; distance)."""
    best, found = np.full(len(origins), np.inf), np.full(len(origins), -1)
    for t, enters, owner in surfaces(scene, origins, directions):
        new = (best == np.inf) & enters & (owner >= 0)
        best[new], found[new] = t[new], owner[new]
    return found, best


def evaluate(nodes, state):
    """The tree on both sides of a surface, and the leaf that owns the surface where they differ."""
    stack, number = [], len(state)
    for node in reversed(nodes):
        if isinstance(node, Operator):
            left, right = stack.pop(), stack.pop()
            sides = [{"+": a | b, "-": a & ~b, "*": a & b}[node.symbol] for a, b in zip(left[:2], right[:2])]
            first = (left[0] == sides[0]) & (left[1] == sides[1])
            stack.append((*sides, np.where(sides[0] == sides[1], -1, np.where(first, left[2], right[2]))))
        else:
            number -= 1
            a, b = state[number]
            stack.append((a, b, np.where(a != b, number, -1)))
    return stack.pop()


# ---- Random scenes of the kinds that are hard ------------------------------------------------------------------------

SHAPES = ("CUBE", "SPHERE", "CYLINDER", "CONE")


def tree(rng, count, operators="++--*"):
    """A random tree in prefix order with leaves numbered from 0; -1, -2, -3 are +, -, *."""
    nodes, need, left, leaf = [], 1, count - 1, 0
    while need:
        if left and (need == 1 or rng.random() < 0.5):
            nodes.append(operators[rng.integers(len(operators))])
            need, left = need + 1, left - 1
        else:
            nodes.append(leaf)
            need, leaf = need - 1, leaf + 1
    return nodes


def numbers(values):
    return " ".join(repr(float(v)) for v in values)


def turn(rng):
    """Steps of a random rotation and a small move."""
    return (
        f"ROTATE-X ({rng.uniform(-180, 180)!r}) ROTATE-Y ({rng.uniform(-180, 180)!r}) "
        f"TRANSLATE ({numbers(rng.uniform(-0.5, 0.5, 3))})"
    )


def spin(rng):
    """Steps of a turn about the axis, or none."""
    return f"ROTATE-Z ({rng.uniform(0, 360)!r})" if rng.random() < 0.5 else ""


def sized(size, at, after=""):
    """Steps that make a primitive this large, and move it."""
    return f"SCALE ({numbers(size)}) TRANSLATE ({numbers(at)}) {after}"


def text(rng, shapes, transforms, nodes, size=(120, 90)):
    """A scene of these primitives, each with a look of its own, seen from a random side."""
    eye = rng.normal(size=3)
    eye *= 15 / np.linalg.norm(eye)
    half = rng.uniform(2.5, 4)
    view = (
        f"VIEW RESOLUTION {size[0]} {size[1]} OBS {numbers(eye)} VRP {numbers(rng.uniform(-0.5, 0.5, 3))} "
        f"VUP {numbers(rng.normal(size=3))} WINDOW {-half} {-half * 0.75} {half} {half * 0.75}"
    )
    lines = [
        view,
        "LIGHTS POINT position 0 9 9",
        "CSG-TREE",
        *(n if isinstance(n, str) else f"{shapes[n]} ".replace(" ", f" {n} ", 1) for n in nodes),
    ]
    for i, transform in enumerate(transforms):
        lines += [f"SURFACE {i} material lambertiano kd {(i + 1) / 64}", f"TRANSFORM {i} {transform}"]
    return "\n".join([*lines, "END", ""])


def scattered(rng, weights, sizes, places, after="", operators="++--*"):
    """Primitives of the SHAPES, each as probable as its weight, whose numbers are some of ``sizes`` and ``places``."""
    shapes = [SHAPES[rng.choice(4, p=weights)] for _ in range(rng.integers(2, 6))]
    transforms = [
        f"SCALE ({numbers(rng.choice(sizes, 3) * rng.choice([-1, 1], 3))}) {quarters(rng, 2)} "
        f"TRANSLATE ({numbers(rng.choice(places, 3))}) {after}"
        for _ in shapes
    ]
    return text(rng, shapes, transforms, tree(rng, len(shapes), operators))


def quarters(rng, count):
    """Steps of turns by right angles."""
    return " ".join(f"ROTATE-{'XYZ'[rng.integers(3)]} ({90 * rng.integers(-1, 4)})" for _ in range(count))


def grid(rng, after=""):
    return scattered(rng, [0.6, 0.05, 0.25, 0.1], [0.5, 1, 2], np.arange(-3, 4) / 2, after)


def decimals(rng):
    """A grid of decimal fractions: sums that are not exact."""
    places = np.array([-12, -7, -3, 0, 3, 7, 9]) / 10
    return scattered(rng, [0.7, 0, 0.2, 0.1], np.arange(3, 21) / 10, places)


def chains(rng):
    """Blocks of a turned grid, added and taken away in turn."""
    after = turn(rng)
    transforms = [sized(rng.choice([0.5, 1, 2, 3], 3), rng.integers(-4, 3, 3) / 2, after) for _ in range(12)]
    return text(rng, ["CUBE"] * 12, transforms, [*rng.choice(["+", "-"], 11).tolist(), *range(12)])


def crowds(rng):
    """Poles through one place, added and taken away in turn."""
    sizes = rng.uniform([0.2, 0.2, 2], [1, 1, 8], (12, 3))
    transforms = [f"TRANSLATE (0 0 -.5) SCALE ({numbers(size)}) {turn(rng)}" for size in sizes]
    return text(rng, ["CYLINDER"] * 12, transforms, [*"-+-+-+-+-+-", *range(12)])


def unions(rng):
    """Unions of solids that overlap and are all curved or nearly so, with some coincident discs."""
    return scattered(rng, [0.05, 0.2, 0.35, 0.4], [2, 2, 3], np.arange(-2, 2), turn(rng), "+")


def same_quadric(rng):
    """Poles, balls or rings that lie on one another's surface, in a common placement, and something that cuts them."""
    shape, count = ["CYLINDER", "SPHERE", f"TORUS radius {rng.choice([0.2, 0.5])}"][rng.integers(3)], rng.integers(2, 5)
    after = f"SCALE ({numbers(rng.uniform(0.6, 2, 3))}) {turn(rng)}"
    transforms = []
    for _ in range(count):
        size, place = [1, 1, rng.uniform(0.3, 2)], [0, 0, rng.choice([-1, -0.5, 0, 0.5, rng.uniform(-1, 1)])]
        own = {"C": sized(size, place), "S": f"ROTATE-X ({rng.uniform(0, 360)!r})", "T": "SCALE (1 -1 1)"}[shape[0]]
        transforms.append(f"{spin(rng)} {own} {after}")
    transforms.append(f"SCALE ({numbers(rng.uniform(0.5, 1.5, 3))}) {turn(rng)}")
    return text(rng, [shape] * count + [SHAPES[rng.integers(4)]], transforms, tree(rng, count + 1))


def nested(rng):
    """One in the other about a common centre, touching from within here and there."""
    count = rng.integers(3, 7)
    after = turn(rng) if rng.random() < 0.5 else ""
    shapes, transforms, size = [], [], 2.0
    for _ in range(count):
        kind = rng.integers(3)
        shapes.append(SHAPES[kind])
        centre = ("TRANSLATE (-.5 -.5 -.5) SCALE (2 2 2)", "", "TRANSLATE (0 0 -.5) SCALE (1 1 2)")[kind]
        transforms.append(f"{centre} SCALE ({numbers([size] * 3)}) {after}")
        size *= rng.choice([1.0, 0.9, 0.75, 0.5])
    return text(rng, shapes, transforms, tree(rng, count, "+-*-"))


def grazing(rng):
    """Balls, poles and a cone that rest on planes and on one another, up to three deep, in any order."""
    stretch = f"SCALE ({numbers(rng.uniform(0.5, 1.6, 3))})" if rng.random() < 0.3 else ""
    after = f"{stretch} {turn(rng)}" if rng.random() < 0.8 else ""
    r = rng.uniform(0.4, 1)
    small = r * rng.uniform(0.3, 0.9)
    tiny = small * rng.uniform(0.3, 0.9)

    def ball(radius, *place):
        return "SPHERE", sized([radius] * 3, place, after)

    def pole(radius, x, z, shape="CYLINDER", size=2, tilt=90):
        scale = numbers([radius, radius, size])
        return shape, f"{spin(rng)} SCALE ({scale}) ROTATE-X ({tilt}) TRANSLATE ({x} 1 {z}) {after}"

    solids = [
        ("CUBE", sized([3, 3, 0.5], [-1.5, -1.5, -0.5], after)),
        ball(r, 0, 0, r),
        pole(r, 0, -r if rng.random() < 0.5 else r),
        *[
            [ball(r, 2 * r, 0, rng.choice([r, -0.5 - r, -r]))],
            [ball(small, 0, 0, small), ball(tiny, 0, 0, rng.choice([tiny, 2 * small - tiny]))],
            [pole(small, 0, small), pole(r, 2 * r, r)],
            [pole(2, 0.5, 0, "CONE", tilt=45), ball(r, 0, 0, -0.5 - r)],
        ][rng.integers(4)],
    ]
    if rng.random() < 0.3:
        solids.append(("PLANE", f"TRANSLATE (0 0 {rng.choice([0, 2 * r])}) {after}"))
    shapes, transforms = zip(*[solids[i] for i in rng.permutation(len(solids))])
    # What a PLANE leaves has an end.
    nodes = ["*", *tree(rng, len(solids)), len(solids)]
    return text(rng, [*shapes, "CUBE"], [*transforms, sized([20] * 3, [-10] * 3)], nodes)


def round_shape(rng):
    """A torus, a truncated cone or another primitive."""
    names = f"TORUS radius {rng.uniform(0.1, 0.9):.3f}", f"CONE radius {rng.uniform(0.01, 0.95):.3f}", "TORUS"
    return [*names, *SHAPES][rng.integers(7)]


def rings_and_stumps(rng):
    """Tori and truncated cones, stretched, mirrored and turned by a matrix."""
    count = rng.integers(2, 6)
    shapes = [round_shape(rng) for _ in range(count)]
    transforms = [
        f"MATRIX ({numbers((rng.normal(scale=0.6, size=(3, 4)) + np.eye(3, 4)).ravel())}) {turn(rng)}" for _ in shapes
    ]
    return text(rng, shapes, transforms, tree(rng, count))


def crossing_rings(rng):
    """Tori about one axis that differ a little, so that they cross at small angles."""
    radius, count, after = rng.uniform(0.2, 0.8), rng.integers(2, 4), turn(rng)
    shapes, transforms = [], []
    for _ in range(count):
        shapes.append(f"TORUS radius {radius + rng.choice([0, 0.001]):.4f}")
        size = rng.choice([1, 1 + 10 ** rng.uniform(-3, -1.5)])
        transforms.append(f"{spin(rng)} {sized([size, size, -size], [0, 0, rng.choice([0, 0.002])], after)}")
    transforms.append(sized([9, 9, 9], [0, 0, 0], turn(rng)))
    return text(rng, [*shapes, "CUBE"], transforms, tree(rng, count + 1, "+-"))


def slices(rng):
    """Slices of one cone, and what lies on their discs, in a common placement."""
    count = rng.integers(2, 6)
    after = f"SCALE ({numbers(rng.uniform(0.6, 2, 3))}) {turn(rng)}" if rng.random() < 0.7 else ""
    shapes, transforms = [], []
    for _ in range(count):
        r = rng.choice([0.25, 0.5, 0.75, round(rng.uniform(0.05, 0.9), 3)])
        factor = rng.choice([-1, 0.5, 1, 2, rng.uniform(0.5, 1.5)])
        shape = ["CONE", "CYLINDER", "CUBE", f"CONE radius {r}"][rng.choice(4, p=[0.15, 0.1, 0.15, 0.6])]
        stump = f"SCALE (1 1 {float(1 - r)!r}) TRANSLATE (0 0 {float(r)!r})" if "radius" in shape else ""
        shapes.append(shape)
        transforms.append(f"{spin(rng)} {stump} SCALE ({numbers([factor] * 3)}) {after}")
    return text(rng, shapes, transforms, tree(rng, count))


def half_spaces(rng, after=""):
    """A grid whose solids are cut by planes, which lie on faces of the grid, too."""
    count = rng.integers(2, 5)
    shapes, transforms, nodes = [], [], []
    for node in tree(rng, count):
        nodes += [node] if isinstance(node, str) else ["-*"[rng.integers(2)], 2 * node, 2 * node + 1]
    for _ in range(count):
        shapes += [round_shape(rng) if rng.random() < 0.3 else SHAPES[rng.choice(4, p=[0.6, 0.1, 0.2, 0.1])], "PLANE"]
        transforms += [
            f"SCALE ({numbers(size)}) {quarters(rng, 1)} TRANSLATE ({numbers(rng.integers(-2, 3, 3) / 2)}) {after}"
            for size in (rng.choice([0.5, 1, 2], 3), rng.choice([-1, 1], 3))
        ]
    return text(rng, shapes, transforms, nodes)


def stretched(rng):
    return f"ROTATE-X ({rng.uniform(0, 90)!r}) SCALE ({numbers(rng.uniform(0.7, 1.4, 3))}) {turn(rng)}"


GRIDS = grid, decimals, half_spaces
ROUND = unions, same_quadric, nested, grazing, rings_and_stumps, crossing_rings, slices
KINDS = {f.__name__: f for f in (chains, crowds, *GRIDS, *ROUND)} | {
    "turned_grid": lambda rng: grid(rng, turn(rng)),
    "stretched_grid": lambda rng: grid(rng, stretched(rng)),
    "turned_half_spaces": lambda rng: half_spaces(rng, turn(rng)),
}


# ---- The comparison --------------------------------------------------------------------------------------------------


def wrong_owners(scene, triangles, owner, rng, count=1000, reach=0.02):
    """How many of random points on ``triangles`` (n, 3, 3) do not lie on a surface of the leaf ``owner`` (n,).

    A point counts as wrong if all surfaces of this leaf are farther than ``reach``, which is above the chord error.
    """
    edges = triangles[:, 1:] - triangles[:, :1]
    normals = np.cross(edges[:, 0], edges[:, 1])
    size = np.linalg.norm(normals, axis=1)
    chosen = rng.choice(len(size), count, p=size / size.sum())
    points = np.einsum("kc,kci->ki", rng.dirichlet([1, 1, 1], count), triangles[chosen])
    # Rays that are oblique to all faces, against the normals.
    away = normals[chosen] / size[chosen, None] + rng.normal(scale=0.02, size=(count, 3))
    wrong = np.arange(count)
    for shifts in np.zeros((1, 1, 3)), rng.normal(scale=reach / 2, size=(24, 1, 3)):
        out = np.broadcast_to(away[wrong], (len(shifts), len(wrong), 3))
        origins = points[wrong] + reach * out + shifts - out * (out * shifts).sum(-1, keepdims=True)
        right = np.zeros(out.shape[:2], bool)
        for distance, enters, leaf in surfaces(scene, origins.reshape(-1, 3), -out.reshape(-1, 3)):
            here = enters & (np.abs(distance - reach) < reach)
            right |= here.reshape(right.shape) & (leaf.reshape(right.shape) == owner[chosen[wrong]])
        wrong = wrong[~right.any(0)]
    return len(wrong)


def through_pixels(camera, i, j):
    """Unit directions from the camera's eye through the centres of the pixels (i, j), arrays of numbers."""
    width, height = camera.pixel
    a, b = camera.left + (i + 0.5) * width, camera.top - (j + 0.5) * height
    d = np.multiply.outer(a, camera.u) + np.multiply.outer(b, camera.v) - camera.depth * camera.n
    return d / np.linalg.norm(d, axis=-1, keepdims=True)


def wrong_pixels(scene, camera, seen):
    """Pixels where ``seen(origins, directions)``, numbers of leaves or -1, is not what the definition gives.

    A pixel counts as wrong if what is seen through its centre is exact nowhere within a pixel of it.
    """
    width, height = camera.resolution
    j, i = (a.ravel() for a in np.mgrid[:height, :width])

    def rays(x, y):
        directions = through_pixels(camera, x, y)
        return np.broadcast_to(camera.eye, directions.shape), directions

    found = seen(*rays(i, j))
    wrong = np.flatnonzero(found != first_surfaces(scene, *rays(i, j))[0])
    radius, angle = (a.reshape(-1, 1) for a in np.meshgrid((0.25, 0.5, 1.0), np.arange(16) * np.pi / 8))
    x, y = i[wrong] + radius * np.cos(angle), j[wrong] + radius * np.sin(angle)
    near = first_surfaces(scene, *rays(x.ravel(), y.ravel()))[0].reshape(x.shape)
    wrong = wrong[(near != found[wrong]).all(0)]
    return np.stack([i[wrong], j[wrong]], axis=1)
