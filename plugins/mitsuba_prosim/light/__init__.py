"""Light sources and light sampling (sections 4.2.2.1, 5.2)."""
