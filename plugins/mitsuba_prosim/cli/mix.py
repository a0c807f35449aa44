"""``prosim mix``: changes the brightness and the colour of the lamps of a rendered image."""

from collections.abc import Mapping
from pathlib import Path

import click
import numpy as np
import OpenEXR

from ..scene import images
from ..scene.channels import mixed, of_channels, parse_factors
from . import files
from .job import Command, Job, job_options
from .option_types import IMAGE_FILE, InputError, input_errors
from .render_task import SUFFIXES

#: Largest allowed difference between an image and the sum of its layers, relative to the brightest value. Rounding to
#: half precision causes such differences.
ROUNDING = 0.01


@click.command(cls=Command)
@click.argument("image", type=IMAGE_FILE)
@click.argument("factors", nargs=-1, required=True, metavar="LAYER=FACTOR...")
@job_options("output", "exposure", "variant")
def mix(job: Job, image: Path, factors: tuple[str, ...]) -> None:
    """Recombine the layers of IMAGE, an EXR file that prosim render --layers has written.

    Each LAYER is multiplied by its FACTOR, which is one number or three numbers (red, green, blue). Layers without a
    factor stay unchanged. The output is an EXR image, which can be mixed again, and a PNG image.
    """
    if images.is_whole(image.read_bytes()) is False:
        raise InputError(f"{image} is damaged, or another program has changed it; render it again with --layers.")
    try:
        with OpenEXR.File(str(image), separate_channels=True) as file:
            header = {name: str(value) for name, value in file.header().items() if name.startswith("prosim.")}
            planes = {name: np.array(channel.pixels, dtype=np.float32) for name, channel in file.channels().items()}
    except (RuntimeError, ValueError):
        raise InputError(f"{image} is not a readable EXR image; give an image by prosim render --layers.") from None
    # Older images do not name their layers, of which an AOV of colours is none.
    known = header["prosim.layers"].split("\n") if "prosim.layers" in header else [name[:-2] for name in planes]
    layers = [name for name in dict.fromkeys(known) if {f"{name}.{letter}" for letter in "RGB"} <= set(planes)]
    if not layers or not all(is_sum(planes, layers, letter) for letter in "RGB"):
        raise InputError(
            f"{image} is not the sum of its layers ({', '.join(layers) or 'none'}); render it with --layers lights, "
            "on a film of RGB."
        )
    with input_errors():
        wanted = parse_factors(factors, layers)
    colours = {name: np.stack([planes[f"{name}.{letter}"] for letter in "RGB"], axis=2) for name in layers}
    whole, colours = mixed(colours, wanted)
    for k, letter in enumerate("RGB"):
        planes[letter] = whole[..., k]
        planes |= {f"{name}.{letter}": values[..., k] for name, values in colours.items()}
    header["prosim.mix"] = "; ".join(filter(None, [header.get("prosim.mix"), factors_in_words(wanted)]))
    stem = files.output_stem(job.output, image.with_name(f"{image.stem}-mix"), SUFFIXES)
    files.check(stem, SUFFIXES, sum(plane.nbytes for plane in planes.values()), [image])
    # The image's own channels are first, in the order R, G, B, A; the channels of the layers follow.
    ordered = {name: planes[name] for name in sorted(planes, key=lambda name: ("." in name, "RGBA".find(name)))}
    contents = images.encode(of_channels(ordered), header, job.exposure or 0.0)
    click.echo(" and ".join(map(str, files.save(stem, contents))))


def factors_in_words(factors: Mapping[str, np.ndarray]) -> str:
    """Returns the factors of the layers as text, for the metadata of the mixed image."""
    return ", ".join(f"{name} x {' '.join(map(str, factor))}" for name, factor in factors.items())


def is_sum(planes: dict[str, np.ndarray], layers: list[str], letter: str) -> bool:
    """Tells whether the channel ``letter`` of the image is its sum over all ``layers``, up to :data:`ROUNDING` times
    the brightest value. A missing channel counts as 0.
    """
    image, total = planes.get(letter, np.zeros(1)), np.sum([planes[f"{name}.{letter}"] for name in layers], axis=0)
    return bool(np.abs(total - image).max() <= ROUNDING * max(np.abs(image).max(), 1e-3))
