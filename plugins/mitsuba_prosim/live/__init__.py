"""Live views: a local page that shows a scene while it is edited, and a progressive image in a notebook.

``viewer``: the thread that renders, and requests of other threads; ``publisher``: the state that pages read, and the
rate of drawing; ``progressive_image``: images in progress; ``picture``: their layers;
``loaded_scene``: an open scene file; ``orbit_camera``: camera motion; ``scene_watcher``: changes of the scene's files;
``server``: the page's server and its access rules; ``notebook``: the view in a notebook.
"""
