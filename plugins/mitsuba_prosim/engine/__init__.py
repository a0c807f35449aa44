"""The engine of progressive and adaptive rendering, which takes samples and makes an image (thesis, section 5.3.2).

The module ``integrator`` has the base class of the progressive integrators. The module ``render`` renders an image in a
loop over work items (groups of samples). The module ``goal`` decides which samples an image takes next and when a
render stops, by the ``policies`` of adaptive sampling and the limits of ``error_target``. The module ``plan`` defines
the sample points of an image. The module ``channels`` defines the channels of a film, and ``estimator`` takes samples.
The module ``accumulators`` stores the sums of the samples of each pixel. The module ``image`` has the state of an image
in progress, and the second image that measures its error; both are a ``pixel_set``. The module ``work`` divides the
samples that an image still needs into work items, and has the executor that computes the work items in this process.
The module ``film`` computes the values of the film's pixels from the sums of the samples. The module ``checkpoint``
stores an unfinished render in a file. The module ``tiles`` divides an image into parts. The module ``environment``
returns the software versions and the processor, on which the bits of the samples depend. The module ``derivatives``
computes derivatives of an image. The module ``tiny_lamps`` finds lamps whose reflections may be missed.
"""
