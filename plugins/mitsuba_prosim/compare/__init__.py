"""Comparison of integrators and samplers against converged references: measures, runs and the page of ``prosim compare``."""
