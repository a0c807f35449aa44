"""Live views: a local page that shows a scene while it is edited, and a progressive image in a notebook.

``viewer`` has the thread that renders, and executes the requests of other threads. ``publisher`` has the state that
pages read, and limits how often an image is drawn. ``progressive_image`` renders images progressively, and ``picture``
stores their layers. ``loaded_scene`` is an open scene file, ``orbit_camera`` moves the camera, and ``scene_watcher``
detects changes of the scene's files. ``server`` serves the page and controls the access to it. ``notebook`` is the view
in a notebook.
"""
