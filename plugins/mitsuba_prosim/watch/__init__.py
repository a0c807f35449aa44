"""A scene's picture while the scene is written, on a local page; and in a notebook.

``studio``: the one thread that renders; ``desk``: where any other leaves a ``wish``, or an errand; ``easel``: where it
draws its pictures, and ``board``: where every page reads what there is; ``portions``: how long it is deaf meanwhile;
``due``: when a picture is drawn anew; ``subject``: a scene file, opened, and ``glimpse``: what is seen before;
``takes`` and ``denoised``: the images that grow; ``camera``: how a view is moved; ``picture``: an image as the page
gets it; ``pages``: what a page asks for; ``guard``: who may ask; ``server``: both together; ``changes``: when files are
saved, and ``named``: which. ``notebook``: the same without a page, by ``turns``, until one of its ``cells`` is run
again.
"""
