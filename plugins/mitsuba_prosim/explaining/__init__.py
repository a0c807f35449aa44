"""Explains a pixel: the rays of its samples, the light that each ray adds, and the causes of its noise.

The module ``explanation`` has the function ``explain`` and its result. The module ``recorder`` observes the light
transport while it takes the samples. The module ``verdict`` says what a render has reached, and why its error is
uncertain.
"""
