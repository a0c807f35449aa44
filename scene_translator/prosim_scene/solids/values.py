"""Values of a tree: the parts of each medium, {medium: [Part]}.

Media are what solids are made of as far as optics are concerned, see :mod:`.media`.
"""

from collections.abc import Iterable

from .parts import Part, difference, intersection, union

Value = dict[int, list[Part]]


def total(value: Value) -> list[Part]:
    """All media of a value as one solid."""
    return next(iter(value.values())) if len(value) == 1 else union(value.values())


def united(values: Iterable[Value]) -> Value:
    """The union of values, medium by medium."""
    media: dict[int, list[list[Part]]] = {}
    for value in values:
        for medium, parts in value.items():
            media.setdefault(medium, []).append(parts)
    return {medium: union(parts) for medium, parts in media.items()}


def without(value: Value, solid: list[Part]) -> Value:
    """A value less a solid."""
    return {medium: difference(parts, solid) for medium, parts in value.items()}


def within(value: Value, solid: list[Part]) -> Value:
    """What a value has in common with a solid, in its own media."""
    return {medium: intersection(parts, solid) for medium, parts in value.items()}
