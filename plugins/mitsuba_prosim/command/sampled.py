"""How an image is sampled: the options that say so, and the integrator's parameters that they stand for."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import click

from ..engine.policies import POLICIES
from .options import Finite, Whole, aims

#: In the order of the help.
OPTIONS = (
    click.option(
        "--spp",
        type=Whole(1, 2**24),
        help="Samples per pixel, as Mitsuba counts them, instead of --samples. [default: what the scene says]",
        show_default=False,
    ),
    click.option("--seed", type=Whole(0, 2**32 - 1), default=0, help="Seed of the samples."),
    click.option(
        "--paths",
        is_flag=True,
        help="Follow every path of light, diffuse reflections included, in place of the ambient term.",
    ),
    click.option(
        "--caustics/--no-caustics",
        default=None,
        show_default=False,
        help="Follow light from the sources through glass and mirrors to diffuse surfaces. "
        "[default: what the scene says]",
    ),
    click.option(
        "--max-level",
        type=Whole(-1, 2**16),
        show_default=False,
        help="Deepest level of reflected and refracted rays; -1, with --paths: any. "
        "[default: what the scene says; with --paths: -1]",
    ),
    click.option(
        "--threshold",
        type=Finite(min=0),
        show_default=False,
        help="Noise of a pixel that is small enough, white being 1; smaller takes longer. "
        "[default: what the scene says]",
    ),
    aims(
        noise="Render until the error of the displayed pixels, its root mean square, is so small, white being 1: 0.02 "
        "is rough, 0.005 is good.",
        noise_99="Render until 99 displayed pixels in 100 have no greater error, too.",
        time="Render for so long; with --noise: at most.",
        max_samples="Most samples that a pixel may get. "
        "[default: what the scene says; with --noise or --time: any number]",
    ),
    click.option(
        "--adaptive",
        type=click.Choice(tuple(POLICIES)),
        show_default=False,
        help="Which pixels get how many samples. [default: what the scene says; with --noise or --time: graded, which "
        "makes the most of them]",
    ),
)


def sampled(command: Callable) -> Callable:
    """Decorator: the options of what renders a scene's image from its beginning."""
    for option in reversed(OPTIONS):
        command = option(command)
    return command


def one_of(spp: int | None, samples: int | None) -> None:
    """Raises UsageError where both are given."""
    if spp and samples:
        raise click.UsageError("--spp and --samples both say how many samples a pixel gets; give one of them.")


def parameters(paths: bool, max_level: int | None, caustics: bool | None = None) -> dict[str, Any]:
    """Parameters of the ``prosim`` integrator that the options ask for; None takes one away."""
    result: dict[str, Any] = {"diffuse_bounces": -1, "max_level": -1, "ambient": None} if paths else {}
    result |= {} if caustics is None else {"caustics": caustics}
    return result | ({} if max_level is None else {"max_level": max_level})


def sampling(
    threshold: float | None, ends: Mapping[str, float | None], max_samples: int | None, adaptive: str | None
) -> dict[str, Any]:
    """Parameters of ``prosim`` and ``prosim_adaptive`` that the options ask for; ``ends``: those of noise and time."""
    if any(ends.values()) and adaptive is None:
        adaptive = "graded"
    if any(ends.values()) and adaptive == "thesis":
        raise click.UsageError(
            "--adaptive thesis ends each pixel by its own samples, N to N*N, and knows neither --noise nor --time; "
            "leave them out, or take another policy."
        )
    asked = {"threshold": threshold, **ends, "max_samples": max_samples, "adaptive": adaptive}
    return {name: value for name, value in asked.items() if value is not None}
