"""Light sources: section 5.2."""
