"""The command ``prosim compare``, which measures the error of integrators and samplers against converged reference
images.

The module ``comparison`` plans a comparison and collects its results. The module ``methods`` prepares the integrators
and samplers for a scene. The module ``runs`` renders the reference images and measures the methods. The module
``measures`` has the error measures. The module ``comparison_page`` makes the HTML page.
"""
