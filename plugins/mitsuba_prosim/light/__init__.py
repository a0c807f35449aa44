"""Light: what sources emit, and how surfaces sample them (sections 4.2.2.1, 5.2): one strategy a file, and a table."""
