"""The settings of the light transport."""

from __future__ import annotations

from dataclasses import dataclass, fields

import mitsuba as mi


@dataclass(frozen=True)
class Settings:
    """Settings of the light transport; the plugin page :ref:`integrator-prosim` explains each setting."""

    max_level: int
    shadows: bool
    ambient: mi.Texture | None
    background: mi.Texture | None
    diffuse_bounces: int
    cutoff: float
    rr_depth: int
    rr_throughput: float
    hide_emitters: bool
    layers: str

    @property
    def follows_tree(self) -> bool:
        """Whether the integrator follows Whitted's ray tree, which has no diffuse rays, instead of paths."""
        return self.diffuse_bounces == 0


#: Names of the settings.
SETTINGS = tuple(field.name for field in fields(Settings))
