"""``prosim compare``: measures the error of integrators and samplers against converged references.

``comparison`` has the runs and their results, ``methods`` the integrators and samplers in a scene, ``runs`` the
references and timed rounds, ``measures`` the measures of error, and ``comparison_page`` the HTML page.
"""
