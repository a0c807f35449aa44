"""Angular distributions of a source's intensity (section 5.2, figure 5.6): uniform, cone, spot.

A cone of half-opening alpha is the constant 1 for beta <= alpha; a spot is cos^n(beta), cut off at alpha (90 degrees by
default). beta is the angle between the source's direction and that of the light. Both are described by the cosine of
alpha and by the exponent n, which is None for a cone.
"""

import drjit as dr
import mitsuba as mi

from ..parameters import reject

DISTRIBUTIONS = ("uniform", "cone", "spot")


def read_distribution(props):
    """Reads ``distribution``, ``direction``, ``angle`` and ``exponent`` of a plugin and checks them.

    Returns them as a dictionary of values for the plugin's attributes: the name, an `mi.Vector3f`, and two `mi.Float`;
    None where the distribution has no such parameter. Raises ValueError for what is missing, wrong or without effect.
    """
    name = props.get("distribution", "uniform")
    if name not in DISTRIBUTIONS:
        raise reject(props, "distribution", name, "one of " + ", ".join(DISTRIBUTIONS))
    needless = {"uniform": ("direction", "angle", "exponent"), "cone": ("exponent",), "spot": ()}[name]
    for parameter in needless:
        if parameter in props:
            raise reject(props, parameter, props[parameter], f'no "{parameter}" with distribution {name}')
    if name == "uniform":
        return {"distribution": name, "direction": None, "angle": None, "exponent": None}

    direction = mi.ScalarVector3f(props.get("direction", mi.ScalarVector3f(0, -1, 0)))
    if not 0 < dr.norm(direction) < float("inf"):
        raise reject(props, "direction", list(direction), "a vector of finite length > 0")
    widest = 90 if name == "spot" else 180
    angle = props.get("angle", 90.0 if name == "spot" else None)
    if angle is None or not 0 < angle <= widest:
        raise reject(props, "angle", angle, f"a number of degrees > 0 and <= {widest}")
    exponent = props.get("exponent") if name == "spot" else None
    if name == "spot" and (exponent is None or not 0 <= exponent < float("inf")):
        raise reject(props, "exponent", exponent, "a number >= 0")
    return {
        "distribution": name,
        "direction": mi.Vector3f(direction),
        "angle": mi.Float(angle),
        "exponent": None if exponent is None else mi.Float(exponent),
    }


def falloff(cos_beta, cos_angle, exponent=None):
    """Intensity over that on the axis, in [0, 1]."""
    inside = cos_beta >= cos_angle
    if exponent is None:
        return dr.select(inside, mi.Float(1), mi.Float(0))
    # The floor keeps the power, and its derivatives, finite behind the source.
    return dr.select(inside & (cos_beta > 0), dr.power(dr.maximum(cos_beta, 1e-6), exponent), mi.Float(0))


def total(cos_angle, exponent=None):
    """Integral of `falloff` over all directions, in steradians."""
    if exponent is None:
        return dr.two_pi * (1 - cos_angle)
    return dr.two_pi * (1 - dr.power(dr.maximum(cos_angle, 1e-6), exponent + 1)) / (exponent + 1)


def sample_falloff(sample2, cos_angle, exponent=None):
    """Draws a direction about the z axis with density `falloff` / `total`."""
    if exponent is None:
        return mi.warp.square_to_uniform_cone(sample2, cos_angle)
    least = dr.power(dr.maximum(cos_angle, 1e-6), exponent + 1)
    cos = dr.power(dr.maximum(1 - sample2.x * (1 - least), 1e-35), 1 / (exponent + 1))
    sin_phi, cos_phi = dr.sincos(dr.two_pi * sample2.y)
    sin = dr.safe_sqrt(1 - dr.square(cos))
    return mi.Vector3f(sin * cos_phi, sin * sin_phi, cos)


def towards(source, d):
    """Intensity of ``source``, a plugin with the attributes of `read_distribution`, in the direction ``d``, over that on
    its axis."""
    if source.angle is None:
        return mi.Float(1)
    return falloff(dr.dot(d, dr.normalize(source.direction)), _cos_angle(source), source.exponent)


def sample_towards(source, sample2):
    """Draws a direction of light in proportion to the intensity of ``source``: ``(d, total)``, `total` as above."""
    if source.angle is None:
        return mi.warp.square_to_uniform_sphere(sample2), mi.Float(4 * dr.pi)
    local = sample_falloff(sample2, _cos_angle(source), source.exponent)
    return mi.Frame3f(dr.normalize(source.direction)).to_world(local), total(_cos_angle(source), source.exponent)


def _cos_angle(source):
    return dr.cos(dr.deg2rad(source.angle))


def traverse_distribution(source, callback):
    """Shows the distribution's parameters to ``mi.traverse``; not the plain numbers of scalar variants, which cannot be
    changed in place."""
    edge = mi.ParamFlags.Differentiable | mi.ParamFlags.Discontinuous
    for name, flags in (("direction", edge), ("angle", edge), ("exponent", mi.ParamFlags.Differentiable)):
        value = getattr(source, name)
        if value is not None and not isinstance(value, float):
            callback.put(name, value, flags)


def sample_spectrum(texture, si, sample, active):
    """Wavelengths drawn from ``texture``, stratified, and their weight; in colour, its value."""
    wavelengths = dr.zeros(type(si.wavelengths))
    if len(wavelengths):
        wavelengths = mi.sample_shifted(sample)
    return texture.sample_spectrum(si, wavelengths, active)


def describe(source, **values):
    """The text of ``to_string``."""
    for name in ("distribution", "direction", "angle", "exponent", "unattenuated"):
        values[name] = getattr(source, name)
    lines = [f"  {name} = {value}".replace("\n", "\n  ") for name, value in values.items() if value is not None]
    return f"{type(source).__name__}[\n" + ",\n".join(lines) + "\n]"
