"""The sensor prosim_window: a pinhole camera with a window on the view plane (thesis, appendix A)."""
