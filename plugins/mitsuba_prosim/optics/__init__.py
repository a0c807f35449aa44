"""The equations of chapters 2 and 3: Fresnel's reflectance, microfacet distributions, geometric attenuation."""
