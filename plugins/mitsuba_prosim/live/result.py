"""Renders a scene in one call, in a notebook with the image meanwhile, and returns the image with its error and a
verdict in words.
"""

from __future__ import annotations

import base64
import signal
import threading
from collections.abc import Callable, Iterator, Mapping
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from functools import partial
from html import escape
from pathlib import Path
from typing import Any, TypeAlias

import mitsuba as mi
import numpy as np
from prosim_scene import extras
from tqdm.auto import tqdm

from .. import atomic
from ..explaining.verdict import name_in, verdict
from ..parameters import check_limit, check_whole, pick_sensor
from ..registry import create
from ..scene import black, rendering
from ..scene.scene_file import SceneFile, check_parameters, require_scene
from .progressive_image import ProgressiveImage, as_png

#: A Mitsuba scene, the dictionary of one, or the path of a scene file in XML or in the thesis's scene language.
AnyScene: TypeAlias = "mi.Scene | Mapping[str, Any] | str | Path"


@dataclass(frozen=True, eq=False)
class Result:
    """The image of :func:`render` and its errors, in units of the displayed image (white = 1) unless another unit is
    given. ``mi.TensorXf(result)``, ``mi.Bitmap(result)`` and ``np.array(result)`` have the image.
    """

    #: The linear image, shape (height, width, channels).
    image: mi.TensorXf
    #: Standard error of the luminance of each pixel, in units of radiance, and number of samples of each pixel, shape
    #: (height, width).
    error: np.ndarray
    samples: np.ndarray
    #: The measured RMS error, NaN if it was not measured; and its upper bound, which holds in about 95 of 100 renders,
    #: NaN if it is unknown.
    noise: float
    noise_at_most: float
    #: The errors that the image has reached, and what ended the render, in words.
    verdict: str
    #: The linear colours of the image, shape (height, width, 3).
    colours: np.ndarray

    def __array__(self, dtype: Any = None, copy: bool | None = None) -> np.ndarray:
        return np.array(self.image, dtype=dtype)

    def __dlpack__(self, **how: Any) -> Any:
        return self.image.__dlpack__(**how)

    def __dlpack_device__(self) -> Any:
        return self.image.__dlpack_device__()

    def __repr__(self) -> str:
        return f"<{self.verdict}>"

    def _repr_html_(self) -> str:
        layers = {"image": self.colours, "standard error": self.error, "samples": self.samples}
        figures = (
            f'<figure style="margin: 0"><img style="max-width: 100%" alt="{name}" src="data:image/png;base64,'
            f'{base64.b64encode(as_png(values)).decode()}"><figcaption>{name}</figcaption></figure>'
            for name, values in layers.items()
        )
        told = escape(self.verdict, quote=False)  # it has ids of the scene
        return f'<p>{told}</p><div style="display: flex; flex-wrap: wrap; gap: 1em">{"".join(figures)}</div>'


def render(
    scene: AnyScene,
    noise: float = 0.0,
    time: float = 0.0,
    spp: int = 0,
    denoise: bool = False,
    sensor: int | mi.Sensor = 0,
    seed: int = 0,
    progress: bool | Callable[[float], object] = True,
) -> Result:
    """Renders a scene until an error, a time or a number of samples is reached, and returns the image with its error.

    ``scene``
        A Mitsuba scene, the dictionary of one, or the path of a scene file in XML or in the thesis's scene language.
    ``noise``, ``time``
        The render ends when the RMS error of the displayed image (white = 1) is ``noise``, for which 0.01 is usual, or
        after ``time`` seconds. 0: as in the scene.
    ``spp``
        Number of samples of each pixel, whatever limits the scene has; not together with ``noise`` and ``time``.
    ``denoise``
        Denoise the image; ``noise`` then limits the error of the denoised image.
    ``sensor``, ``seed``
        As in ``mi.render``.
    ``progress``
        Whether to show a bar, which is a widget in a notebook; or a function that gets the progress, 0 to 1.

    Any integrator that takes samples from a sensor works; with ``noise`` or ``time``, ``prosim`` follows the light
    paths of ``path``. Raises RuntimeError in scalar variants and without a variant, ValueError for wrong arguments, and
    the errors of loading the scene.
    """
    with reporter(progress) as report:

        def follow(image: ProgressiveImage, _: bool) -> None:
            report(image.progress)  # its result, such as that of tqdm.update, must not end the render

        return converge("render", scene, follow, noise, time, spp, denoise, sensor, seed)


def converge(
    caller: str,
    scene: AnyScene,
    follow: Callable[[ProgressiveImage, bool], object],
    noise: float = 0.0,
    time: float = 0.0,
    spp: int = 0,
    denoise: bool = False,
    sensor: int | mi.Sensor = 0,
    seed: int = 0,
) -> Result:
    """Does what :func:`render` does for ``caller``. After each work item, ``follow`` gets the image, and whether it
    should be drawn now; the render ends early if it returns true.
    """
    given = {"noise": noise, "time": time}
    limits = {name: limit for name, value in given.items() if (limit := check_limit(name, value))}
    if (spp := check_whole("spp", spp)) and limits:
        raise ValueError(f"{caller}: spp gives each pixel exactly so many samples; leave it out with noise and time")
    with atomic.scratch() as folder:
        loaded, file = load(caller, scene, folder)
        integrator: Any = loaded.integrator() or create("path")
        if rendering.is_denoised(integrator):
            integrator, denoise = integrator.nested, True
        if limits:
            integrator = rendering.with_targets(integrator, loaded)
        sensor = pick_sensor(loaded, sensor)
        image = ProgressiveImage(integrator, loaded, sensor, spp, seed, denoise)
        interrupted = False
        with ExitStack() as stack:
            for name, value in (limits | {"adaptive": "graded"} if limits else {}).items():
                stack.callback(setattr, integrator, name, getattr(integrator, name))  # restores the value
                setattr(integrator, name, value)
            while not (image.done or interrupted):
                interrupted = follow(image, image.step()) is True
        layers, reached = image.layers(), image.render.reached
        if np.isnan(reached.noise):  # not measured during the render, but perhaps by the denoiser
            reached = image.reached
        bound = image.render.noise_bound() if np.isnan(reached.noise) else reached.noise_at_most
        lost = getattr(image.render, "lost", "")
        why_black = not (interrupted or lost) and black.reason(
            loaded, sensor, layers["final"], "Multiplied by 2^{} it is bright", called=partial(name_in, file)
        )
        told = why_black or verdict(image.render, image.final, interrupted, integrator, file)
        return Result(
            image.developed(),
            layers.get("error", image.render.error()),
            image.render.counts(),
            reached.noise,
            bound,
            f"{told}. {lost}" if lost else told,
            layers["final"],
        )


def load(caller: str, scene: AnyScene, folder: Path) -> tuple[mi.Scene, SceneFile | None]:
    """Returns the loaded ``scene``, and its file, which has files in ``folder``; raises RuntimeError, about ``caller``,
    for a scalar variant or none.
    """
    if mi.variant() is None:
        raise RuntimeError(f"{caller}: no variant is set; set one before, such as mi.set_variant('llvm_ad_rgb').")
    if str(mi.variant()).startswith("scalar"):
        raise RuntimeError(f"{caller}: scalar variants do not render progressively; use an llvm or cuda variant.")
    if isinstance(scene, Mapping):
        refuse_none(caller, scene)
        check_parameters(mi.parser.parse_dict(mi.parser.ParserConfig(str(mi.variant())), dict(scene)))
        scene = mi.load_dict(dict(scene))
    if isinstance(scene, (str, Path)):
        file = SceneFile(scene, folder)
        return file.load(), file
    require_scene(caller, scene)
    return scene, None


def refuse_none(caller: str, entries: Mapping[str, Any], place: str = "") -> None:
    """Raises ValueError, about ``caller``, for a value None in a scene's dictionary, which would end the process."""
    for name, value in entries.items():
        if value is None:
            raise ValueError(f'{caller}: "{place}{name}" is None, which is no value of a scene; leave it out.')
        if isinstance(value, Mapping):
            refuse_none(caller, value, f"{place}{name}.")


@contextmanager
def reporter(progress: bool | Callable[[float], object]) -> Iterator[Callable[[float], object]]:
    """Yields the function that reports the progress, 0 to 1: ``progress`` itself, or one that moves a bar."""
    if callable(progress):
        yield progress
        return
    form = "{l_bar}{bar}| {elapsed}"
    with tqdm(total=1.0, desc="rendering", disable=not progress, leave=False, bar_format=form) as bar:
        yield lambda done: bar.update(done - bar.n)


def show(scene: AnyScene, **how: Any) -> Result:
    """Renders as :func:`.render`, shows the image in a notebook meanwhile, and returns the image with its error.

    ``scene``
        A Mitsuba scene, the dictionary of one, or the path of a scene file in the thesis's scene language or in XML.
    ``how``
        Arguments of :func:`.render` but ``progress``.

    If you interrupt the kernel, the render ends after the current work item, and the image so far is the result. The
    last image stays in the notebook file. Raises ImportError without IPython, and the errors of :func:`.render`.
    """
    try:
        from IPython.display import display
    except ImportError as error:
        raise ImportError(extras.needs("show", "notebooks")) from error
    interruptions, place = list[bool](), display({"text/plain": "compiling kernels"}, raw=True, display_id=True)

    def draw(image: ProgressiveImage, due: bool) -> bool:
        if due and place is not None:  # None: IPython is not running
            with image.throttle.drawing():
                shown = {"image/png": as_png(image.layers()["final"]), "text/plain": f"{image.progress:.0%}"}
                place.update(shown, raw=True)
        return bool(interruptions)

    try:
        with interrupting(lambda: interruptions.append(True)):
            result = converge("show", scene, draw, **how)
    except BaseException:
        if place is not None:
            place.update({"text/plain": "not rendered"}, raw=True)
        raise
    if place is not None:
        text, picture = {"text/plain": result.verdict}, as_png(result.colours)
        place.update(text | {"image/png": picture}, metadata={"image/png": {"alt": result.verdict}}, raw=True)
    return result


@contextmanager
def interrupting(stop: Callable[[], object]) -> Iterator[None]:
    """Inside the ``with`` block, an interruption of the notebook's kernel calls ``stop`` and raises no exception, which
    would leave an unfinished trace in Dr.Jit. Only the main thread is interrupted.
    """
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    previous_handler = signal.signal(signal.SIGINT, lambda *_: stop())
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, previous_handler)
