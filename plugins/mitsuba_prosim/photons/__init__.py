"""Photon maps: light that reaches diffuse and glossy surfaces through specular surfaces (sections 5.4.1, 6).

The ray tree follows no ray from a diffuse lobe. So rays find the light paths E S* D L, but not E S* D S+ L, the
caustics. Photons find the caustics. The method of illumination maps is Arvo's (1986), named in the thesis; its form is
Jensen's (1996):

- :mod:`.targets`, :mod:`.emission`: the light sources emit photons towards spheres around the specular surfaces;
- :mod:`.tracing`: specular surfaces reflect or refract photons until they land on a diffuse or glossy surface;
- :mod:`.grid`: each landed photon gets a radius, one pixel wide or more where photons are sparse; a grid with cells of
  about this size sorts the photons;
- :mod:`.caustics`: a visible diffuse surface collects the photons whose radius reaches the surface. Each sample of a
  pixel has its own photon map. So photons are noise like any other noise: adaptive sampling measures it, and more
  samples reduce it;
- :mod:`.mis`: a glossy surface collects photons too, and combines them by MIS with the rays that its lobes sample.

Paths leave the caustics to the photons (:mod:`..transport.path`). All photons are a pure function of the seed. Each sum
over photons adds them in a fixed order, so the bits do not depend on bands, crops or threads.
"""
