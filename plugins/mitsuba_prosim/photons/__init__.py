"""Photon maps: light that reaches diffuse and glossy surfaces through specular surfaces (thesis, sections 5.4.1, 6).

The ray tree follows no ray from a diffuse lobe. Let E be the eye, S a specular and D a diffuse surface, and L a light
source. Rays find the light paths E S* D L, but not E S* D S+ L, the caustics. Photons find the caustics. The photons
follow Arvo's illumination maps (1986), which the thesis names, in the form of Jensen's photon maps (1996).

- :mod:`.targets` and :mod:`.emission`: the light sources emit photons towards spheres around the specular surfaces.
- :mod:`.tracing`: specular surfaces, ideal or glossy, reflect or refract photons. After at least one such surface, a
  photon may land on a diffuse or glossy surface. A glossy surface may also reflect or refract a landed photon further.
- :mod:`.grid`: each landed photon gets a radius, one pixel wide or more where photons are sparse. The photons
  are sorted into grids by their radius; a cell is about two radii wide.
- :mod:`.caustics`: a visible diffuse surface collects the photons whose radius reaches the surface. Each sample of a
  pixel has its own photon map. The noise of photons is like any other noise of samples: adaptive sampling measures the
  noise, and more samples reduce the noise.
- :mod:`.mis`: a glossy surface collects photons too, and combines the photons by MIS with the rays that its lobes
  sample.

Paths leave the caustics to the photons (:mod:`..transport.path`). All photons are a pure function of the seed. A sum
over photons always has the same order, so the bits of an image do not depend on the parameter ``band``, the crop window
or the number of threads.
"""
