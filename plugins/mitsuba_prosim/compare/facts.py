"""What is to be said about the runs of a comparison: numbers for the page, and images."""

from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from ..transport import lobes
from ..transport.context import scene_flags
from . import measures
from .runs import Part
from .scenes import Scene, Spec

#: What a row of the table says beside the measures of error.
COSTS = ("seconds", "cpu")

#: Kinds of maps, whose names end in these words: all of one kind share their scale.
MAPS = ("error", "flip", "counts")


def spread(values: list[float]) -> dict[str, float]:
    """Median, least and most."""
    return {"median": float(np.median(values)), "least": float(min(values)), "most": float(max(values))}


def section(part: Part, a: Spec, b: Spec, k: int, scale: float) -> dict[str, Any]:
    """What is to be said about the runs of one transport, the ``k``-th."""
    reference = part.reference
    names = {"a": a.text, "b": b.text}
    rows = [
        {
            "role": role,
            "name": names[role[0]],
            "samples": run.samples,
            "cold": run.cold,
            **{what: spread(run.spread(what)) for what in (*COSTS, *measures.ALL)},
        }
        for role, run in part.rows.items()
    ]
    curves: list[dict[str, Any]] = []
    for role, curve in part.curves.items():
        points = [
            {"level": n, "samples": run.samples, **{what: run.median(what) for what in (*COSTS, *measures.ALL)}}
            for n, run in curve.items()
        ]
        errors = [max(p["rmse"], 1e-12) for p in points]
        curves.append(
            {
                "role": role,
                "name": names[role],
                "points": points,
                "slopes": {
                    cost: measures.slope([p[cost] for p in points], errors) if len(points) > 1 else None
                    for cost in ("samples", "cpu")
                },
            }
        )
    result = {
        "transport": part.transport,
        "mean": float(np.mean(reference.image) * scale),
        "rows": rows,
        "curves": curves,
        "reference": {
            "error": reference.error * scale,
            "seconds": reference.seconds,
            "passes": reference.passes,
            "disagreement": reference.disagreement,
            "mean_difference": reference.mean_difference,
        },
    }
    if k == 0 and len(curves) == 2:
        result["equal_error"] = {
            m: {cost: equal_error(curves[1]["points"], cost, m, rows[0]) for cost in ("samples", "cpu")}
            for m in ("rmse", "tone_mapped_rmse", "percentile99", "flip")
        }
    return result


def equal_error(points: list[dict[str, Any]], cost: str, measure: str, row: dict[str, Any]) -> dict[str, Any]:
    """How many times as much of a cost the curve ``points`` takes for the error of ``row``.

    Where it does not get there, ``reached`` is false and the ratio that of its dearest point; where the least that was
    run is better already, the ratio is that of its first.
    """
    costs = [p[cost] for p in points]
    own = row[cost] if cost == "samples" else row[cost]["median"]
    found = measures.relative_cost(own, row[measure]["median"], costs, [max(p[measure], 1e-12) for p in points])
    ratio, reached = found or (costs[0] / own, True)
    return {"ratio": ratio, "reached": reached}


def pictures(part: Part, scale: float) -> dict[str, np.ndarray]:
    """Images, error maps and sample counts of the rows of the table."""
    reference = part.reference.image * scale
    result = {"reference": reference}
    for role, run in part.rows.items():
        image = run.image * scale
        result |= {
            f"{role}/image": image,
            f"{role}/error": measures.tone_mapped_error(image, reference),
            f"{role}/flip": measures.flip_map(image, reference),
            f"{role}/counts": run.counts,
        }
    return result


def scales(images: dict[str, np.ndarray]) -> dict[str, float]:
    """Kind of map -> the value at which its colours end."""
    result = {}
    for kind in MAPS:
        maps = [image for name, image in images.items() if name.endswith("/" + kind)]
        result[kind] = float(max((m.max() if kind == "counts" else np.percentile(m, 99.5)) for m in maps)) or 1.0
    return result


def difference(
    scene: Scene, spec: Spec, paths: np.ndarray, own: np.ndarray, scale: float
) -> tuple[dict[str, Any], dict[str, np.ndarray]]:
    """What the thesis's transport leaves out, and what it puts in its place: ``(facts, images)``.

    ``paths``, ``own``: converged images with every path and in the scene's own light, times ``scale``.
    """
    with_ambient = scene.contestant(spec, "scene", adaptive="none").render(0)[0]
    ambient = np.zeros_like(own)
    if scene.ambient is not None:
        dark = scene.contestant(spec, "scene", adaptive="none", ambient=0.0).render(0)[0]
        # The same samples: their difference is the ambient term alone, all but free of noise.
        ambient = (with_ambient - dark) * scale
    left_out = paths - (own - ambient)
    flags = scene_flags(scene.scene())
    specular = lobes.has_any(flags, "GlossyReflection", "DeltaReflection", "GlossyTransmission", "DeltaTransmission")
    diffuse = lobes.has_any(flags, "DiffuseReflection", "DiffuseTransmission")
    followed = bool((scene.settings.get(spec.integrator, {}) | spec.parameters).get("caustics"))
    return {
        "paths_mean": float(paths.mean()),
        "own_mean": float(own.mean()),
        "left_out_mean": float(left_out.mean()),
        "ambient_mean": float(ambient.mean()),
        "difference_mean": float((paths - own).mean()),
        "difference_rms": float(np.sqrt(np.mean(np.square(paths - own)))),
        "left_out_share": float(left_out.mean() / paths.mean()) if paths.mean() > 0 else 0.0,
        "effects": {
            "interreflection": bool(diffuse),
            "caustics": bool(specular and diffuse) and not followed,
            "light of the background": bool(
                scene.background is not None and dr.any(mi.Float(scene.background.mean()) > 0)
            ),
            "ambient": scene.ambient is not None,
        },
    }, {"difference/left_out": left_out, "difference/ambient": ambient, "difference/signed": paths - own}
