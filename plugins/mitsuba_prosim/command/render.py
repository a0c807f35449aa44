"""``prosim render``: a scene file in, an EXR and a PNG image out."""

import os
import signal
import sys
import tempfile
import time
import warnings
from contextlib import contextmanager
from importlib.metadata import version
from pathlib import Path

import click
import mitsuba as mi
import numpy as np
import prosim_scene
from tqdm.auto import tqdm

from . import session
from .options import SCENE, Definition, Numbers, translation
from .tone import compress


@click.command(short_help="Render a scene to an EXR and a PNG image.")
@click.argument("scene", type=SCENE)
@click.option("-o", "--output", type=click.Path(path_type=Path),
              help="Image to write, without or with the suffix .exr or .png: both are written. "
                   "[default: beside the scene, under the NAME in it or else its own]", show_default=False)
@click.option("-m", "--mode", metavar="VARIANT",
              help="Mitsuba variant. [default: cuda_ad_rgb, metal_ad_rgb, llvm_ad_rgb or scalar_rgb, the first that "
                   "this machine can run]", show_default=False)
@click.option("-D", "--define", "definitions", type=Definition(), multiple=True,
              help="Constant that replaces $key in the XML scene. May be repeated.")
@click.option("-s", "--sensor", type=click.IntRange(min=0), default=0, help="Which sensor of the scene.")
@click.option("-t", "--threads", type=click.IntRange(min=1), show_default=False,
              help="Number of threads. [default: all]")
@click.option("-v", "--verbose", count=True, help="Say more; twice: still more.")
@click.option("--spp", type=click.IntRange(min=1), help="Samples per pixel, as Mitsuba counts them. "
              "[default: what the scene says]", show_default=False)
@click.option("--seed", type=click.IntRange(0, 2**32 - 1), default=0, help="Seed of the samples.")
@click.option("--crop", type=Numbers("X,Y,W,H", ",", 4, least=0), help="Render only this window of the image, in pixels.")
@click.option("--exposure", type=float, default=0.0, metavar="STOPS",
              help="Makes the PNG brighter by so many factors of two; negative: darker.")
@translation
def render(scene, output, mode, definitions, sensor, threads, verbose, spp, seed, crop, exposure, resolution, samples,
           **language):
    """Render SCENE, a file in the thesis's scene language (any name) or a Mitsuba scene (.xml).

    Writes a linear EXR (with how it was made as metadata) and a tone-mapped PNG. Existing files are replaced when the
    new ones are complete. Ctrl-C ends the render and keeps the image so far.
    """
    if mode and mode not in mi.variants():
        raise click.BadParameter(f"{mode!r}: this Mitsuba has {', '.join(mi.variants())}.", param_hint="-m")
    try:
        session.set_variant(mode)
    except (ImportError, RuntimeError) as error:
        raise click.ClickException(str(error)) from None

    with tempfile.TemporaryDirectory(prefix="prosim-") as folder, log(verbose), session.threads(threads):
        try:
            stem = image_stem(scene, output)
            with session.enough_threads():
                loaded = load(scene, folder, dict(definitions), resolution, samples, crop, language)
            chosen = session.pick_sensor(loaded, sensor)
        except prosim_scene.SceneError as error:
            raise InputError(str(error)) from None
        except (RuntimeError, TypeError, ValueError) as error:
            raise InputError(session.message(error)) from None

        integrator, start = loaded.integrator(), time.perf_counter()
        if hasattr(integrator, "band"):
            # Some seconds at most between two steps of the bar, at which Ctrl-C is heard as well.
            integrator.band = min(integrator.band, max(2**14, 2**23 // (spp or integrator.samples**2)))
        with progress_bar(integrator), interruptible(integrator) as interrupted:
            session.render(loaded, chosen, seed, spp or 0)
        seconds = time.perf_counter() - start

    facts = {"prosim.scene": str(scene), "prosim.version": version("mitsuba-prosim"), "prosim.variant": mi.variant(),
             "prosim.integrator": str(integrator), "prosim.seed": str(seed), "prosim.seconds": f"{seconds:.3f}"}
    try:
        written = write_images(stem, chosen.film().bitmap(), facts, exposure)
    except (RuntimeError, OSError) as error:
        raise click.ClickException(f"the image could not be written: {error}") from None
    width, height = chosen.film().crop_size()
    click.echo(f"{' and '.join(map(str, written))}: {width} x {height} pixels, {mi.variant()}, {seconds:.2f} s"
               + (", interrupted" if interrupted else ""))
    if interrupted:
        sys.exit(1)


class InputError(click.ClickException):
    """The scene is wrong; nothing has been written."""

    exit_code = 2


def image_stem(scene, output):
    """Path of the images without suffix: the output's, or the name that the scene gives itself, beside the scene."""
    if output:
        return output.with_suffix("") if output.suffix.lower() in (".exr", ".png") else output
    if scene.suffix.lower() == ".xml":
        return scene.with_suffix("")
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # the translation gives them again
        name = prosim_scene.parse(prosim_scene.read(scene), scene).name
    return scene.with_name(Path(name).name or scene.stem)


def load(scene, folder, definitions, resolution, samples, crop, language):
    """Loads a scene file of either kind; translates it in ``folder`` first if it is in the thesis's language."""
    xml = scene
    if scene.suffix.lower() != ".xml":
        xml = prosim_scene.translate(scene, Path(folder), resolution=resolution, samples=samples, **language)
    with session.search_paths(first=[xml.parent, scene.parent]):
        state = session.parse(xml, definitions)
        for node in state.nodes:
            if node.type == mi.ObjectType.Film:
                override(node.props, ("width", "height"), resolution)
                override(node.props, ("crop_offset_x", "crop_offset_y", "crop_width", "crop_height"), crop)
            elif node.type == mi.ObjectType.Integrator and node.props.plugin_name() == "prosim" and samples:
                node.props["samples"] = samples
        return session.instantiate(state)


def override(props, names, values):
    """Sets named properties, if values are given."""
    for name, value in zip(names, values or ()):
        props[name] = value


class Log(mi.Appender):
    """Mitsuba's log on standard error, out of the progress bar's way."""

    def append(self, level, text):
        tqdm.write(text, file=sys.stderr)

    def log_progress(self, *args):
        """The bar shows it."""


@contextmanager
def log(verbose):
    """Sends Mitsuba's log to standard error: warnings, or more if ``verbose``."""
    logger, level = mi.logger(), mi.log_level()
    before = [logger.appender(i) for i in range(logger.appender_count())]
    logger.clear_appenders()
    logger.add_appender(Log())
    mi.set_log_level([mi.LogLevel.Warn, mi.LogLevel.Info, mi.LogLevel.Debug, mi.LogLevel.Trace][min(verbose, 3)])
    try:
        yield
    finally:
        logger.clear_appenders()
        for appender in before:
            logger.add_appender(appender)
        mi.set_log_level(level)


@contextmanager
def progress_bar(integrator):
    """Shows how far a render is, with the time left, if the integrator tells and a person watches."""
    if not hasattr(integrator, "progress"):
        yield
        return
    with tqdm(total=100, unit="%", bar_format="{l_bar}{bar}| {elapsed}, {remaining} left", disable=None,
              file=sys.stderr, leave=False) as bar:
        def show(done):
            bar.update(100 * done - bar.n)
        integrator.progress = show
        try:
            yield
        finally:
            integrator.progress = None


@contextmanager
def interruptible(integrator):
    """Lets the first Ctrl-C end the render, so that the film keeps what it has; yields a list, empty until then."""
    seen = []

    def stop(*_):
        seen.append(True)
        integrator.cancel()
        signal.signal(signal.SIGINT, before)

    before = signal.signal(signal.SIGINT, stop)
    try:
        yield seen
    finally:
        signal.signal(signal.SIGINT, before)


def write_images(stem, bitmap, facts, exposure):
    """Writes STEM.exr and STEM.png, each complete or not at all; returns their paths.

    The PNG is ``2**exposure`` times as bright, its highlights compressed. A film without colours (spectral bins, say) has none.
    """
    stem.parent.mkdir(parents=True, exist_ok=True)
    for name, fact in facts.items():
        bitmap.metadata()[name] = fact
    images = {".exr": bitmap}
    colours = next((layer for name, layer in bitmap.split() if name == "<root>"), bitmap)
    if colours.pixel_format() != mi.Bitmap.PixelFormat.MultiChannel:
        linear = colours.convert(mi.Bitmap.PixelFormat.RGB, mi.Struct.Type.Float32, srgb_gamma=False)
        images[".png"] = mi.Bitmap(compress(np.array(linear) * np.float32(2**exposure))).convert(
            component_format=mi.Struct.Type.UInt8, srgb_gamma=True)
    finished = {}
    try:
        with session.enough_threads():
            for suffix, image in images.items():
                part = stem.with_name(f".{stem.name}.{os.getpid()}{suffix}")
                finished[part] = stem.with_name(stem.name + suffix)
                image.write(str(part))
        for part, path in finished.items():
            os.replace(part, path)
    finally:
        for part in finished:
            part.unlink(missing_ok=True)
    return list(finished.values())
