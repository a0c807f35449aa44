"""Which pixels get how many passes (sections 4.2.1.1, 5.3.2): one policy a file.

A policy is made from a :class:`~mitsuba_prosim.rendering.plan.Plan` and a threshold. It has

``reach``
    how many pixels around a pixel it looks at;
``first``
    the number of samples in the first wave, which every pixel gets;
``quiet(estimate_so_far, t)``
    or None: which pixels of a wave end after their ``t``-th sample, the last of a pass;
``waves(estimate, x, y, size, band)``
    the waves after the first one, each as ``(where, begin, end)``: the samples ``begin`` .. ``end`` - 1 for the pixels
    with the indices ``where``; ``begin`` starts a pass. It is resumed when a wave's samples have been added to
    ``estimate``.
"""

from .neighbours import Neighbours
from .none import Everything
from .thesis import Thesis

#: The values of the integrator's parameter ``adaptive``, the default first.
POLICIES = {"neighbours": Neighbours, "thesis": Thesis, "none": Everything}
