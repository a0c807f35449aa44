"""Photon maps: light that reaches diffuse and glossy surfaces through specular ones (sections 5.4.1, 6).

The ray tree follows no ray from a diffuse lobe. It finds E S* D L, but not E S* D S+ L, the caustics. Photons find that
light, after Arvo's illumination maps (1986), which the thesis names, in Jensen's form (1996):

- :mod:`.targets`, :mod:`.emission`: the sources emit photons towards spheres around the specular surfaces;
- :mod:`.tracing`: specular surfaces reflect or refract them, until they land on a diffuse or glossy surface;
- :mod:`.grid`: landed photons get a radius, a pixel's width or more where they are sparse, and are
  sorted into cells of about this size;
- :mod:`.caustics`: a diffuse surface that the eye sees collects the photons within their radius. Each sample of a pixel
  has its own photon map. So photons are noise like any other: adaptive sampling sees it, and more samples reduce it;
- :mod:`.mis`: a glossy surface collects photons too, and shares that light with the rays that its lobes draw.

Paths leave this light to the photons (:mod:`..transport.path`). All of it is a pure function of the seed. Sums have the
order of the photons, so that no bit depends on bands, crops or threads.
"""
