"""A scene's picture on a local page, rendered anew while the scene is written.

``studio``: what is to be seen, and the one thread that renders it; ``subject``: a scene file, opened; ``takes``: the
images that grow; ``camera``: how a view is moved; ``picture``: an image as the page gets it; ``board``: where the
studio says what there is, and every page reads it; ``server``: the pages; ``changes``: when files are saved.
"""
