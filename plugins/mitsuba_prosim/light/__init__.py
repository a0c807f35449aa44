"""Light sources and light sampling (thesis, sections 4.2.2.1, 5.2)."""
