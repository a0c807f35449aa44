"""Workarounds for errors of Mitsuba 3.9, mostly of BSDFs that ignore the type mask of the ``BSDFContext``.

``mask``
    samples only its null lobe if the type mask lacks the null lobe. So :func:`sample` requests the null lobe, too.
``blendbsdf``
    adds the density of smooth lobes to the probability of an ideal lobe, and takes a :func:`failed` sample of one BSDF
    for a sample of the other, so that the image loses or gains light. So :func:`sample` chooses one of the blended
    BSDFs itself (:func:`_sample_mixture`). It cannot do so within a ``bumpmap`` or ``normalmap``: see
    :func:`warn_of_blends_in_maps`. ``blendbsdf`` also omits the derivative of ideal lobes with respect to the blending
    weight; :func:`sample` adds it.
``plastic``, ``thindielectric``
    divide by the probability of an ideal lobe, and by its derivative by the reflectances or by ``eta``, which biases or
    cancels that of the image. So :func:`sample` removes this derivative.
``principled``, ``principledthin``, ``hair``
    evaluate and sample all lobes together, whatever the type mask is. So light sampling evaluates all lobes together,
    and :func:`belongs_to` assigns each sample to one lobe.
``Scene.ray_intersect(skip_area_emitters)``
    measures distances from the last skipped emitter, and ignores ``maxt``: see :func:`past_emitters`.
``Scene.ray_intersect(coherent=True)``
    is fast, but its choice between two triangles at a common edge depends on the other rays that are traced at the same
    time, so the image would depend on the crop window: see :func:`first_hit`.
``rectangle``
    has no bounding box where it is merged with other shapes of its BSDF. So the box of a scene may lack walls, through
    which lamps at infinity then shine: see :func:`repair_boxes`.
``area`` with a texture
    loses light in Mitsuba's own integrators (:mod:`..light.emitter_methods`): see :func:`warn_of_lost_light`.

A workaround is needless as soon as the oldest allowed Mitsuba behaves otherwise.
"""

from __future__ import annotations

import functools
import operator
from collections.abc import Iterator

import drjit as dr
import mitsuba as mi

from ..compat import (
    AREA,
    BLEND,
    CHOOSERS,
    EVALUATED_TOGETHER,
    INSTANCE,
    MAPS,
    MASK,
    PATH,
    PRINCIPLED,
    ROUGH_PLASTIC,
    emitter_samples,
    exposed,
    is_users,
    names_of,
    object_transform,
    warn,
    warn_of,
)
from ..light.emitter_methods import loses_light
from ..masks import but_not, idle
from ..optics.nested import all_bsdfs, all_within, leaves, parts
from . import lobes
from .lobes import LobePoint

#: The class of merged meshes, and their parameter for the normals.
MERGED, NORMALS = "Mesh", "vertex_normals"

#: Barycentric coordinate below which a hit is near an edge of its triangle.
EDGE = 1e-3

#: Distance from a surface at which Mitsuba starts rays, in widths of the scene, from which on light leaks: a
#: closed room is then 0.3 % too bright.
COARSE = 0.01


def repair_boxes(scene: mi.Scene) -> None:
    """Corrects the bounding boxes of merged meshes, of ``scene`` and of its lamps at infinity, where rectangles are
    missing.
    """
    wrong = []
    for shape in scene.shapes():
        if shape.class_name() == MERGED:
            before = str(shape.bbox())
            shape.recompute_bbox()
            wrong += [shape] if str(shape.bbox()) != before else []
    for shape in wrong:
        parameters = exposed(shape)
        normals = dr.copy(parameters[NORMALS]) if NORMALS in parameters else ()
        shape.parameters_changed(["vertex_positions"])  # so that the scene asks for the box; normals change, too
        if len(normals):
            parameters[NORMALS] = normals
            parameters.update()
    if wrong:
        scene.parameters_changed([])
        for emitter in scene.emitters():
            if mi.has_flag(emitter.flags(), mi.EmitterFlags.Infinite):
                emitter.set_scene(scene)


def warn_of_lost_light(scene: mi.Scene, integrator: mi.SamplingIntegrator) -> None:
    """Warns of emitters and BSDFs whose light Mitsuba's ``integrator``, or an integrator nested in it (in ``aov`` or
    ``moment``), may lose or increase.
    """
    warn_of_missing_flags(scene)
    warn_of_coarse_rays(scene)
    integrators = [integrator, *(part for part in parts(integrator).values() if isinstance(part, mi.Integrator))]
    warn_of(
        (e for e in scene.emitters() if e.class_name() == AREA and loses_light(e)),
        "{} may light too little: Mitsuba's area cannot sample this shape, or loses points of the texture. Use "
        "prosim_area in its place.",
    )
    if (times := max(map(emitter_samples, integrators))) > 1:
        warn_of(
            (e for e in scene.emitters() if mi.has_flag(e.flags(), mi.EmitterFlags.Delta)),
            f"{{}} will be {times} times too bright: Mitsuba's direct multiplies the light of points and directions by "
            "its emitter_samples. Give emitter_samples = 1.",
        )
    warn_of(
        (bsdf for bsdf in all_bsdfs(scene) if mixes_wrongly(mi.BSDFContext(), bsdf)),
        "{} may reflect too little or too much light: Mitsuba's blendbsdf adds the density of smooth lobes to that of "
        "mirrors, clear glass and holes, and takes samples that one of its BSDFs discards for samples of the other, "
        'such as rough glass. Render with "prosim".',
    )
    # ``path`` returns black if the ray has met nothing but holes; it counts a sky as something, unless it hides it.
    blind = [one for one in integrators if one.class_name() == PATH and (one.hide_emitters or not scene.environment())]
    if blind:
        warn_of(
            (one for one in all_bsdfs(scene) if all(lobes.has_any(one.flags(), kind) for kind in ("Null", "Smooth"))),
            "{} may reflect too little light: Mitsuba's path forgets the light of the surface around a hole that shows "
            'nothing behind it. Render with "prosim" or "prb".',
        )


def warn_of_wrong_derivatives(scene: mi.Scene) -> None:
    """Warns of parameters whose derivatives are wrong: Mitsuba's BSDFs compute tables from them, which have no
    derivatives, or probabilities of ideal lobes that :func:`sample` cannot see in a ``bumpmap`` or ``normalmap``; and
    Mitsuba's instances move without their normals and texture coordinates.
    """
    for bsdf in dict.fromkeys(part for one in all_bsdfs(scene) for part in _within(one, ROUGH_PLASTIC)):
        if names := [name for name in ("alpha", "eta") if dr.grad_enabled(mi.traverse(bsdf)[name])]:
            warn(
                f"the derivatives by {' and '.join(names)} of {names_of([bsdf])} are wrong: Mitsuba's "
                "roughplastic tabulates its transmittance without them. Use principled or prosim_composite."
            )
    for bsdf in dict.fromkeys(part for one in all_bsdfs(scene) for part in _within(one, PRINCIPLED)):
        values = {name: mi.traverse(bsdf).get(f"{name}.value") for name in ("sheen", "clearcoat")}
        if names := [name for name, value in values.items() if dr.grad_enabled(value) and dr.all(value == 0)]:
            warn(
                f"the derivatives by {' and '.join(names)} of {names_of([bsdf])} are 0, because Mitsuba's "
                "principled has no such lobe where its weight is 0. Begin with a small weight, such as 0.01."
            )
    instances = (shape for shape in scene.shapes() if shape.class_name() == INSTANCE)
    warn_of(
        (one for one in instances if dr.grad_enabled(object_transform(one))),
        "derivatives by to_world of {} are wrong if the instance turns or has curves or textures: Mitsuba's instance "
        "keeps normals and texture coordinates. Move the shapes of its shapegroup.",
    )
    maps = ((bsdf, one) for bsdf in all_bsdfs(scene) for one in _within(bsdf, *MAPS))
    warn_of(
        (bsdf for bsdf, one in maps if any(map(_has_derivatives, _hidden_choices(one)))),
        "derivatives by parameters of {} may be wrong: Mitsuba's mask and blendbsdf hide within a bumpmap or normalmap "
        "how they choose mirrors, glass and holes. Put the map into the mask or blendbsdf, around each of its BSDFs.",
    )


def warn_of_undivided_lobes(scene: mi.Scene) -> None:
    """Warns of derivatives that change the density of a BSDF whose diffuse and specular lobes are evaluated together:
    those of the shares of its samples that belong to each lobe (:func:`belongs_to`) are missing.
    """
    si = dr.zeros(mi.SurfaceInteraction3f)
    si.wi = si.n = mi.Vector3f(0, 0, 1)
    si.sh_frame = mi.Frame3f(si.n)
    bsdfs = [one for one in all_bsdfs(scene) if lobes.has_any(one.flags(), *lobes.DIFFUSE) and is_inseparable(one)]
    specular = (one for one in bsdfs if lobes.has_any(one.flags(), *lobes.SPECULAR))
    context = mi.BSDFContext()
    warn_of(
        (b for b in specular if dr.grad_enabled(eval_pdf(context, b, si, si.wi, True)[1])),
        "derivatives by parameters of {} are wrong: rays follow its specular lobe with a probability that Mitsuba does "
        "not tell. Set diffuse_bounces = -1 to follow all its rays.",
    )


def _hidden_choices(bsdf: mi.BSDF) -> Iterator[mi.Object]:
    """Yields what a ``mask`` or ``blendbsdf`` in ``bsdf`` chooses ideal lobes by: BSDFs, and weights of blends."""
    for mixture in _within(bsdf, MASK, BLEND):
        yield from _within(mixture, *CHOOSERS)
        if mixture.class_name() == BLEND and lobes.has_any(mixture.flags(), *lobes.IDEAL):
            yield parts(mixture)["weight"]


def _has_derivatives(thing: mi.Object) -> bool:
    parameters = mi.traverse(thing)
    return any(dr.grad_enabled(parameters[name]) for name in parameters.keys())  # noqa: SIM118 (not all are read)


def warn_of_blends_in_maps(scene: mi.Scene, lobe: mi.BSDFContext) -> None:
    """Warns of a ``bumpmap`` or ``normalmap`` around a ``blendbsdf`` that :func:`mixes_wrongly` the lobes ``lobe``."""
    maps = {bsdf: [one for one in all_within(bsdf) if one.class_name() in MAPS] for bsdf in all_bsdfs(scene)}
    warn_of(
        (bsdf for bsdf in maps if any(mixes_wrongly(requested_lobes(lobe, one), one) for one in maps[bsdf])),
        "{} may reflect too little or too much light: Mitsuba samples a blendbsdf of a mirror, glass or a hole with "
        "another surface wrongly within a bumpmap or normalmap. Put the map into the blendbsdf, around each of its "
        "BSDFs.",
    )


def warn_of_coarse_rays(scene: mi.Scene) -> None:
    """Warns of a scene that is so small, or so far from the origin, that rays start far above its surfaces."""
    box = scene.bbox()
    width, away = dr.max(box.extents()), dr.max(dr.maximum(dr.abs(box.min), dr.abs(box.max)))
    gap = float(mi.math.RayEpsilon * (1 + away))  # of mi.Interaction3f.spawn_ray
    if width > 0 and gap > COARSE * width:
        warn(
            f"light is missing or leaks, because rays start {gap:.2g} above a surface, and the scene is "
            f"{float(width):.2g} wide. Write it in smaller units, or nearer to the origin."
        )


def warn_of_missing_flags(scene: mi.Scene) -> None:
    """Warns of BSDFs of users without ``m_flags``, by which integrators know what a surface scatters, or without
    ``m_components``, from which ``twosided`` computes them.
    """
    flagless = [one for bsdf in all_bsdfs(scene) for one in all_within(bsdf) if not int(one.flags())]
    if lost := sorted({type(one).__name__ for bsdf in flagless for one in of_users(bsdf)}):
        warn(
            f"surfaces of {', '.join(lost)} scatter no light or too little: their class sets no m_flags or "
            "m_components. Set both in __init__, such as m_flags = BSDFFlags.DiffuseReflection | BSDFFlags.FrontSide "
            "and m_components = [m_flags]."
        )


def warn_of_unused_render(integrator: mi.SamplingIntegrator) -> None:
    """Warns if a user's class of integrators has its own ``render`` or ``sample_rays``: only ``sample`` is called."""
    bases = reversed(type(integrator).__mro__)
    owners = {name: base.__module__.partition(".")[0] for base in bases for name in vars(base)}
    own = [name for name in ("render", "sample_rays") if owners.get(name, "mitsuba") != "mitsuba"]
    if own and is_users(integrator):
        warn(
            f"the method {own[0]}() of {type(integrator).__name__} is not called, and this image may be "
            "another: the mean of what sample() returns for the sensor's rays. Use mi.render for that of the class."
        )


def _within(bsdf: mi.BSDF, *names: str) -> Iterator[mi.BSDF]:
    return (one for one in all_within(bsdf) if one.class_name() in names)


def mixes_wrongly(lobe: mi.BSDFContext, bsdf: mi.BSDF) -> bool:
    """Tells whether ``bsdf`` has a ``blendbsdf`` that mixes smooth lobes of ``lobe`` with ideal ones, or whose other
    BSDF may have a value where a sample of the first has :func:`failed`: if one transmits light, or is one-sided and
    the other is not.
    """
    return any(_mixes_wrongly(lobe, one) for one in _within(bsdf, BLEND))


def _mixes_wrongly(lobe: mi.BSDFContext, blend: mi.BSDF) -> bool:
    flags = int(blend.flags()) & lobe.type_mask
    if not lobes.has_any(flags, *lobes.SMOOTH):
        return False
    bsdfs = (part for part in parts(blend).values() if isinstance(part, mi.BSDF))
    sides = {mi.has_flag(bsdf.flags(), mi.BSDFFlags.BackSide) for bsdf in bsdfs}
    return len(sides) > 1 or bool(lobes.has_any(flags, *lobes.IDEAL) or lobes.has_any(blend.flags(), *lobes.BOTH_SIDES))


def failed(
    si: mi.SurfaceInteraction3f, bs: mi.BSDFSample3f, weight: mi.Spectrum, value: mi.Spectrum | float
) -> mi.Bool:
    """Tells whether the BSDF sample ``bs`` has no ``weight`` because its direction is on the wrong side for its lobe,
    or though the BSDF has a ``value`` there. Mitsuba's rough glass, for example, leaves such a sample its density.
    """
    through = mi.Frame3f.cos_theta(si.wi) * mi.Frame3f.cos_theta(bs.wo) < 0
    sides = dr.select(through, mi.UInt32(lobes.mask(*lobes.BOTH_SIDES)), lobes.mask(*lobes.ONE_SIDE))
    kinds = bs.sampled_type & (sides | lobes.mask(*lobes.IDEAL))
    return dr.all(mi.Spectrum(weight) == 0) & (dr.any(mi.Spectrum(value) != 0) | (kinds == 0))


def sample(
    lobe: mi.BSDFContext,
    bsdf: mi.BSDF,
    si: mi.SurfaceInteraction3f,
    u: LobePoint,
    active: mi.Bool,
    attached: bool = False,
) -> tuple[mi.BSDFSample3f, mi.Spectrum]:
    """Returns ``(bs, weight)`` as ``mi.BSDF.sample``, with the workarounds for ``mask`` and ``blendbsdf``. ``bs.pdf``
    is 0 if the BSDF sampled a lobe that was not requested. ``attached`` tells whether derivatives are wanted.
    """
    lobe = requested_lobes(lobe, bsdf)
    blends = (int(one.flags()) & lobe.type_mask for one in _within(bsdf, BLEND))
    chooses, masked = attached and any(_within(bsdf, *CHOOSERS)), any(_within(bsdf, MASK))
    # Of ideal lobes alone, ``blendbsdf`` lacks only the derivative. A ``mask`` hides the probabilities within it.
    lacks = attached and any(lobes.has_any(flags, *lobes.IDEAL) for flags in blends)
    if (lacks or (chooses and masked) or mixes_wrongly(lobe, bsdf)) and bsdf.class_name() not in MAPS:
        bs, weight = _sample_mixture(lobe, bsdf, si, u, active, attached)
    else:
        bs, weight = bsdf.sample(_with_null_of_mask(lobe, bsdf), si, *u, active)
        if chooses and not masked:
            weight *= dr.relative_grad(dr.select(bs.pdf > 0, bs.pdf, 1))
    if users := of_users(bsdf):
        flags = functools.reduce(operator.or_, (int(one.flags()) for one in users))
        flags = flags & lobes.mask(*lobes.SMOOTH) or flags
        bs.sampled_type = dr.select(bs.sampled_type == 0, mi.UInt32(flags), bs.sampled_type)
    bs.pdf = dr.select((bs.sampled_type & lobe.type_mask) != 0, bs.pdf, 0)
    return bs, mi.Spectrum(weight)


def _sample_mixture(
    lobe: mi.BSDFContext, bsdf: mi.BSDF, si: mi.SurfaceInteraction3f, u: LobePoint, active: mi.Bool, attached: bool
) -> tuple[mi.BSDFSample3f, mi.Spectrum]:
    """Samples one of the :func:`.leaves` of a mixture. A sample of a smooth lobe has the density and the value of all
    leaves together.
    """
    (choice, point), begin, share = u, mi.Float(0), mi.Float(1)
    bs, weight = dr.zeros(mi.BSDFSample3f), mi.Spectrum(0)
    for leaf in leaves(bsdf, si, active):
        end = begin + dr.detach(leaf.share)
        chosen = active & (choice >= begin) & (choice < end)
        # A random number that is independent of this choice.
        rest = dr.clip((choice - begin) / dr.select(end > begin, end - begin, 1), 0, 1 - 2**-24)
        if leaf.bsdf is None:
            one, own = dr.zeros(mi.BSDFSample3f), mi.Spectrum(1)
            one.wo, one.pdf, one.eta, one.sampled_type = -si.wi, 1, 1, lobes.mask("Null")
        else:
            one, own = sample(lobe, leaf.bsdf, leaf.si, (rest, point), chosen, attached)
            # Of several lobes on the same side, only the value tells.
            value = evaluate(lobe, leaf.bsdf, leaf.si, one.wo, chosen) if is_inseparable(leaf.bsdf) else 0.0
            one.pdf = dr.select(failed(leaf.si, one, own, value), 0, one.pdf)
            one.wo.z = dr.select(leaf.si.wi.z == si.wi.z, one.wo.z, -one.wo.z)
        bs, weight, share = dr.select(chosen, (one, own, leaf.share), (bs, weight, share))
        begin = end
    ideal = lobes.has_any(bs.sampled_type, *lobes.IDEAL)
    smooth = but_not(active & (bs.pdf > 0), ideal)
    f, pdf = eval_pdf(lobe, bsdf, si, bs.wo, smooth)
    weight = dr.select(smooth, f / dr.select(pdf > 0, pdf, 1), weight) * dr.select(ideal, dr.relative_grad(share), 1)
    bs.pdf = dr.select(ideal, bs.pdf * dr.detach(share), dr.select(smooth, pdf, 0))
    return bs, weight


def _with_null_of_mask(lobe: mi.BSDFContext, bsdf: mi.BSDF) -> mi.BSDFContext:
    """Returns ``lobe``, with null lobes added if ``bsdf`` is or contains a ``mask``."""
    null = lobes.mask("Null") if any(_within(bsdf, MASK)) else 0
    return mi.BSDFContext(lobe.mode, lobe.type_mask | null, lobe.component)


def eval_pdf(
    lobe: mi.BSDFContext, bsdf: mi.BSDF, si: mi.SurfaceInteraction3f, wo: mi.Vector3f, active: mi.Bool
) -> tuple[mi.Spectrum, mi.Float]:
    """Returns the value of ``lobe`` times the cosine of ``wo``, and the density of :func:`sample`."""
    lobe = requested_lobes(lobe, bsdf)
    value, pdf = bsdf.eval_pdf(_with_null_of_mask(lobe, bsdf), si, wo, active)
    return mi.Spectrum(value), mi.Float(pdf)  # a user's BSDF may return numbers of Python


def evaluate(
    lobe: mi.BSDFContext, bsdf: mi.BSDF, si: mi.SurfaceInteraction3f, wo: mi.Vector3f, active: mi.Bool
) -> mi.Spectrum:
    """Returns the value of :func:`eval_pdf` alone."""
    return mi.Spectrum(bsdf.eval(requested_lobes(lobe, bsdf), si, wo, active))


def requested_lobes(lobe: mi.BSDFContext, bsdf: mi.BSDF) -> mi.BSDFContext:
    """Returns ``lobe``, or all lobes if ``bsdf`` can only evaluate all its lobes together."""
    return mi.BSDFContext(lobe.mode) if is_inseparable(bsdf) else lobe


def is_inseparable(bsdf: mi.BSDF) -> bool:
    """Tells whether ``bsdf``, or a BSDF nested in it, can only evaluate all its lobes together: the classes
    :data:`.EVALUATED_TOGETHER` of Mitsuba, BSDFs with several kinds of lobes (reflected, refracted, diffuse) in one
    component, and those of users that are not ideal, of which few regard the type mask.
    """

    def together(one: mi.BSDF) -> bool:
        components = [int(one.flags(i)) for i in range(one.component_count())]
        whole = is_users(one) and lobes.has_any(one.flags(), *lobes.SMOOTH)
        return one.class_name() in EVALUATED_TOGETHER or any(map(_mixed, [int(one.flags())] if whole else components))

    return any(map(together, all_within(bsdf)))


def _mixed(flags: int) -> bool:
    """Tells whether ``flags`` have several kinds of lobes."""
    return sum(bool(lobes.has_any(flags, *kind)) for kind in (lobes.REFLECTED, lobes.REFRACTED, lobes.DIFFUSE)) > 1


def of_users(bsdf: mi.BSDF) -> list[mi.BSDF]:
    """Returns ``bsdf`` and the BSDFs nested in it whose classes are those of users (:func:`.is_users`). They may ignore
    the type mask, and leave ``sampled_type`` 0, as Mitsuba's own integrators accept.
    """
    return [one for one in all_within(bsdf) if is_users(one)]


def belongs_to(lobe: mi.BSDFContext, wi: mi.Vector3f, bs: mi.BSDFSample3f) -> mi.Bool:
    """Tells whether ``bs``, a sample of an inseparable BSDF, belongs to ``lobe``: to the diffuse, the refracted
    (specular, and through the surface) or the reflected lobe.
    """
    specular = lobes.has_any(bs.sampled_type, *lobes.SPECULAR)
    diffuse = but_not(lobes.has_any(bs.sampled_type, *lobes.DIFFUSE), specular)
    through = mi.Frame3f.cos_theta(wi) * mi.Frame3f.cos_theta(bs.wo) < 0
    side = dr.select(through, mi.UInt32(lobes.mask(*lobes.REFRACTED)), lobes.mask(*lobes.REFLECTED))
    return (dr.select(diffuse, lobes.mask(*lobes.DIFFUSE), side) & lobe.type_mask) != 0


def first_hit(scene: mi.Scene, ray: mi.Ray3f, coherent: mi.Bool, active: mi.Bool) -> mi.PreliminaryIntersection3f:
    """Returns the first intersection of ``ray``, independent of other rays that are traced at the same time.

    ``coherent`` tells which rays are similar to those in the neighbouring lanes; they are traced faster, and again if
    they hit a triangle near an edge.
    """
    hit = scene.ray_intersect_preliminary(ray, coherent, active=active)
    u, v = hit.prim_uv
    distance = dr.minimum(dr.minimum(dr.abs(u), dr.abs(v)), dr.abs(1 - u - v))
    # Both coordinates of a sphere are 0.
    near_edge = active & coherent & hit.is_valid() & (distance < EDGE) & ((u != 0) | (v != 0))

    def again(_: mi.PreliminaryIntersection3f, near_edge: mi.Bool) -> mi.PreliminaryIntersection3f:
        return scene.ray_intersect_preliminary(ray, False, active=near_edge)

    return dr.if_stmt((hit, near_edge), near_edge, again, lambda hit, _: hit)


def past_emitters(
    scene: mi.Scene, ray: mi.Ray3f, si: mi.SurfaceInteraction3f, active: mi.Bool, attached: bool
) -> mi.SurfaceInteraction3f:
    """Returns the first surface interaction of the camera ray ``ray`` that is not on a light source; ``si``, the first
    one, in lanes that are not ``active``. Its distance ``t`` begins at the last light source that the ray passed.
    ``attached`` tells whether derivatives are wanted.
    """

    def on_emitter(si: mi.SurfaceInteraction3f, active: mi.Bool) -> mi.Bool:
        met = active & si.is_valid()
        return met if idle(met) else met & si.shape.is_emitter()

    def beyond(o: mi.Point3f) -> mi.Ray3f:
        rest = mi.Ray3f(ray)
        rest.o, rest.maxt = o, ray.maxt - dr.dot(o - ray.o, ray.d)
        return rest

    def step(o: mi.Point3f, blocked: mi.Bool) -> tuple[mi.Point3f, mi.Bool]:
        front = scene.ray_intersect(beyond(o), int(mi.RayFlags.Minimal), False, blocked)
        blocked = on_emitter(front, blocked)
        return dr.select(blocked, front.spawn_ray(ray.d).o, o), blocked

    hidden = on_emitter(si, active)
    with dr.suspend_grad(when=attached):
        o, _ = dr.while_loop((mi.Point3f(ray.o), hidden), lambda o, blocked: blocked, step, labels=("o", "blocked"))
    if attached:
        o = dr.replace_grad(o, ray.o + ray.d * dr.norm(o - dr.detach(ray.o)))
    return dr.select(hidden, scene.ray_intersect(beyond(o), hidden), si)
