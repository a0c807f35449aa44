"""Sampler plugins (thesis, section 5.3.2)."""
