"""Who owns a face where faces of several primitives coincide: the primitive that stands first in the tree.

manifold3d decides coincidences by the order of its operands, but its clean-up of the degenerate triangles that they
leave can hand some of the area to the other operand. Here the rule is applied to the finished triangles, straight from
its definition on the tree.
"""

import numpy as np

CHUNK = 512  # triangles at a time; they are neighbours, so that most primitives are far from all of them


def settle(nodes, leaf, points, normals, distances, inside, low, high):
    """The leaf that owns each of the given points on the surface of the result.

    ``nodes`` is the tree in prefix order, operators as strings and leaves as anything else; ``leaf`` holds the present
    owners (numbers of leaves, in the tree's order), ``normals`` point out of the result, ``distances`` say how far off
    the surface its two sides are looked at. ``inside(number, points)`` tells what a leaf contains; ``low`` and ``high``
    are the boxes of all leaves.
    """
    result = leaf.copy()
    order = np.lexsort(np.floor((points - points.min(axis=0)) / (np.ptp(points, axis=0).max() / 16 + 1e-300)).T)
    for start in range(0, len(order), CHUNK):
        chosen = order[start:start + CHUNK]
        step = normals[chosen] * distances[chosen, None]
        both = np.concatenate([points[chosen] - step, points[chosen] + step])
        near = np.all((low <= both.max(axis=0)) & (high >= both.min(axis=0)), axis=1)
        owner = _owner(nodes, both, near, inside)
        result[chosen] = np.where(owner >= 0, owner, leaf[chosen])
    return result


def _owner(nodes, both, near, inside):
    """Evaluates the tree on both sides of each point.

    The state of a node is (contains the side below, contains the side above, owner of the face between them or -1), or
    None for a node that is far from all points.
    """
    stack, number, half = [], len(near), len(both) // 2
    for node in reversed(nodes):
        if isinstance(node, str):
            stack.append(_combine(node, stack.pop(), stack.pop()))
            continue
        number -= 1
        if near[number]:
            below, above = np.split(inside(number, both), [half])
            stack.append((below, above, np.where(below != above, number, -1)))
        else:
            stack.append(None)
    state = stack.pop()
    return state[2] if state else np.full(half, -1)


def _combine(operator, left, right):
    if left is None or right is None:
        return left or right if operator == "+" else left if operator == "-" else None
    if operator == "+":
        below, above = left[0] | right[0], left[1] | right[1]
    elif operator == "-":
        below, above = left[0] & ~right[0], left[1] & ~right[1]
    else:
        below, above = left[0] & right[0], left[1] & right[1]
    # The first operand's face where it bounds the result; else it is the second's.
    first = (left[0] == below) & (left[1] == above)
    return below, above, np.where(below == above, -1, np.where(first, left[2], right[2]))
