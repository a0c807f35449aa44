"""Numbers of the spaces (pairs of random numbers) of a sample: first those of the camera, then those of each node."""

#: Spaces of the sampling pattern for the camera. The spaces of the nodes follow.
PIXEL, LENS, TIME_AND_WAVELENGTH, CAMERA_SPACES = 0, 1, 2, 3

#: Spaces of the sampling pattern for one node. The spaces of the light sources follow.
REFLECTED, REFRACTED, DIFFUSE, CHOICE, ROULETTE, NODE_SPACES = 0, 1, 2, 3, 4, 5
