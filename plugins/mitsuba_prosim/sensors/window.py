"""A camera with a window on the view plane, pixels of any aspect ratio and a thin lens: prosim_window."""

from __future__ import annotations

from math import inf

import drjit as dr
import mitsuba as mi

from ..compat import box_of_point, world_matrix, world_transform
from ..parameters import describe, number, reject
from ..registry import plugin


@plugin("sensor", "prosim_window")
class Window(mi.Sensor):
    r"""
    .. _sensor-prosim_window:

    Window on a view plane (:monosp:`prosim_window`)
    ------------------------------------------------

    .. pluginparameters::

     * - left, bottom, right, top
       - |float|
       - Sides of the window on the plane at distance 1 before the camera. (Default: -1, -1, 1, 1)

     * - to_world
       - |transform|
       - Transform from the camera's space to the world. In the camera's space the view direction is +Z, the window's
         right is -X and its top is +Y, as for Mitsuba's other cameras. (Default: identity)

     * - aperture_radius
       - |float|
       - Radius of the lens; 0 is a pinhole. (Default: 0)

     * - focus_distance
       - |float|
       - Depth of the plane that a lens shows sharply. (Default: 1)

     * - near_clip, far_clip
       - |float|
       - Depths between which objects are visible. (Default: 0.01, 10000)

    The camera of the thesis's scene language (VIEW in appendix A). The film's pixels evenly divide a window, which may
    have any place and proportions. For square pixels, Mitsuba's ``perspective`` with a principal point offset has the
    same rays; with an aperture and a centred window, ``thinlens`` has. Particle tracers cannot sample this sensor.

    .. tabs::
        .. code-tab:: xml

            <sensor type="prosim_window">
                <float name="left" value="-0.5"/>
                <float name="right" value="1.5"/>
                <film type="hdrfilm">
                    <integer name="width" value="8"/>
                    <integer name="height" value="8"/>
                </film>
            </sensor>

        .. code-tab:: python

            'type': 'prosim_window',
            'left': -0.5,
            'right': 1.5,
            'film': {
                'type': 'hdrfilm',
                'width': 8,
                'height': 8
            }
    """

    def __init__(self, props: mi.Properties) -> None:
        """Reads the parameters. Raises ValueError unless left < right, bottom < top, 0 < near_clip < far_clip,
        aperture_radius >= 0 and focus_distance > 0.
        """
        super().__init__(props)
        self.left, self.right = number(props, "left", -1.0, -inf), number(props, "right", 1.0, -inf)
        self.bottom, self.top = number(props, "bottom", -1.0, -inf), number(props, "top", 1.0, -inf)
        for low, high in (("left", "right"), ("bottom", "top")):
            if not getattr(self, low) < getattr(self, high):
                raise reject(props, low, getattr(self, low), f"a number below {high}, {getattr(self, high)}")
        self.aperture_radius = number(props, "aperture_radius", 0.0, 0.0)
        self.focus_distance = number(props, "focus_distance", 1.0, 0.0, open_below=True)
        self.m_needs_sample_3 = self.aperture_radius > 0
        self.near_clip, self.far_clip = props.get("near_clip", 1e-2), props.get("far_clip", 1e4)
        if not 0 < self.near_clip < self.far_clip:
            raise reject(props, "near_clip", self.near_clip, "a number above 0 and below far_clip")

    def direction(self, position: mi.Point2f) -> mi.Vector3f:
        """Returns the unit direction, in camera space, at ``position`` in [0, 1]² of the crop window."""
        film = self.film()
        # Without a crop window, this formula keeps the film's size out of the code: all resolutions then share their
        # kernels.
        axes = zip((position.x, position.y), film.crop_offset(), film.crop_size(), film.size(), strict=True)
        x, y = [p * (float(crop) / float(size)) + float(offset) / float(size) for p, offset, crop, size in axes]
        # The window's right is -x in the camera's space.
        return dr.normalize(mi.Vector3f(-dr.lerp(self.left, self.right, x), dr.lerp(self.top, self.bottom, y), 1))

    def sample_ray(
        self, time: mi.Float, sample1: mi.Float, sample2: mi.Point2f, sample3: mi.Point2f, active: mi.Bool = True
    ) -> tuple[mi.Ray3f, mi.Spectrum]:
        """Returns ``(ray, weight)``: the ray through the position ``sample2`` in the crop window from the point
        ``sample3`` of the lens, both in [0, 1)², between the clipping planes; and the weight of the wavelengths that
        ``sample1`` selects.
        """
        wavelengths, weight = self.sample_wavelengths(dr.zeros(mi.SurfaceInteraction3f), sample1, active)
        d, lens = self.direction(sample2), mi.Point3f(0)
        if self.aperture_radius > 0:
            on_disk = self.aperture_radius * mi.warp.square_to_uniform_disk_concentric(sample3)
            lens = mi.Point3f(on_disk.x, on_disk.y, 0)
            d = dr.normalize(d * (self.focus_distance / d.z) - mi.Vector3f(lens))
        to_world = world_transform(self, time)
        ray = dr.zeros(mi.Ray3f)
        ray.time, ray.wavelengths = time, wavelengths
        ray.d = to_world @ d
        ray.o = to_world @ lens + ray.d * (self.near_clip / d.z)
        ray.maxt = (self.far_clip - self.near_clip) / d.z
        return ray, weight

    def bbox(self) -> mi.ScalarBoundingBox3f:
        return box_of_point(mi.ScalarPoint3f(*world_matrix(self)[:3, 3]))

    def to_string(self) -> str:
        window = {side: getattr(self, side) for side in ("left", "right", "bottom", "top")}
        return describe(self, **window, aperture_radius=self.aperture_radius, film=self.film())
