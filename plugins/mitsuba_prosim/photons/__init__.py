"""Photon maps: light that reaches diffuse and glossy surfaces through specular surfaces (thesis, sections 5.4.1, 6).

The ray tree follows no ray from a diffuse lobe. With the eye E, specular surfaces S, a diffuse surface D and a light
source L, rays find the light paths E S* D L, but not the caustics E S* D S+ L. Photons find the caustics. The photons
follow Arvo's illumination maps (1986), which the thesis names, in the form of Jensen's photon maps (1996).

``targets`` and ``emission``
    aim photons from the light sources at spheres around the specular surfaces.
``tracing``
    follows photons through reflections and refractions by specular surfaces, ideal or glossy. After at least one
    specular surface, a photon may land on a diffuse or glossy surface. A glossy surface may also reflect or refract a
    photon that has landed on the surface.
``grid``
    gives each landed photon a kernel radius: one pixel width, or more where photons are sparse. The photons are sorted
    into grids by their kernel radius; a cell of a grid is about two kernel radii wide.
``caustics``
    gathers photons at visible points of diffuse surfaces: the photons that are closer than their kernel radius. Each
    sample of a pixel gathers photons from a different photon map. Therefore adaptive sampling measures the noise of
    photons like other noise, and more samples reduce the noise of photons.
``mis``
    gathers photons at glossy surfaces too, and combines the photons by MIS with the rays that glossy lobes sample.

If a render uses photons, paths (:mod:`..transport.path`) find no caustics by their rays, because the photons find the
caustics. The random numbers of a photon are a pure function of the seed and the number of the photon. A sum over
photons always has the same order, so the bits of an image do not depend on the parameter ``band``, the crop window or
the number of threads.
"""
