"""Views (appendix A): what a window on a view plane sees."""
