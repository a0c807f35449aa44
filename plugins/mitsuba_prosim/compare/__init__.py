"""``prosim compare``: integrators and samplers against converged references.

``comparison``: the runs and their numbers; ``methods``: integrators and samplers in a scene; ``runs``: references
and timed rounds; ``measures``: of error; ``comparison_page``: the page.
"""
