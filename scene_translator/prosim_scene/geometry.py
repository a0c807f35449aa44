"""Primitives, their transforms and tessellation, and the triangles of the whole scene with exact normals.

Canonical solids: CUBE [0,1]^3; SPHERE the unit ball; CYLINDER x^2 + y^2 <= 1, 0 <= z <= 1; CONE x^2 + y^2 <= z^2,
0 <= z <= 1 with its apex at the origin.
"""

import math
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from manifold3d import Manifold

from . import coincidence, csg, model

TOLERANCE = 0.1  # chord error in pixels
MIN_SEGMENTS, MAX_SEGMENTS = 16, 1024  # around a circle
SPHERE_FACTOR = 1.64  # an octahedral sphere needs so many times the segments of a circle for the same chord error
ON_FACE = 1e-6  # distance in a primitive's own space within which a vertex lies on a flat face
CHUNK = 1 << 18  # triangles at a time


def matrix(transform):
    """The 4x4 matrix of a TRANSFORM: its steps in the order in which they are applied."""
    result = np.eye(4)
    for step in transform.steps:
        m = np.eye(4)
        if step.kind == "scale":
            m[[0, 1, 2], [0, 1, 2]] = step.values
        elif step.kind == "translate":
            m[:3, 3] = step.values
        else:
            quarters, rest = divmod(step.values[0], 90)  # a right angle is exact
            sine, cosine = math.sin(math.radians(rest)), math.cos(math.radians(rest))
            for _ in range(int(quarters % 4)):
                sine, cosine = cosine, -sine
            i, j = {"rotate-x": (1, 2), "rotate-y": (2, 0), "rotate-z": (0, 1)}[step.kind]
            m[i, i] = m[j, j] = cosine
            m[j, i], m[i, j] = sine, -sine
        result = m @ result
    return result


@lru_cache(maxsize=256)
def unit_mesh(shape, segments):
    """Vertices and outward triangles of a canonical solid; the vertices of curved faces lie on the quadric."""
    if shape == "sphere":
        mesh = Manifold.sphere(1.0, segments).to_mesh64()
        vertices = np.array(mesh.vert_properties)[:, :3]
        return vertices / np.linalg.norm(vertices, axis=1, keepdims=True), np.array(mesh.tri_verts, dtype=np.int64)
    if shape == "cube":
        mesh = Manifold.cube((1.0, 1.0, 1.0)).to_mesh64()
        return np.array(mesh.vert_properties)[:, :3], np.array(mesh.tri_verts, dtype=np.int64)
    i = np.arange(segments)
    angle = 2 * math.pi * i / segments
    ring = np.stack([np.cos(angle), np.sin(angle), np.ones(segments)], axis=1)
    following = (i + 1) % segments
    fan = np.stack([np.zeros(segments - 2, int), i[1:-1], i[2:]], axis=1)  # counter-clockwise seen from above
    if shape == "cylinder":  # ring at z = 1, then at z = 0
        low = segments
        return (np.concatenate([ring, ring * [1, 1, 0]]),
                np.concatenate([fan, fan[:, ::-1] + low, np.stack([i, i + low, following], axis=1),
                                np.stack([following, i + low, following + low], axis=1)]))
    return (np.concatenate([ring, np.zeros((1, 3))]),
            np.concatenate([fan, np.stack([i, np.full(segments, segments), following], axis=1)]))


def segments(shape, to_world, camera, tolerance):
    """Segments around a circle, so that the chord error stays below ``tolerance`` pixels in the image."""
    if shape == "cube":
        return 4
    columns = to_world[:3, :3] if shape == "sphere" else to_world[:3, :2]
    size = np.linalg.norm(columns, 2)  # the longest semi-axis
    center = to_world[:3, 3] if shape == "sphere" else to_world[:3, :3] @ [0, 0, 0.5] + to_world[:3, 3]
    reach = size if shape == "sphere" else np.linalg.norm(to_world[:3, :3] @ [0, 0, 0.5]) + size
    error = tolerance * camera.footprint(center, reach) / size
    n = math.pi / math.acos(1 - min(error, 0.5)) if error > 1e-9 else MAX_SEGMENTS
    n = min(max(n * (SPHERE_FACTOR if shape == "sphere" else 1), MIN_SEGMENTS), MAX_SEGMENTS)
    return 4 * math.ceil(n / 4)


def _plane(*nd):
    """The plane n.p + d = 0 as a quadric."""
    return np.outer(nd, nd).astype(float)


#: The surfaces of the canonical solids as quadrics p^T Q p = 0, p = (x, y, z, 1), by the number of the face.
QUADRICS = {
    "cube": [_plane(*n, d) for d in (0, -1) for n in np.eye(3)],
    "sphere": [np.diag([1.0, 1, 1, -1])],
    "cylinder": [np.diag([1.0, 1, 0, -1]), _plane(0, 0, 1, -1), _plane(0, 0, 1, 0)],
    "cone": [np.diag([1.0, 1, -1, 0]), _plane(0, 0, 1, -1)],
}


def _surfaces(shape, inverse):
    """Hashes of the quadrics that a primitive's faces lie on, by the number of the face; equal where 7 digits agree."""
    result = []
    for quadric in QUADRICS[shape]:
        q = inverse.T @ quadric @ inverse
        q /= np.abs(q[:3, :3]).max()
        scale = np.abs(q).max(axis=0) + 1  # of the offsets against the directions
        result.append(hash((np.round(q / scale[3] * 1e7) + 0.0).tobytes()))
    return result


@dataclass
class Triangles:
    """Triangles of one material, corner by corner: positions (n, 3, 3), unit normals (n, 3, 3), uv (n, 3, 2), and a key
    (n, 3) that is equal for equal corners."""

    positions: np.ndarray
    normals: np.ndarray
    uv: np.ndarray
    keys: np.ndarray


def triangles(document, camera, tolerance, medium, material):
    """The surfaces of a document's scene: {material: Triangles}.

    ``medium(leaf)`` is a dielectric's medium or None, ``material(leaf)`` a hashable key: leaves with the same key
    share a mesh.
    """
    scene = document.scene
    leaves = [n for n in scene.csg if isinstance(n, model.Leaf)]
    if not leaves:
        return {}
    matrices = {i: matrix(scene.transforms[i]) for i in {leaf.index for leaf in leaves}}
    inverses = {}
    for i, m in matrices.items():
        if not np.isfinite(m).all() or np.linalg.cond(m[:3, :3]) > 1e12:
            raise document.error("this transform is singular or beyond double precision", "transforms", i)
        inverses[i] = np.linalg.inv(m)
    base = csg.reserve_ids(len(leaves))
    surfaces = {key: _surfaces(key[0], inverses[key[1]]) for key in {(leaf.shape, leaf.index) for leaf in leaves}}
    rounds = {key: segments(key[0], matrices[key[1]], camera, tolerance) for key in surfaces}
    numbers = iter(range(len(leaves) - 1, -1, -1))  # evaluate() asks for the leaves from the last to the first

    def leaf_value(leaf):
        m = matrices[leaf.index]
        vertices, faces = unit_mesh(leaf.shape, rounds[leaf.shape, leaf.index])
        if np.linalg.det(m[:3, :3]) < 0:  # a mirrored solid is inside out
            faces = faces[:, ::-1]
        return {medium(leaf): csg.solid(vertices @ m[:3, :3].T + m[:3, 3], faces, base + next(numbers),
                                        frozenset(surfaces[leaf.shape, leaf.index]))}

    nodes = [n.symbol if isinstance(n, model.Operator) else n for n in scene.csg]
    value = csg.evaluate(nodes, leaf_value)
    media = csg.precedence(map(medium, leaves))
    rank = np.array([media.index(medium(leaf)) for leaf in leaves])

    materials = {}
    material_of = np.array([materials.setdefault(material(leaf), len(materials)) for leaf in leaves])
    table = _LeafTable(leaves, matrices, inverses, _signs(scene.csg), [surfaces[leaf.shape, leaf.index] for leaf in leaves],
                       [rounds[leaf.shape, leaf.index] for leaf in leaves])
    seen = np.zeros(len(leaves), bool)
    collected = {}
    offset = 0
    for own, vertices, faces, ids in csg.shells(value, media):
        before = ids - base
        vertices, faces, before = table.cut_shared_faces(vertices, faces, before)
        leaf = table.owners(nodes, vertices, faces, before)
        if len(media) > 1:
            # A face that coincides with one of another medium's solid is part of that one's shell, if it has precedence.
            other = (leaf != before) & (table.sign[leaf] > 0) & (rank[leaf] != media.index(own))
            kept = ~other | (rank[leaf] > media.index(own))
            leaf, faces = np.where(other, before, leaf)[kept], faces[kept]
        seen[leaf] = True
        for start in range(0, len(faces), CHUNK):
            part = slice(start, start + CHUNK)
            corners = table.corners(vertices[faces[part]], faces[part] + offset, leaf[part])
            group = material_of[leaf[part]]
            for m in np.unique(group):
                chosen = group == m
                collected.setdefault(m, []).append([a[chosen] for a in corners])
        offset += len(vertices)
    _report_vanished(document, seen)
    keys = list(materials)
    return {keys[m]: Triangles(*map(np.concatenate, zip(*collected[m]))) for m in sorted(collected)}


def _signs(nodes):
    """+1 for each leaf whose outside is the outside of the result, -1 for one that is subtracted."""
    signs, stack = [], [1]
    for node in nodes:
        sign = stack.pop()
        if isinstance(node, model.Operator):
            stack += [-sign if node.symbol == "-" else sign, sign]
        else:
            signs.append(sign)
    return np.array(signs, dtype=float)


def _report_vanished(document, seen):
    leaves = [(n, leaf) for n, leaf in enumerate(document.scene.csg) if isinstance(leaf, model.Leaf)]
    gone = [leaf for leaf, s in zip(leaves, seen) if not s]
    if len(gone) == len(leaves):
        document.warn("the tree's result is empty: nothing is left to see", "csg")
    elif gone:
        names = [f"{leaf.shape.upper()} {leaf.index} (line {document.line('csg', n)})" for n, leaf in gone[:10]]
        more = f" and {len(gone) - 10} more" if len(gone) > 10 else ""
        document.warn(f"nothing is seen of {', '.join(names)}{more}: no face of it is left in the result", "csg", gone[0][0])


class _LeafTable:
    """Normals and surface parameters of all leaves at once."""

    SHAPES = ("cube", "sphere", "cylinder", "cone")

    def __init__(self, leaves, matrices, inverses, signs, surfaces, rounds):
        self.shape = np.array([self.SHAPES.index(leaf.shape) for leaf in leaves])
        self.matrix = np.array([matrices[leaf.index][:3] for leaf in leaves])
        self.inverse = np.array([inverses[leaf.index][:3] for leaf in leaves])
        self.sign = signs
        self.unshared = 0  # corners so far that are shared with no other triangle
        self.surfaces, self.rounds = surfaces, rounds
        self.bearers = {}  # surface -> the leaves that have a face on it
        for number, hashes in enumerate(surfaces):
            for surface in hashes:
                self.bearers.setdefault(surface, []).append(number)
        self.shared = {surface for surface, bearers in self.bearers.items() if len(bearers) > 1}
        # Boxes: the image of the canonical box, exact for cubes and wide enough for the others.
        canonical = {"cube": (0, 1, 0), "sphere": (-1, 1, -1), "cylinder": (-1, 1, 0), "cone": (-1, 1, 0)}
        box = np.array([[(x, y, z) for x in (a, b) for y in (a, b) for z in (c, b)] for a, b, c in canonical.values()])
        corners = np.einsum("tij,tcj->tci", self.matrix[:, :, :3], box[self.shape]) + self.matrix[:, None, :, 3]
        self.low, self.high = corners.min(axis=1), corners.max(axis=1)
        self.margin = 1e-6 * (self.high - self.low).max(axis=1)

    def inside(self, number, points):
        """Which points a leaf contains."""
        x, y, z = self.inverse[number, :, :3] @ points.T + self.inverse[number, :, 3:]
        shape = self.SHAPES[self.shape[number]]
        if shape == "cube":
            return (x >= 0) & (x <= 1) & (y >= 0) & (y <= 1) & (z >= 0) & (z <= 1)
        if shape == "sphere":
            return x * x + y * y + z * z <= 1
        return (x * x + y * y <= (1 if shape == "cylinder" else z * z)) & (z >= 0) & (z <= 1)

    def others_on(self, number, code):
        """Leaves other than ``number`` that have a face on the surface of its face ``code``, their boxes in reach."""
        others = np.array([b for b in self.bearers[self.surfaces[number][code]] if b != number], dtype=int)
        return others[np.all((self.low[others] <= self.high[number] + self.margin[number])
                             & (self.high[others] >= self.low[number] - self.margin[number]), axis=1)]

    def on_shared_surfaces(self, leaf):
        """Triangles whose leaf has a face on a surface that another one has too."""
        bearing = np.array([any(h in self.shared for h in hashes) for hashes in self.surfaces])
        return np.flatnonzero(bearing[leaf])

    def flat_face(self, number, code):
        """Of a flat face: its normal out of the result, its local axes and its convex outline on them."""
        if self.shape[number] == 0:
            axis, side = code % 3, 1 if code >= 3 else -1
            across, outline = [i for i in range(3) if i != axis], np.array([[0, 0], [1, 0], [1, 1], [0, 1]], float)
        else:
            axis, side, across = 2, -1 if self.shape[number] == 2 and code == 2 else 1, [0, 1]
            angle = 2 * math.pi * np.arange(self.rounds[number]) / self.rounds[number]
            outline = np.stack([np.cos(angle), np.sin(angle)], axis=1)
        return self.sign[number] * side * self.inverse[number, axis, :3], across, outline

    def cut_shared_faces(self, vertices, faces, leaf):
        """Cuts the triangles on planes that several leaves share along the outlines of the leaves' faces."""
        candidates = self.on_shared_surfaces(leaf)
        if not len(candidates):
            return vertices, faces, leaf
        face = self.evaluate(vertices[faces[candidates]], leaf[candidates])[4]
        jobs = []  # triangles and the lines along which to cut them
        for (number, code), group in _groups(np.stack([leaf[candidates], face], axis=1)):
            surface = self.surfaces[number][code]
            if surface not in self.shared or self.shape[number] == 1 or (self.shape[number] > 1 and code == 0):
                continue
            normal = self.flat_face(number, code)[0]
            others = self.others_on(number, code)
            for b in [*others, *([number] if len(others) else [])]:
                outward, across, outline = self.flat_face(b, self.surfaces[b].index(surface))
                if outward @ normal <= 0:
                    continue
                following = np.roll(outline, -1, axis=0)
                sides = np.stack([following[:, 1] - outline[:, 1], outline[:, 0] - following[:, 0]], axis=1)
                sides /= np.linalg.norm(sides, axis=1, keepdims=True)
                lines = np.concatenate([sides, -np.sum(sides * outline, axis=1, keepdims=True)], axis=1)
                corners = vertices[faces[candidates[group]]]
                local = (corners @ self.inverse[b, :, :3].T + self.inverse[b, :, 3])[..., across]
                hit = candidates[group[coincidence.overlap(local, outline, lines)]]
                if len(hit):
                    planes = lines[:, :2] @ self.inverse[b][across]
                    planes[:, 3] += lines[:, 2]
                    jobs.append((hit, planes))
        if not jobs:
            return vertices, faces, leaf
        cutter = coincidence.Cutter(vertices, faces, leaf, np.unique(np.concatenate([hit for hit, _ in jobs])))
        for hit, planes in jobs:
            cutter.cut(hit.tolist(), planes)
        return cutter.arrays()

    def owners(self, nodes, vertices, faces, leaf):
        """The leaves of triangles, corrected where faces of several primitives coincide."""
        candidates = self.on_shared_surfaces(leaf)
        if not len(candidates):
            return leaf
        corners, owner = vertices[faces[candidates]], leaf[candidates]
        _, normal, _, _, face, local = self.evaluate(corners, owner)
        middle = corners.mean(axis=1)
        # Only where a primitive other than the present owner has a face on the same surface and its box reaches there.
        margin = self.margin
        ambiguous = np.zeros(len(candidates), bool)
        pairs = np.stack([owner, face], axis=1)
        for (number, code), in_group in _groups(pairs):
            surface = self.surfaces[number][code]
            if surface in self.shared:
                for b in self.others_on(number, code):
                    ambiguous[in_group] |= np.all((middle[in_group] >= self.low[b] - margin[b])
                                                  & (middle[in_group] <= self.high[b] + margin[b]), axis=1)
        if not ambiguous.any():
            return leaf
        chosen, owner, face = candidates[ambiguous], owner[ambiguous], face[ambiguous]
        # The middle of a triangle, on the surface itself and not on its chord.
        p = local[ambiguous].mean(axis=1)
        shape = self.shape[owner]
        round_ = (face == 0) & (shape > 0)
        radius = np.where(shape == 1, np.linalg.norm(p, axis=1), np.hypot(p[:, 0], p[:, 1]))
        factor = np.where(round_, np.where(shape == 3, np.abs(p[:, 2]), 1) / np.maximum(radius, 1e-300), 1)
        p = np.where((shape == 1)[:, None], p * factor[:, None], p * np.stack([factor, factor, np.ones_like(factor)], axis=1))
        points = np.einsum("tij,tj->ti", self.matrix[owner][:, :, :3], p) + self.matrix[owner][:, :, 3]
        normals = normal[ambiguous].mean(axis=1)
        normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-300)
        leaf = leaf.copy()
        leaf[chosen] = coincidence.settle(nodes, owner, points, normals, margin[owner], self.inside, self.low, self.high)
        return leaf

    def evaluate(self, positions, leaf):
        """World positions and normals of corners, uv, whether a corner is shared by no other triangle, the triangles' face
        numbers and the corners in their primitives' own spaces."""
        inverse = self.inverse[leaf]
        local = positions @ inverse[:, :, :3].transpose(0, 2, 1) + inverse[:, None, :, 3]
        normal, uv = np.zeros_like(local), np.zeros(local.shape[:2] + (2,))
        face = np.zeros(len(leaf), int)
        unique = np.zeros(local.shape[:2], bool)
        for number, name in enumerate(self.SHAPES):
            chosen = self.shape[leaf] == number
            if chosen.any():
                normal[chosen], uv[chosen], face[chosen], unique[chosen] = getattr(self, "_" + name)(local[chosen])
        world = normal @ inverse[:, :, :3]  # by the inverse's transpose
        length = np.linalg.norm(world, axis=2, keepdims=True)
        world *= self.sign[leaf, None, None] / np.where(length > 0, length, 1)
        return positions, world, uv, unique, face, local

    def corners(self, positions, vertex, leaf):
        """Positions, normals, uv and keys of the corners of triangles, for their vertex numbers and leaves."""
        positions, world, uv, unique, face, _ = self.evaluate(positions, leaf)
        wrapped = (np.floor(uv[..., 0]) > 0).astype(int)
        keys = ((vertex * len(self.shape) + leaf[:, None]) * 8 + face[:, None]) * 2 + wrapped
        count = int(unique.sum())
        keys[unique] = -1 - np.arange(self.unshared, self.unshared + count)
        self.unshared += count
        return positions, world, uv, keys

    def _cube(self, p):
        center = p.mean(axis=1)
        face = np.argmin(np.concatenate([np.abs(center), np.abs(1 - center)], axis=1), axis=1)
        normal = np.zeros_like(p)
        axis = face % 3
        normal[np.arange(len(p)), :, axis] = np.where(face < 3, -1, 1)[:, None]
        across = np.array([[1, 2], [0, 2], [0, 1]])[axis]  # (y, z), (x, z), (x, y)
        return normal, np.take_along_axis(p, np.repeat(across[:, None], 3, axis=1), axis=2), face, np.zeros(p.shape[:2], bool)

    def _sphere(self, p):
        radius = np.linalg.norm(p, axis=2)
        u, pole = _azimuth(p)
        v = np.arccos(np.clip(p[..., 2] / radius, -1, 1)) / math.pi
        return p, np.stack([u, v], axis=2), np.zeros(len(p), int), pole

    def _cylinder(self, p):
        return self._round(p, {1: 1.0, 2: 0.0}, lambda p: p * [1, 1, 0])

    def _cone(self, p):
        normal, uv, face, unique = self._round(p, {1: 1.0}, lambda p: p * [1, 1, -1])
        apex = (np.linalg.norm(p, axis=2) < ON_FACE) & (face == 0)[:, None]
        tips = apex.any(axis=1)
        # The apex has no normal: each triangle takes that of the generator through the middle of its other corners.
        middle = np.where(apex[..., None], 0, p)[tips].sum(axis=1) * [1, 1, 0]
        middle /= np.maximum(np.linalg.norm(middle, axis=1, keepdims=True), 1e-300)
        middle[:, 2] = -1
        normal[tips] = np.where(apex[tips][..., None], middle[:, None], normal[tips])
        return normal, uv, face, unique | apex

    def _round(self, p, caps, gradient):
        """Lateral face 0 with (azimuth, z), and flat faces {code: z} with (x, y) in the unit square."""
        normal = gradient(p)
        u, pole = _azimuth(p)
        uv = np.stack([u, p[..., 2]], axis=2)
        face = np.zeros(len(p), int)
        for code, z in caps.items():
            flat = np.all(np.abs(p[..., 2] - z) < ON_FACE, axis=1)
            face[flat] = code
            normal[flat] = [0, 0, 1 if z else -1]
            uv[flat] = p[flat][..., :2] / 2 + 0.5
        return normal, uv, face, pole & (face == 0)[:, None]


def _groups(pairs):
    """Each different row of an integer array, and the rows where it stands."""
    values, index = np.unique(pairs, axis=0, return_inverse=True)
    order = np.argsort(index.ravel(), kind="stable")
    ends = np.cumsum(np.bincount(index.ravel()))
    return zip(values, np.split(order, ends[:-1]))


def _azimuth(p):
    """Azimuth of the corners in [0, 1], or up to 2 in triangles across the seam, and which corners lie on the axis.

    A corner on the axis has no azimuth of its own and takes the mean of the others.
    """
    pole = np.hypot(p[..., 0], p[..., 1]) < ON_FACE
    u = np.arctan2(p[..., 1], p[..., 0]) / (2 * math.pi) % 1.0
    spread = np.where(pole, -np.inf, u).max(axis=1) - np.where(pole, np.inf, u).min(axis=1)
    u = np.where((spread > 0.5)[:, None] & (u < 0.5), u + 1, u)
    others = np.where(pole, 0, u).sum(axis=1) / np.maximum((~pole).sum(axis=1), 1)
    return np.where(pole, others[:, None], u), pole
