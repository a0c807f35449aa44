"""The tests of each kind of plugins: a class of the name of Mitsuba's."""

from .emitter import Emitter as Emitter
from .images import Film as Film
from .images import Integrator as Integrator
from .images import ReconstructionFilter as ReconstructionFilter
from .images import Sampler as Sampler
from .images import Sensor as Sensor
from .scattering import BSDF as BSDF
from .scattering import Medium as Medium
from .scattering import PhaseFunction as PhaseFunction
from .shape import Shape as Shape
from .texture import Texture as Texture
