"""The equations of the thesis's chapters 2 and 3: Fresnel's reflectance, microfacet distributions, geometric
attenuation.
"""
