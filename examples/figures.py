"""Draws the thesis's figures into a folder: ``python examples/figures.py OUT [--size small] [--only 5.1 5.18]``.

Needs matplotlib for the curves and patterns: ``pip install 'mitsuba-prosim[figures]'``.
"""

import argparse
import sys
import time
from functools import partial
from pathlib import Path

import mitsuba as mi
import mitsuba_prosim  # noqa: F401  (registers the plugins)
import numpy as np
from drawing import optics, sampling, scenes

#: Size of the figures -> the factor of the scenes' resolution, which is 480 pixels wide.
SIZES = {"tiny": 0.1, "small": 0.5, "medium": 1, "large": 2}

#: Figures that are drawn with matplotlib: name -> (function that draws into a figure, width and height in inches).
DRAWN = {
    "2.4-dieletrico": (optics.dielectric_outside, (4.8, 3.6)),
    "2.5-reflexao-total": (optics.dielectric_inside, (4.8, 3.6)),
    "2.6-cobre": (optics.copper, (4.8, 3.6)),
    "3.3-beckmann": (optics.beckmann, (6.4, 2.8)),
    "3.6-modelos-30": (partial(optics.lobes, incidence=30), (6.4, 2.8)),
    "3.7-modelos-70": (partial(optics.lobes, incidence=70), (6.4, 2.8)),
    "4.2-uniforme": (partial(sampling.strategy, name="random", n=100), (3.2, 3.2)),
    "4.3-disco-de-poisson": (partial(sampling.strategy, name="poisson_disk", n=100), (3.2, 3.2)),
    "4.4-jittering": (sampling.jittering, (3.2, 3.2)),
    "4.5-importancia": (sampling.importance, (4.8, 2.8)),
    "4.6-nao-correlacionado": (sampling.uncorrelated, (6.4, 3.2)),
    "4.7-n-rook": (partial(sampling.strategy, name="nrook", n=16, strata=16), (3.2, 3.2)),
    "4.9-estratos-da-fonte": (sampling.source_strata, (4.8, 2.8)),
    "4.10-quatro-raios": (sampling.four_rays, (4.8, 3.2)),
    "5.10-associacao": (sampling.association, (6.4, 3.2)),
    "5.11-rotacao": (sampling.rotation, (6.4, 2.4)),
}

#: Figures that are rendered to an array (height, width, 3): name -> function of the factor of the resolution.
RENDERED = {
    "5.1-chimarrao": partial(scenes.render, "chimarrao"),
    "5.2-aranha": partial(scenes.render, "aranha"),
    "5.3-chao-pouco-rugoso": partial(scenes.render, "chao-pouco-rugoso"),
    "5.4-chao-rugoso": partial(scenes.render, "chao-rugoso"),
    "5.5-chao-muito-rugoso": partial(scenes.render, "chao-muito-rugoso"),
    "5.6-fontes": partial(scenes.render, "fontes"),
    "5.7-cone": partial(scenes.render, "cone"),
    "5.8-spot": partial(scenes.render, "spot"),
    "5.9-penumbra": partial(scenes.render, "penumbra"),
    "5.12-poste-pontual": partial(scenes.render, "poste-pontual"),
    "5.13-poste-1": partial(scenes.render, "poste", samples=1),
    "5.14-poste-9": partial(scenes.render, "poste", samples=3),
    "5.14-samples": partial(scenes.render_counts, "poste", samples=3),
    "5.15-poste-25": partial(scenes.render, "poste", samples=5),
    "5.15-samples": partial(scenes.render_counts, "poste", samples=5),
    "5.16-esfera-metalica": partial(scenes.render, "esfera-metalica"),
    "5.18-caustica": partial(scenes.render, "caustica"),
    "5.18-fotons": partial(scenes.render, "caustica", caustics=True),
    "5.18-path": partial(scenes.render_path, "caustica", spp=1024),
    "6-absorcao": partial(scenes.render, "garrafas"),
    "6-dispersao": partial(scenes.render, "prisma"),
    "6-lente": partial(scenes.render, "lupa"),
    "palito": partial(scenes.render, "palito"),
}


def draw(name, path, factor):
    """Draws or renders the figure with this name, and writes it to a PNG file."""
    if name in RENDERED:
        image = mi.Bitmap(np.ascontiguousarray(RENDERED[name](factor), dtype=np.float32))
        image.convert(component_format=mi.Struct.Type.UInt8, srgb_gamma=True).write(str(path))
        return
    from matplotlib.figure import Figure

    function, inches = DRAWN[name]
    figure = Figure(figsize=inches, layout="constrained")
    function(figure)
    figure.savefig(path, dpi=100 * factor)


def main(arguments=None):
    parser = argparse.ArgumentParser(description="Draws the thesis's figures into a folder.")
    parser.add_argument("out", type=Path, help="folder, which is made if it does not exist")
    parser.add_argument("--size", choices=SIZES, default="medium")
    parser.add_argument("--only", nargs="+", default=[""], metavar="FIGURE", help="such as 5.1 or 5.18-path")
    parser.add_argument("--variant", default="llvm_ad_rgb", help="variant of Mitsuba (default: %(default)s)")
    options = parser.parse_args(arguments)
    names = [
        name for name in [*DRAWN, *RENDERED] if any(only in ("", name, name.split("-")[0]) for only in options.only)
    ]
    if not names:
        parser.error(f"there is no figure {' or '.join(options.only)}; there are {', '.join([*DRAWN, *RENDERED])}")
    mi.set_variant(options.variant)
    options.out.mkdir(parents=True, exist_ok=True)
    for name in names:
        start, path = time.perf_counter(), options.out / f"{name}.png"
        draw(name, path, SIZES[options.size])
        print(f"{path}  {time.perf_counter() - start:.1f} s", file=sys.stderr)


if __name__ == "__main__":
    main()
