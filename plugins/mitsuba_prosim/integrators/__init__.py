"""Integrator plugins for Mitsuba; chapter 4 and sections 5.3 and 5.4 of the thesis describe the ray tracer."""
