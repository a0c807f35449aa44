"""Live views of a scene: a local web page that shows a scene while its file is edited, and a progressive image in a
notebook.

The module ``viewer`` renders the images in one thread, in which it also executes the requests of other threads. The
module ``publisher`` holds the state that the web page shows, and limits how often a new picture is drawn. The module
``progressive_image`` renders images progressively, and the module ``picture`` stores the layers of an image. The module
``loaded_scene`` opens a scene file, ``orbit_camera`` moves the camera, and ``scene_watcher`` detects changes of the
scene's files. The module ``server`` serves the web page, and decides who may open the page. The module ``notebook``
shows a progressive image in a notebook, and the module ``result`` renders a scene in one call.
"""
