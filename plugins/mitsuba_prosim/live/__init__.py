"""A scene's picture while the scene is written, on a local page; and an image in progress in a notebook.

``viewer``: the one thread that renders; ``requests``: what any other thread asks of it; ``publisher``: the state that
every page reads; ``image``: images in progress; ``loaded_scene``: a scene file that is open; ``camera``: how a view
moves; ``files``: when the scene's files change; ``picture``: an image as the page gets it; ``throttle``: how often
it is drawn; ``server``: the page's server, and who may ask it. ``notebook``: the same without a page.
"""
