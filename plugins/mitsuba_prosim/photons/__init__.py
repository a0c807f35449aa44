"""Photon maps: light that reaches diffuse and glossy surfaces through specular surfaces (thesis, sections 5.4.1, 6).

The ray tree follows no ray from a diffuse lobe. With the eye E, specular surfaces S, a diffuse surface D and a light
source L, rays find the light paths E S* D L, but not the caustics E S* D S+ L. Photons find these. They follow Arvo's
illumination maps (1986), which the thesis names, in the form of Jensen's photon maps (1996).

``emission`` aims photons from the light sources at spheres around the specular surfaces. ``tracing`` follows them until
they land on diffuse or glossy surfaces. ``grid`` gives each landed photon a kernel radius: one pixel width, or more
where photons are sparse. ``caustics`` gathers photons at diffuse surfaces. Each sample of a pixel uses another photon
map, so that adaptive sampling measures the noise of photons like other noise. ``mis`` gathers photons at glossy
surfaces, too, and combines them with the rays of glossy lobes.

The random numbers of a photon are a pure function of the seed and its number, and a sum over photons always has the
same order, so the bits of an image do not depend on the parameter ``band``, the crop window or the number of threads.
"""
