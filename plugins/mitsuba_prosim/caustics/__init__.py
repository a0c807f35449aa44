"""Caustics: light that specular surfaces gather on diffuse ones (sections 5.4.1, 6).

No ray goes on from a diffuse component, so that a tree knows E S* D L but not E S* D S+ L: what comes to a diffuse
surface by way of mirrors and glass. Arvo's illumination maps (1986), which the thesis names, are followed here in the
form that Jensen gave them (1996):

- :mod:`.targets`, :mod:`.sources`: photons start at the sources, aimed at spheres around all that is specular;
- :mod:`.walk`: they go from one specular surface to the next, reflected or refracted, until they lie on a diffuse one;
- :mod:`.photons`: there they are sorted into cells of a grid, about as large as a pixel is seen there
  (:mod:`.footprint`);
- :mod:`.gathering`: the diffuse surfaces that a tree or path meets collect those that lie within a pixel's reach;
- :mod:`.merging`, :mod:`.passing`: so do glossy ones, which share that light with the rays that their lobes draw;
- :mod:`.caustics`: every sample of a pixel gathers from a map of its own, so that photons are noise as all else is:
  adaptive sampling sees it, and it falls with the number of samples.

What paths find of the same light by luck (:mod:`..transport.path`) is left to the photons alone. All of it is a pure
function of the seed, and summed in the order of the photons: no bit depends on bands, crops or threads.
"""
