"""Live views of a scene: a local web page that shows a scene while its file is edited, and a progressive image in a
notebook.

The module ``viewer`` renders in one thread, executes the requests of other threads there, and holds the state that the
page shows; ``server`` serves the page. The module ``progressive_image`` has the images, ``loaded_scene``,
``orbit_camera`` and ``scene_watcher`` the scene. The module ``result`` renders a scene in one call, and shows the image
in a notebook meanwhile.
"""
