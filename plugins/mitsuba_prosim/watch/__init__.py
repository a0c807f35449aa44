"""A scene's picture while the scene is written, on a local page; and in a notebook.

``studio``: the one thread that renders, and ``wish`` what it is to show; ``portions``: how long it is deaf meanwhile;
``due``: when a picture is drawn anew;
``subject``: a scene file, opened; ``takes`` and
``denoised``: the images that grow; ``camera``: how a view is moved; ``picture``: an image as the page gets it;
``board``: where the studio says what there is, and every page reads it; ``pages``: what a page asks for; ``guard``:
who may ask; ``server``: both together; ``changes``: when files are saved, and ``named``: which. ``notebook``: the same
without a page, by ``turns``, until one of its ``cells`` is run again.
"""
