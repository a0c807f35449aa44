"""The comparison itself: which runs, by turns, and everything that is to be said about them."""

import drjit as dr
import mitsuba as mi
import numpy as np

from ..transport import lobes
from ..transport.scene_facts import scene_flags
from . import measures, runs

#: What a row of the table says beside the measures of error.
COSTS = ("seconds", "cpu")

#: Threshold and N of the prosim integrator when neither the scene nor the contestant says any.
DEFAULTS = {"threshold": 0.006, "samples": 5}


def study(scene, a, b, *, levels=(2, 3, 4, 6, 9), rounds=5, seconds=60, cache=None, exposure=0.0,
          tell=lambda text, done: None):
    """Compares two contestants (:class:`~.scenes.Spec`) on a :class:`~.scenes.Scene`.

    ``levels``: square roots of the sample counts of the curves; ``seconds``: time for each reference, of which there is
    one for each transport; ``exposure``: in stops, for everything that is measured and shown; ``tell``: called with what is going on and the part of it that is done.

    Returns ``(facts, images)``: a dictionary of text and numbers, fit for JSON, and arrays by name.
    """
    cache = cache or runs.cache_folder()
    transport = b.transport or a.transport or "scene"
    free = [spec for spec in (a, b) if spec.transport is None]
    own_light = transport != "scene" and bool(free)

    first = contest(scene, a, b, transport, levels, seconds, cache, tell)
    groups = [first]
    if own_light:
        groups.append(contest(scene, free[0], None, "scene", levels, seconds, cache, tell))
    everyone = [c for group in groups for c in group["contestants"].values()]
    for contestant in everyone:
        contestant.scale = 2.0 ** exposure
    results = runs.by_turns(everyone, rounds, measures.ALL, lambda done: tell("rendering by turns", done))
    for group in groups:
        group["results"] = dict(zip(group["contestants"], results[:len(group["contestants"])]))
        results = results[len(group["contestants"]):]

    facts = {"scene": scene.path.name, "a": a.text, "b": b.text, "rounds": rounds, "exposure": exposure,
             "machine": runs.machine(),
             "width": int(first["reference"].image.shape[1]), "height": int(first["reference"].image.shape[0]),
             "sections": [section(group, a if k == 0 else free[0], b, k) for k, group in enumerate(groups)]}
    images = {}
    for k, group in enumerate(groups):
        images |= {f"{k}/{name}": image for name, image in pictures(group).items()}
    if own_light:
        facts["difference"], difference_images = difference(scene, free[0], groups)
        images |= difference_images
    return facts, images


def contest(scene, a, b, transport, levels, seconds, cache, tell):
    """The contestants of one transport, with their reference."""
    def at_level(spec, n):
        if not spec.counts_itself:
            return scene.contestant(spec, transport, spp=n * n)
        own = DEFAULTS | scene.settings | spec.parameters
        finer = type(spec)(spec.text)
        # The threshold goes with the count, or the curve would end where every pixel is quiet enough.
        finer.parameters |= {"samples": n, "threshold": own["threshold"] * own["samples"] / n}
        return scene.contestant(finer, transport)

    def converging(spec):
        if spec.counts_itself:
            spec = type(spec)(spec.text)
            spec.parameters |= {"adaptive": "none", "samples": 8}
            return scene.contestant(spec, transport)
        return scene.contestant(spec, transport, spp=64)

    estimators = [converging(spec) for spec in (a, b) if spec]
    reference = runs.reference(cache, f"{scene.key} {transport} {[s and s.text for s in (a, b)]}", estimators, seconds,
                               lambda done: tell("reference", done))
    contestants = {"a": scene.contestant(a, transport)}
    curves = {("a", n): at_level(a, n) for n in levels}
    if b:
        # Further, if need be, than A: it is asked what B takes for A's error.
        further = () if b.counts_itself else (round(1.6 * levels[-1]), round(2.5 * levels[-1]))
        curves |= {("b", n): at_level(b, n) for n in (*levels, *further)}
        if not b.counts_itself:
            contestants["b at equal samples"], contestants["b at equal time"] = equals(scene, contestants["a"], b, transport)
        else:
            contestants["b"] = scene.contestant(b, transport)
    contestants |= curves
    for contestant in contestants.values():
        contestant.reference = reference
    return {"transport": transport, "reference": reference, "contestants": contestants}


def equals(scene, a, b, transport):
    """Contestants ``b`` with as many samples as ``a`` really takes, and with as many as take the same time."""
    samples = max(round(float(np.mean(a.counts()))), 1)

    def processor_seconds(contestant):
        contestant.render(0)  # compiles
        return float(np.median([contestant.render(0)[1][1] for _ in range(3)]))

    wanted = processor_seconds(a)
    spp, equal = samples, scene.contestant(b, transport, spp=samples)
    for _ in range(4):  # a render has costs that do not grow with the samples, so the first guess is not the last
        ratio = wanted / processor_seconds(equal)
        if 0.9 < ratio < 1.1:
            break
        spp = min(max(round(spp * ratio), 1), 4096)
        equal = scene.contestant(b, transport, spp=spp)
    return scene.contestant(b, transport, spp=samples), equal


def spread(values):
    return {"median": float(np.median(values)), "least": float(min(values)), "most": float(max(values))}


def section(group, a, b, k):
    """What is to be said about the runs of one transport."""
    reference, results = group["reference"], group["results"]
    scale = group["contestants"]["a"].scale
    names = {"a": a.text, "b": b.text}
    rows = [{"role": role, "name": names[role[0]], "samples": run.samples, "cold": run.cold,
             **{cost: spread(run.spread(cost)) for cost in COSTS},
             **{m: spread(run.spread(m)) for m in measures.ALL}}
            for role, run in results.items() if isinstance(role, str)]
    curves = []
    for role in "ab":
        points = [{"level": n, "samples": run.samples, **{cost: run.median(cost) for cost in COSTS},
                   **{m: run.median(m) for m in measures.ALL}}
                  for (who, n), run in ((r, x) for r, x in results.items() if isinstance(r, tuple)) if who == role]
        if points:
            curves.append({"role": role, "name": names[role], "points": points, "slopes": {
                cost: measures.slope([p[cost] for p in points], [max(p["rmse"], 1e-12) for p in points])
                if len(points) > 1 else None for cost in ("samples", "cpu")}})
    result = {"transport": group["transport"], "mean": float(np.mean(reference.image) * scale), "rows": rows, "curves": curves,
              "reference": {"error": reference.error * scale, "seconds": reference.seconds, "passes": reference.passes,
                            "disagreement": reference.disagreement, "mean_difference": reference.mean_difference}}
    if k == 0 and len(curves) == 2:
        best = rows[0]
        result["equal_error"] = {
            m: {cost: ratio(curves[1]["points"], cost, m, best) for cost in ("samples", "cpu")}
            for m in ("rmse", "tone_mapped_rmse", "percentile99", "flip")}
    return result


def ratio(points, cost, measure, row):
    """How many times as much of a cost the curve ``points`` takes for the error of ``row``; where it does not get there,
    ``reached`` is false and the ratio that of its last point."""
    costs = [p[cost] for p in points]
    errors = [max(p[measure], 1e-12) for p in points]
    own = row[cost] if cost == "samples" else row[cost]["median"]
    wanted = row[measure]["median"]
    if wanted > errors[0]:  # the least that was run is better already
        return {"ratio": costs[0] / own, "reached": True}
    needed = measures.cost_at(max(wanted, 1e-12), costs, errors)
    return {"ratio": (max(costs) if needed is None else needed) / own, "reached": needed is not None}


def pictures(group):
    """Images, error maps and sample counts of the rows of the table."""
    scale = group["contestants"]["a"].scale
    reference = group["reference"].image * scale
    result = {"reference": reference}
    for role, run in group["results"].items():
        if isinstance(role, str):
            image = run.image * scale
            result |= {f"{role}/image": image, f"{role}/error": measures.tone_mapped_error(image, reference),
                       f"{role}/flip": measures.flip_map(image, reference), f"{role}/counts": run.counts}
    return result


def difference(scene, spec, groups):
    """What the thesis's transport leaves out, and what it puts in its place: ``(facts, images)``."""
    scale = groups[0]["contestants"]["a"].scale
    paths, own = (group["reference"].image * scale for group in groups)
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
    return {
        "paths_mean": float(paths.mean()), "own_mean": float(own.mean()), "left_out_mean": float(left_out.mean()),
        "ambient_mean": float(ambient.mean()), "difference_mean": float((paths - own).mean()),
        "difference_rms": float(np.sqrt(np.mean(np.square(paths - own)))),
        "left_out_share": float(left_out.mean() / paths.mean()) if paths.mean() > 0 else 0.0,
        "effects": {"interreflection": bool(diffuse), "caustics": bool(specular and diffuse),
                    "light of the background": bool(scene.background is not None
                                                    and dr.any(mi.Float(scene.background.mean()) > 0)),
                    "ambient": scene.ambient is not None},
    }, {"difference/left_out": left_out, "difference/ambient": ambient, "difference/signed": paths - own}
