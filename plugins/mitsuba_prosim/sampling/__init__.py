"""Sampling patterns (thesis, section 4.2.1.2) and the N-rook method (section 5.3.2), as pure functions."""
