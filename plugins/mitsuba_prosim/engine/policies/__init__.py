"""Which pixels get how many samples (sections 4.2.1.1, 5.3.2): one policy a file.

A policy is made from a :class:`~mitsuba_prosim.engine.plan.Plan` and a threshold. It has

``first``
    the number of samples in the first pass over the image, which every pixel gets;
``reach``
    how many pixels around a pixel it looks at;
``need(estimate, width, height)``
    from the :class:`~mitsuba_prosim.engine.estimate.Estimate` of a rectangle after that pass, its pixels row by row:
    how many samples each pixel should have in the end, a ``mi.Float``, which the plan rounds up to a power of two and
    limits;
``judgements``
    how often it is asked: after each of so many passes, from the first on; if more than once, after every pass where
    noise or time end the image;
``quiet(total, squares, t)``
    or None: which pixels end after their ``t``-th sample, the last of a pass, whatever they need.
"""

from .graded import Graded
from .neighbours import Neighbours
from .none import Everything
from .thesis import Thesis

#: The values of the integrator's parameter ``adaptive``, the default first.
POLICIES = {"neighbours": Neighbours, "thesis": Thesis, "none": Everything, "graded": Graded}
