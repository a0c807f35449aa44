"""Integrator plugins (thesis, chapter 4 and sections 5.3 and 5.4)."""
