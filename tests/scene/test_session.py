"""Messages of Mitsuba's errors, variants, and threads that load scenes."""

import threading

import drjit as dr
import mitsuba as mi
import pytest
from mitsuba_prosim.engine.estimator import Estimator
from mitsuba_prosim.scene import scene_file, session


def test_message_without_a_traceback_and_with_its_cause():
    cause = RuntimeError(
        "could not load:\nTraceback (most recent call last):\n  File a, line 1\nValueError: it is wrong"
    )
    error = RuntimeError("dr.while_loop(): encountered an exception (see above).")
    error.__cause__ = cause
    assert (
        session.message(error) == "dr.while_loop(): encountered an exception (see above). could not load:\nit is wrong"
    )


def test_a_variant_without_its_backend(monkeypatch):
    before = mi.variant()
    monkeypatch.setattr(session, "has_backend", lambda variant: variant.startswith("scalar"))
    with pytest.raises(RuntimeError, match="cuda_ad_rgb needs an NVIDIA GPU"):
        session.set_variant("cuda_ad_rgb")
    assert mi.variant() == before and session.default_variant() == "scalar_rgb"


@pytest.mark.parametrize("integrator, parallel", [("prosim", False), ("path", True)])
def test_scenes_with_plugins_in_python_are_not_made_in_parallel(
    variant_rgb, write_scene, monkeypatch, integrator, parallel
):
    """Mitsuba 3.9 fails now and then if they are."""
    path = write_scene(f'<scene version="3.0.0"><integrator type="{integrator}"/></scene>', "scene.xml")
    asked = []
    make = mi.parser.instantiate
    monkeypatch.setattr(
        mi.parser, "instantiate", lambda config, state: asked.append(config.parallel) or make(config, state)
    )
    scene_file.instantiate(scene_file.parse(path, {}))
    assert asked == [parallel]


@pytest.mark.parametrize("other", ["load", "trace"])
def test_while_a_scene_is_loaded_other_threads_neither_load_nor_trace(variant_rgb, tmp_path, monkeypatch, other):
    """Mitsuba has one search path and one number of threads for all, and kernels know of objects that are half made."""
    path = tmp_path / "scene.xml"
    film = '<film type="hdrfilm"><integer name="width" value="1"/><integer name="height" value="1"/></film>'
    path.write_text(
        f'<scene version="3.0.0"><integrator type="prosim"/><sensor type="perspective">{film}</sensor></scene>'
    )
    file = scene_file.SceneFile(path, tmp_path)
    scene, both, met = file.load(), threading.Barrier(2), []
    before = [str(folder) for folder in mi.file_resolver()], dr.thread_count()

    def meet(*_):
        try:
            both.wait(0.2)
            met.append("both")
        except threading.BrokenBarrierError:
            pass
        raise InterruptedError

    monkeypatch.setattr(scene_file, "instantiate", meet)
    monkeypatch.setattr(Estimator, "accumulate", meet)
    acts = {"load": file.load, "trace": lambda: scene.integrator().render(scene)}

    def act(name):
        with pytest.raises(InterruptedError):
            acts[name]()

    threads = [threading.Thread(target=act, args=(name,)) for name in ("load", other)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert not met and both.broken
    assert ([str(folder) for folder in mi.file_resolver()], dr.thread_count()) == before
