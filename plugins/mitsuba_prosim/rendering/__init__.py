"""From samples to an image (thesis, section 5.3.2)."""
