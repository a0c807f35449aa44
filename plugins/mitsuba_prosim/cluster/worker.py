"""What a worker of a cluster does: scenes that stay loaded, and samples of them.

All of it happens in one thread of the worker, whatever the number of its own: a portion has all the threads that Dr.Jit
was given, and two renders take turns.
"""

from __future__ import annotations

import gc
import time
import warnings
from collections import OrderedDict
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from functools import cache
from types import MappingProxyType
from typing import Any

import distributed
import drjit as dr
import mitsuba as mi
import prosim_scene

from ..engine.plan import Plan
from ..engine.policies import POLICIES
from ..photons.caustics import Which
from ..photons.grid import Photons
from ..saved import origin
from ..scene import session
from . import message
from .parcel import Parcel

#: Scenes that stay loaded, with their kernels; and plans of each.
SCENES, PLANS = 4, 8

#: The photons of a set, on diffuse surfaces and on glossy ones, as they travel.
Packed = tuple[Mapping[str, Any], "Mapping[str, Any] | None"]


@dataclass(frozen=True)
class Greeting:
    """What a worker says of itself. ``threads``: that it works with; ``loaded``: whether it has the scene already."""

    origin: Mapping[str, str]
    threads: int
    loaded: bool


@dataclass(frozen=True)
class Done:
    """What has come of an errand: for a portion what :func:`.message.answer` returns. ``before``: seconds until it was
    begun with, whatever its size (Dr.Jit follows the code anew); ``seconds``: that it took; ``drawing``: that photons
    took, which stay for the next portions.
    """

    what: Any
    before: float
    seconds: float
    drawing: float = 0.0


class Loaded:
    """A scene that is ready to be sampled."""

    def __init__(self, parcel: Parcel) -> None:
        self.scene, sensor = parcel.load()
        integrator: Any = self.scene.integrator()
        sensor.film().prepare(integrator.aov_names())
        self.make = lambda plan: integrator.estimator(plan, self.scene, sensor)
        self.estimator: Any = None
        self.plans: OrderedDict[Any, tuple[Plan, Any]] = OrderedDict()

    def take(self, asked: Mapping[str, Any], photons: Mapping[Which, Packed | None] = MappingProxyType({})) -> Done:
        """The samples of a :func:`.message.request`. ``photons``: of the sets that others have drawn."""
        begun, drawn = time.perf_counter(), self.drawn
        plan, policy = self.follow(asked["plan"])
        for which, packed in photons.items():
            if packed is not None and not self.estimator.transport.caustics.has(which):
                self.estimator.transport.caustics.put(which, unpacked(packed))
        before = time.perf_counter() - begun
        what = message.answer(message.portion(asked, plan, policy, self.estimator).take(), asked["pixels"])
        drawing = self.drawn - drawn
        return Done(what, before, time.perf_counter() - begun - before - drawing, drawing)

    def follow(self, said: tuple[Any, ...]) -> tuple[Plan, Any]:
        """Makes ready for the plan of which that is said; it, and its policy."""
        plan, policy = recent(self.plans, said, lambda: planned(said), PLANS)
        if self.estimator is None:
            self.estimator = self.make(plan)
        return plan, policy

    def draw(self, said: tuple[Any, ...], which: Which) -> Packed:
        """The photons of a set, for samples by the plan of which that is said."""
        self.follow(said)
        diffuse, glossy = self.estimator.transport.caustics.photons(which)
        return diffuse.packed(), None if glossy is None else glossy.packed()

    @property
    def drawn(self) -> float:
        """Seconds that photons have taken."""
        caustics = None if self.estimator is None else self.estimator.transport.caustics
        return 0.0 if caustics is None else caustics.seconds


#: By their keys, that used last at the end; of one variant.
scenes: OrderedDict[tuple[str, str], Loaded] = OrderedDict()


def greet(variant: str, key: str) -> Greeting:
    """Makes the worker ready for a variant, to work with as many threads as Dask has given to it; where it shares the
    process of its client, with those that this has.

    Raises ImportError or RuntimeError where it has no such variant.
    """
    here = distributed.get_worker()
    threads, shared = here.state.nthreads, here.address.startswith("inproc:")

    def greeted() -> Greeting:
        if not shared:
            dr.set_thread_count(threads)
            warnings.simplefilter("ignore", prosim_scene.SceneWarning)  # who asks has seen them
        choose(variant)
        return Greeting(origin.here(), dr.thread_count(), (variant, key) in scenes)

    return hand().submit(greeted).result()


def load(variant: str, parcel: Parcel, before: str | None, names: list[str], *contents: bytes) -> None:
    """Loads a scene, of which the ``contents`` by ``names`` are not in the ``parcel`` itself. ``before``: key of one
    that is needed no more, so that this one has its place, and its kernels: their code goes by where things lie in
    Dr.Jit's tables.
    """

    def loaded() -> Loaded:
        choose(variant)
        forget(variant, before)
        whole = completed(parcel, names, contents)
        return recent(scenes, (variant, parcel.key), lambda: Loaded(whole), SCENES)

    hand().submit(loaded).result()


def take(
    variant: str, key: str, asked: Mapping[str, Any], sets: Sequence[Which] = (), *photons: Packed | None
) -> Done | None:
    """The samples of a :func:`.message.request`; None where that scene is not loaded any more. ``photons``: what
    :func:`draw` has returned of ``sets``.
    """

    def taken() -> Done | None:
        choose(variant)
        if (variant, key) not in scenes:
            return None
        scene: Loaded = recent(scenes, (variant, key), lambda: None, SCENES)
        return scene.take(asked, dict(zip(sets, photons)))

    return hand().submit(taken).result()


def draw(variant: str, key: str, said: tuple[Any, ...], which: Which) -> Packed | None:
    """The photons of a set, for all workers; None where that scene is not loaded any more: each draws them then.
    ``said``: of a plan by which samples are taken that need them.
    """

    def drawn() -> Packed | None:
        choose(variant)
        scene = scenes.get((variant, key))
        return None if scene is None else scene.draw(said, which)

    return hand().submit(drawn).result()


def unpacked(packed: Packed) -> tuple[Photons, Photons | None]:
    """The photons that :meth:`Loaded.draw` has packed."""
    diffuse, glossy = packed
    return Photons.unpacked(diffuse), None if glossy is None else Photons.unpacked(glossy)


def make(
    variant: str,
    parcel: Parcel,
    before: str | None,
    names: list[str],
    render: Callable[..., Any],
    arguments: tuple[Any, ...],
    *contents: bytes,
) -> Done | None:
    """What ``render(scene, sensor, wanted, *arguments)`` returns for the scene of a parcel, which is then forgotten;
    None where nobody waits for it any more. ``before``, ``names``, ``contents``: as for :func:`load`.
    """
    wanted = still_wanted()

    def made() -> Done | None:
        if not wanted():
            return None
        start = time.perf_counter()
        choose(variant)
        forget(variant, before)
        what = render(*completed(parcel, names, contents).load(), wanted, *arguments)
        return Done(what, 0.0, time.perf_counter() - start)

    return hand().submit(made).result()


def still_wanted() -> Callable[[], bool]:
    """Says whether Dask still wants the task that calls this."""
    here = distributed.get_worker()
    key, tasks = here.get_current_task(), here.state.tasks

    def wanted() -> bool:
        task = tasks.get(key)
        return task is not None and task.state == "executing"

    return wanted


def completed(parcel: Parcel, names: list[str], contents: tuple[bytes, ...]) -> Parcel:
    """A parcel with the contents that have travelled beside it."""
    return replace(parcel, contents={**parcel.contents, **dict(zip(names, contents))})


def forget(variant: str, key: str | None) -> None:
    """Makes room for another scene."""
    if scenes.pop((variant, key or ""), None) is not None:
        gc.collect()  # scenes go round in circles


def choose(variant: str) -> None:
    """Sets the variant, if it is another."""
    if mi.variant() != variant:
        session.set_variant(variant)


def planned(said: tuple[Any, ...]) -> tuple[Plan, Any]:
    """The plan of which this is said, and the policy that goes with it."""
    plan = message.plan_of(said)
    return plan, POLICIES[plan.sampling.adaptive](plan, plan.sampling.threshold)


def recent(kept: OrderedDict, key: Any, make: Callable[[], Any], most: int) -> Any:
    """What is ``kept`` under ``key``, or is made; before, the ones that were used longest ago make room."""
    if key not in kept:
        while len(kept) >= most:
            kept.popitem(last=False)
        kept[key] = make()
    kept.move_to_end(key)
    return kept[key]


@cache
def hand() -> ThreadPoolExecutor:
    """The thread that does it all."""
    return ThreadPoolExecutor(1, "prosim")
