"""Live views: a local page that shows a scene while it is edited, and a progressive image in a notebook.

``viewer``: the thread that renders; ``requests``: requests of other threads; ``publisher``: the state that pages read;
``image``: progressive images; ``loaded_scene``: an open scene file; ``camera``: camera motion; ``files``: changes of
the scene's files; ``picture``: an image for the page; ``throttle``: the rate of drawing; ``server``: the page's
server and its access rules; ``notebook``: the view in a notebook.
"""
