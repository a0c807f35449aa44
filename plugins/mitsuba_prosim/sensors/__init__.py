"""Views through a window on a view plane (appendix A)."""
