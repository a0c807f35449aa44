"""The results of a comparison: numbers for the page, and images."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

from . import measures
from .runs import Contestant, Runs
from .scenes import Scene, Spec

if TYPE_CHECKING:
    from .study import Section

#: Values of a row of the table, besides the measures of error, that are medians of rounds.
COSTS = ("seconds", "cpu")

#: Kinds of maps, whose names end in these words: all of one kind share their scale.
MAPS = ("error", "flip", "counts")

Results = Mapping[Contestant, Runs]


def of_section(section: Section, results: Results, scale: float) -> dict[str, Any]:
    """Rows, curves and reference of one transport."""
    rows: list[dict[str, Any]] = []
    for role, contestant in section.rows.items():
        run = results[contestant]
        values = {
            name: {"median": run.median(name), "least": min(of_rounds), "most": max(of_rounds)}
            for name, of_rounds in run.values.items()
        }
        rows.append({"role": role, "name": contestant.name, "samples": run.samples, **values})
    curves: list[dict[str, Any]] = []
    for role, curve in section.curves.items():
        points = []
        for level, contestant in curve.items():
            run = results[contestant]
            medians = {name: run.median(name) for name in (*COSTS, *measures.ALL)}
            points.append({"level": level, "samples": run.samples, **medians})
        errors = [max(point["rmse"], 1e-12) for point in points]
        slopes = {cost: measures.slope([point[cost] for point in points], errors) for cost in ("samples", "cpu")}
        curves.append({"role": role, "name": section.specs[role].text, "points": points, "slopes": slopes})
    reference = section.reference
    result = {
        "transport": section.transport,
        "mean": float(np.mean(reference.image) * scale),
        "rows": rows,
        "curves": curves,
        "reference": {
            "error": reference.error * scale,
            "seconds": reference.seconds,
            "passes": reference.passes,
            "disagreement": reference.disagreement,
        },
    }
    if len(curves) == 2:
        result["equal_error"] = {
            measure: {cost: equal_error(curves[1]["points"], cost, measure, rows[0]) for cost in ("samples", "cpu")}
            for measure in ("rmse", "flip")
        }
    return result


def equal_error(points: list[dict[str, Any]], cost: str, measure: str, row: dict[str, Any]) -> dict[str, Any]:
    """The cost at which the curve ``points`` has the error of ``row``, over the cost of ``row``.

    If the curve does not reach that error, ``reached`` is false, and its highest cost counts; if it starts below that
    error, its lowest cost counts.
    """
    costs, errors = [point[cost] for point in points], [max(point[measure], 1e-12) for point in points]
    own, error = row[cost] if cost == "samples" else row[cost]["median"], max(row[measure]["median"], 1e-12)
    needed = costs[0] if error > errors[0] else measures.cost_at(error, costs, errors)
    return {"ratio": (max(costs) if needed is None else needed) / own, "reached": needed is not None}


def pictures(section: Section, results: Results, scale: float) -> dict[str, np.ndarray]:
    """Images, error maps and sample counts of the rows of the table."""
    reference = section.reference.image * scale
    images = {"reference": reference}
    for role, contestant in section.rows.items():
        image = results[contestant].image * scale
        images |= {
            f"{role}/image": image,
            f"{role}/error": measures.tone_mapped_error(image, reference),
            f"{role}/flip": measures.flip_map(image, reference),
            f"{role}/counts": results[contestant].counts,
        }
    return images


def scales(images: Mapping[str, np.ndarray]) -> dict[str, float]:
    """Kind of map -> the value at which its colours end."""
    result = {}
    for kind in MAPS:
        maps = [image for name, image in images.items() if name.endswith("/" + kind)]
        result[kind] = float(max((m.max() if kind == "counts" else np.percentile(m, 99.5)) for m in maps)) or 1.0
    return result


def difference(
    scene: Scene, spec: Spec, paths: np.ndarray, own: np.ndarray, scale: float
) -> tuple[dict[str, float], dict[str, np.ndarray]]:
    """The light that the thesis's transport leaves out, and its ambient term: ``(facts, images)``.

    ``paths``, ``own``: converged images with all paths and in the scene's own light, times ``scale``.
    """
    ambient = np.zeros_like(own)
    if scene.ambient is not None:
        bright, dark = (
            scene.contestant(spec, "scene", adaptive="none", **more).render(0)[0] for more in ({}, {"ambient": 0.0})
        )
        ambient = (bright - dark) * scale  # of the same samples, almost without noise
    left_out = paths - (own - ambient)
    numbers = {
        "paths_mean": paths.mean(),
        "own_mean": own.mean(),
        "left_out_mean": left_out.mean(),
        "ambient_mean": ambient.mean(),
        "difference_rms": np.sqrt(np.mean(np.square(paths - own))),
        "left_out_share": left_out.mean() / max(paths.mean(), 1e-30),
    }
    images = {"left_out": left_out, "ambient": ambient, "signed": paths - own}
    facts = {name: float(value) for name, value in numbers.items()}
    return facts, {f"difference/{name}": image for name, image in images.items()}
