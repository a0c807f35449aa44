"""Light: what sources emit, and how a surface samples them (sections 4.2.2.1, 5.2): one strategy a file, and the table of
a scene's sources."""
