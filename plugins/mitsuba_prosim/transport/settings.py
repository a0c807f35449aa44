"""What a render is asked to compute, as the integrator's parameters say it."""

from __future__ import annotations

from dataclasses import dataclass

import mitsuba as mi

#: The nodes of a ray tree are numbered as in a heap, in 32 bits.
DEEPEST_TREE = 24


@dataclass(frozen=True)
class Settings:
    """Settings of the transport of light; :ref:`integrator-prosim` says what each means."""

    max_level: int
    shadows: bool
    ambient: mi.Texture | None
    background: mi.Texture | None
    diffuse_bounces: int
    cutoff: float
    rr_depth: int
    rr_throughput: float
    hide_emitters: bool

    @property
    def follows_tree(self) -> bool:
        """Whether light is followed as Whitted's tree, with nothing from a diffuse component, not along paths."""
        return self.diffuse_bounces == 0
