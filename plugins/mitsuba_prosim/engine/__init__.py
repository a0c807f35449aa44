"""The engine of progressive and adaptive rendering: from samples to an image (thesis, section 5.3.2).

The module ``integrator`` has the base class of the plugins. ``render`` is the loop over work items that makes an image.
``plan`` decides which samples an image takes, ``policies`` how many samples each pixel gets, and ``error_target`` when
a render stops. ``estimator`` takes samples. ``accumulators`` stores the sums of every pixel and the adaptive state.
``work`` divides the missing samples into work items, and has the executor that computes them. ``film`` makes the image.
``checkpoint`` stores a render in a file. ``tiles`` divides an image into parts. ``environment`` has the versions and
the processor on which the bits depend. ``derivatives`` computes derivatives of an image.
"""
