"""The equations of chapters 2 and 3 of the thesis: reflectance by Fresnel's equations, microfacet distributions,
geometric attenuation.
"""
