"""Integrators and samplers against converged references: the measures, the runs and the page of ``prosim compare``."""
