"""Light: what sources emit and how they are sampled (section 5.2)."""
