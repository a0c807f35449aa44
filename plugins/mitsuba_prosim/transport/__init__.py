"""Transport of light by stochastic ray tracing (thesis, chapter 4 and section 5.4.1)."""
