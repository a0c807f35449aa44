"""From samples to an image (thesis, section 5.3.2).

``integrator``: the base class of plugins. ``render``: the loop over work items that makes an image. ``plan``: which
samples an image takes; ``policies``: the number of samples of each pixel; ``error_target``: the stopping criterion.
``estimator``: takes samples; ``accumulators``: the sums of every pixel, and the adaptive state; ``work``: the missing
samples as work items, and the executor that takes them; ``film``: the image. ``checkpoint``: all of it as a file;
``tiles``: parts of an image; ``environment``: versions and processor, on which the bits depend; ``derivatives``.
"""
