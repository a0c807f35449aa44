"""A damaged checkpoint, part, frame or image is refused by one message, or the damage is where nothing is read.

Each test damages a file at random places, with a fixed seed.
"""

import json
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from mitsuba_prosim.cli import frames
from mitsuba_prosim.engine import checkpoint
from mitsuba_prosim.engine.checkpoint import PIXELS, SECOND, Checkpoint, CheckpointError
from running import ADAPTIVE_PATH, LIT_FLOOR, done, metadata, pixels, prosim, scene_text
from test_resume_and_merge import die_after

pytestmark = pytest.mark.slow

#: Number of damaged files of each test.
ROUNDS = 300

#: Values that JSON can give, wrong for most attributes.
VALUES = [
    *(None, True, False, 0, 1, -1, 7, 2**31, 2**70, -0.5, 1.5, 1e308, float("inf"), float("nan")),
    *("", "x", "none", "é\udcff", "\0", "9" * 5000, [], [1], [0, 0, 0, 0], [[1, "plain", 1]], ["a"] * 300, {}),
    {"a": 1},
]


@pytest.fixture
def lamp(scene):
    """Its checkpoints have few sums, because no filter reaches other pixels."""
    text = scene_text(ADAPTIVE_PATH, LIT_FLOOR, 8, 6)
    scene.write_text(text.replace("</film>", '<rfilter type="box"/></film>'))
    return scene


@pytest.fixture
def state(lamp, monkeypatch):
    """An unfinished render, with a second image and a current pass."""
    with monkeypatch.context() as patch:
        die_after(patch, 4)
        assert prosim("render", lamp, "--noise", 0.01, "--exposure", 1, "--checkpoint").exit_code != 0
    return lamp.with_name("scene.state.npz")


@pytest.fixture
def part(lamp):
    done("render", lamp, "--part", "1/2", "--adaptive", "none")
    return lamp.with_name("scene.1-of-2.npz")


def flipped(content, rng):
    """A copy of ``content`` in which a bit or a byte is different, often in the first or the last bytes."""
    copy, last = bytearray(content), len(content) - 1
    place = rng.choice([rng.integers(last + 1), min(rng.integers(900), last), max(last - rng.integers(900), 0)])
    copy[place] ^= 1 << rng.integers(8) if rng.random() < 0.5 else rng.integers(1, 256)
    return bytes(copy)


def truncated(content, rng):
    return content[: rng.choice([rng.integers(len(content)), len(content) - 1 - rng.integers(200)])]


def bits(found):
    """All that a checkpoint contains, as one text."""
    arrays = [
        (name, values.dtype.str, values.tobytes())
        for group in (found.pixels, found.second)
        for name, values in sorted(group.items())
    ]
    return json.dumps([found.attributes, found.about, found.environment], sort_keys=True) + repr(arrays)


@pytest.mark.parametrize("kind", ["state", "part"])
@pytest.mark.parametrize("damage", [flipped, truncated])
def test_damaged_checkpoint_is_refused_or_has_the_same_content(kind, damage, request):
    path, rng = request.getfixturevalue(kind), np.random.default_rng(1)
    content, whole, refused = path.read_bytes(), bits(checkpoint.load(path)), 0
    for _ in range(ROUNDS):
        path.write_bytes(damage(content, rng))
        try:
            assert bits(checkpoint.load(path)) == whole
        except CheckpointError:
            refused += 1
    assert refused > 0.8 * ROUNDS


def places(value, place=()):
    """All places in a JSON value: the names and indices that lead there."""
    items = value.items() if isinstance(value, dict) else enumerate(value) if isinstance(value, list) else ()
    for name, inner in items:
        yield *place, name
        yield from places(inner, (*place, name))


def with_wrong_value(header, rng):
    """A copy of the attributes, of which one has another value, or is missing, or an additional one."""
    copy = json.loads(json.dumps(header))
    every = list(places(copy))
    *path, name = every[rng.integers(len(every))]
    parent = copy
    for step in path:
        parent = parent[step]
    if (how := rng.random()) < 0.1:
        del parent[name]
    elif how < 0.2 and isinstance(parent, dict):
        parent[f"{name}x"] = parent[name]
    else:
        parent[name] = VALUES[rng.integers(len(VALUES))]
    return copy


def test_wrong_attribute_of_a_checkpoint_is_no_internal_error(state, lamp):
    """A Python program writes the checkpoint: a render continues, or ends with one message."""
    rng, saved, codes = np.random.default_rng(3), checkpoint.load(state), []
    names = "attributes", "about", "environment"
    header = {name: getattr(saved, name) for name in names}
    header["attributes"] |= {"estimates": [[4.5, 0.5]]}
    sampling = header["attributes"]["sampling"]
    lists = [{**header, "attributes": header["attributes"] | {"sampling": sampling | {name: [1]}}} for name in sampling]
    for other in [*lists, *(with_wrong_value(header, rng) for _ in range(ROUNDS // 3))]:
        checkpoint.save(
            Checkpoint(pixels=saved.pixels, second=saved.second, **{name: other.get(name) for name in names}), state
        )
        result = prosim("resume", state, "--noise", 0.1, "--scene", lamp, "-o", state.with_name("a"))
        codes.append(result.exit_code)
        assert result.exit_code in (0, 2) and isinstance(result.exception, SystemExit | None), (other, result.exception)
    assert codes.count(2) > 0.4 * len(codes)


def test_wrong_arrays_of_a_checkpoint_are_refused(state, lamp):
    saved = checkpoint.load(state)
    first = saved.pixels["total"]
    for group, other in [
        (PIXELS, {"total": first[:-1]}),
        (PIXELS, {"total": first.astype(np.float16)}),
        (PIXELS, {"total": first.reshape(1, -1)}),
        (PIXELS, {"total": None}),
        (PIXELS, {"index": None}),
        (PIXELS, {"sum0": None}),
        (PIXELS, {"more": first}),
        (PIXELS, {"wanted": first}),
        (PIXELS, {"index": np.zeros_like(saved.pixels["index"])}),
        (PIXELS, {"count": first}),
        (SECOND, {"total": None}),
        (SECOND, {"count": saved.second["total"]}),
        (SECOND, {"total": saved.second["total"][1:]}),
    ]:
        name = group[:-1]
        arrays = {key: values for key, values in ({**getattr(saved, name)} | other).items() if values is not None}
        checkpoint.save(replace(saved, **{name: arrays}), state)
        result = prosim("resume", state, "--scene", lamp)
        assert result.exit_code == 2 and isinstance(result.exception, SystemExit), (group, [*other], result.output)


@pytest.mark.parametrize("damage", [flipped, truncated])
@pytest.mark.parametrize("suffix", [".exr", ".png"])
def test_damaged_frame_is_rendered_again(lamp, damage, suffix):
    rng, stem = np.random.default_rng(4), lamp.with_name("scene.0006")
    lamp.write_text(lamp.read_text().replace('"6"', '"$frame"'))
    done("render", lamp, "--frames", "6")
    digest = metadata(stem.with_name("scene.0006.exr"))["digest"]
    task = SimpleNamespace(stem=stem, facts={frames.DIGEST: digest})
    assert frames.is_rendered(task)
    path = stem.with_name(stem.name + suffix)
    content = path.read_bytes()
    for _ in range(ROUNDS):
        path.write_bytes(damage(content, rng))
        assert not frames.is_rendered(task)


@pytest.mark.parametrize("damage", [flipped, truncated])
def test_damaged_image_is_not_mixed(lamp, damage, tmp_path):
    rng, image = np.random.default_rng(5), tmp_path / "a.exr"
    lamp.write_text(scene_text('<integrator type="prosim"/>', LIT_FLOOR, 8, 6))
    done("render", lamp, "--layers", "lights", "-o", image)
    content, mixing = image.read_bytes(), ("mix", image, "lamp1=0.5", "-o", tmp_path / "b")
    done(*mixing)
    whole = pixels(tmp_path / "b.exr")
    for _ in range(ROUNDS):
        image.write_bytes(damage(content, rng))
        result = prosim(*mixing)
        assert result.exit_code in (0, 2) and isinstance(result.exception, SystemExit | None), result.exception
        if result.exit_code == 0:  # the damage hides the checksum
            assert np.array_equal(pixels(tmp_path / "b.exr"), whole)
