"""States of images as files: to the bit, whole or refused, and from time to time."""

import errno
import json
from pathlib import Path
from types import SimpleNamespace

import mitsuba as mi
import numpy as np
import OpenEXR
import pytest
from mitsuba_prosim import saved
from mitsuba_prosim.engine.record import Record
from mitsuba_prosim.live.loaded_scene import LoadedScene
from mitsuba_prosim.saved import files, origin
from mitsuba_prosim.saved.keeper import Keeper
from mitsuba_prosim.scene import atomic, scene_file

FACTS = {
    "samples": {"seed": 0, "window": [0, 0, 5, 3]},
    "sampling": {"adaptive": "none"},
    "part": None,
    "region": [0, 0, 5, 3],
    "known": [-1, -2, 4, 1],
    "noise": 0.1 + 0.2,
    "effort": float("nan"),
    "seconds": 1e-300,
    "finished": True,
}


def record(**facts):
    rng = np.random.default_rng(1)
    bits = rng.integers(0, 2**32, (4, 3, 5), dtype=np.uint32)  # whatever 32 bits may be: NaNs, denormals, -0
    bits[0, 0, :4] = 0x7FC12345, 0xFF812345, 0x80000000, 1
    pixels = {"sum+0-1.R": bits[0].view(np.float32), "total": bits[1].view(np.float32), "count": bits[2]}
    twin = {"total": bits[3].view(np.float32).ravel(), "count": bits[0].ravel()}
    return Record(FACTS | facts, pixels, twin, {"R": bits[2].view(np.float32)[:2]}, {"job": {"scene": "é\udcff"}})


def same(a, b):
    return list(a) == list(b) and all(a[k].dtype == b[k].dtype and a[k].tobytes() == b[k].tobytes() for k in a)


def parts(of=3, **facts):
    empty = {"total": np.zeros((3, 5), np.float32), "count": np.zeros((3, 5), np.uint32)}
    return [
        Record(FACTS | {"part": [k, of], "tiles": [2, 1], **facts}, empty, {}, {}, {"digest": "a"})
        for k in range(1, of + 1)
    ]


def change(path, **values):
    """Another value of what a state says of itself."""
    file = OpenEXR.File(str(path), separate_channels=True)
    header = file.parts[0].header
    header |= files.attributes(json.loads(header[files.ATTRIBUTE]) | values)
    file.write(str(path))


@pytest.mark.parametrize("part", [None, [1, 3]])
def test_a_state_is_read_as_it_was_written(variant_rgb, tmp_path, part):
    before = record(part=part)
    saved.save(before, tmp_path / "a.state.exr")
    after = saved.load(tmp_path / "a.state.exr")
    for name in ("pixels", "twin", "image"):
        mine, theirs = (dict(sorted(getattr(r, name).items())) for r in (before, after))
        assert same(mine, theirs), name
    assert json.dumps(after.facts) == json.dumps(before.facts) and after.about == before.about
    header = OpenEXR.File(str(tmp_path / "a.state.exr"), separate_channels=True, header_only=True).parts[0].header
    assert [list(v) for v in header["dataWindow"]] == [[-1, -2], [3, 0]]


def test_what_is_no_whole_state_is_refused(variant_rgb, tmp_path, capfd):
    path = tmp_path / "a.state.exr"
    saved.save(record(), path)
    content = path.read_bytes()
    for size in (0, 5, 300, len(content) // 2, len(content) - 90, len(content) - 1):
        path.write_bytes(content[:size])
        with pytest.raises(saved.StateError, match=r"no state of a render|is not whole|is damaged"):
            saved.load(path)
    place = content.rindex(np.uint32(0x7FC12345).tobytes())
    path.write_bytes(content[:place] + b"\0" + content[place + 1 :])
    with pytest.raises(saved.StateError, match="is damaged"):
        saved.load(path)
    path.write_bytes(content.replace(b'"seed": 0', b'"seed": 2'))
    with pytest.raises(saved.StateError, match="is damaged: what it says of itself"):
        saved.load(path)
    OpenEXR.File({}, {"R": np.zeros((2, 2), np.float32)}).write(str(path))
    with pytest.raises(saved.NoStateError, match="no state of a render"):
        saved.load(path)
    with pytest.raises(FileNotFoundError):
        saved.load(tmp_path / "nothing")
    with pytest.raises(OSError, match="/dev/full"):
        files.put(record(), Path("/dev/full"))


def test_where_a_state_comes_from(variant_rgb, tmp_path):
    path, here = tmp_path / "a.state.exr", origin.here()
    assert all(here.values()) and here["variant"] == mi.variant()
    saved.save(record(), path)
    for name, says in [
        ("mitsuba-prosim", "mitsuba-prosim 0.0 there"),
        ("variant", "variant 0.0 there, llvm_ad_rgb here"),
    ]:
        change(path, origin=here | {name: "0.0"})
        with pytest.raises(saved.StateError, match=says):
            saved.load(path)
    change(path, origin=here | {"processor": "another"})
    with pytest.warns(UserWarning, match="processor another there"):
        saved.load(path)
    change(path, origin=here, format=files.FORMAT + 1)
    with pytest.raises(saved.StateError, match=r"has format \d+, and this version reads format"):
        saved.load(path)


def test_parts_that_are_missing_doubled_unfinished_or_of_another_image(variant_rgb, tmp_path):
    first, second, third, foreign, other, open_, whole = paths = [tmp_path / f"{name}.exr" for name in "123fouw"]
    of_two = parts(2)
    more = [parts(samples={"seed": 7, "window": [0, 0, 5, 3]})[2], of_two[1], parts(finished=False)[2], record()]
    for path, part in zip(paths, parts() + more):
        saved.save(part, path)
    for names, says in [
        ([first, third], "of 3 parts, part 2 is missing"),
        ([second], "of 3 parts, parts 1, 3 are missing"),
        ([first, second, third, second], "2.exr is part 2-of-3, as .*2.exr is already"),
        ([first, second, foreign], "f.exr is not of the image that .*1.exr is a part of .seed: 7 here, 0 there"),
        ([first, other], "number of parts: 2 here, 3 there"),
        ([first, second, open_], "u.exr is not finished; go on with it first: prosim resume"),
        ([first, whole, third], "w.exr is the state of a whole image"),
        ([], "no parts"),
    ]:
        with pytest.raises(saved.StateError, match=says):
            saved.merge(names)
    here = origin.here()
    for path in first, second:
        change(path, origin=here | {"processor": "another"})
    with pytest.warns(UserWarning, match=r"^2 of 3 parts were made elsewhere \(processor another there") as said:
        merged = saved.merge([third, first, second])
    assert len(said) == 1
    assert merged.part is None and merged.facts["seconds"] == pytest.approx(3e-300, rel=1e-9)


def test_a_state_is_written_every_few_seconds_and_seldom_where_that_takes_long(tmp_path, variant_rgb, monkeypatch):
    clock, cost, wait, written, said = [0.0], [0.01], [0.0], [], []

    def write(contents):
        written.append(clock[0])
        clock[0] += cost[0] + wait[0]
        processor[0] += cost[0]
        if cost[0] < 0:
            raise OSError(errno.ENOSPC, "full")
        return list(contents)

    processor = [0.0]
    monkeypatch.setattr("time.perf_counter", lambda: clock[0])
    monkeypatch.setattr("time.thread_time", lambda: processor[0])
    monkeypatch.setattr("drjit.thread_count", lambda: 4)
    monkeypatch.setattr(atomic, "write", write)
    keeper, render = Keeper(tmp_path / "a", {}, said.append), SimpleNamespace(checkpoint=record)

    def until(seconds):
        del written[:]
        while clock[0] < seconds:
            keeper(render)
            if keeper.writer is not None:
                keeper.writer.join()
            clock[0] += 0.25
        return np.diff(written)

    assert np.all(np.abs(until(60) - 4.1) <= 0.25)
    cost[0] = 0.5
    assert np.all(np.abs(until(200)[2:] - 6.85) <= 0.25)  # a fiftieth of four processors
    cost[0] = 2.0
    assert np.all(np.abs(until(600)[2:] - 27.1) <= 0.25)
    cost[0], wait[0] = 0.01, 3.0
    assert np.all(np.abs(until(800)[2:] - 12.1) <= 0.25)  # a slow disk
    wait[0] = 0.0
    cost[0] = -1e-9
    until(clock[0] + 100)
    assert len(written) > 10 and len(said) == 1 and "full; the render goes on" in said[0]
    keeper(render, True)
    assert keeper.unwritten is not None
    keeper.unwritten(tmp_path / "b")
    assert (tmp_path / "b").read_bytes()[:4] == b"\x76\x2f\x31\x01"


def test_the_digest_is_that_of_the_content(variant_rgb, tmp_path):
    """Of the text and of all that it names, wherever these lie; comments have no say."""

    def made(folder, text="", colour=1.0, name="picture.exr", said=None, **definitions):
        folder.mkdir()
        OpenEXR.File({}, {c: np.full((2, 2), colour, np.float32) for c in "RGB"}).write(str(folder / name))
        (folder / "more.xml").write_text(f'<scene version="3.0.0">{text}</scene>')
        (folder / "scene.xml").write_text(
            '<scene version="3.0.0"><default name="x" value="1"/><include filename="more.xml"/><emitter type="envmap">'
            f'<string name="filename" value="{said or name}"/></emitter></scene>'
        )
        file = scene_file.SceneFile(folder / "scene.xml", folder, definitions=definitions)
        assert name in dict(file.named_files())
        return file.digest()

    first = made(tmp_path / "a")
    assert made(tmp_path / "b") == first == made(tmp_path / "c", "<!-- nothing -->")
    assert made(tmp_path / "d", name=str(tmp_path / "another.exr")) == first
    assert made(tmp_path / "e", colour=0.5) != first
    assert made(tmp_path / "f", '<emitter type="constant"/>') != first
    named = {"name": "sky.7.exr", "said": "sky.$x.exr", "x": "7"}
    assert made(tmp_path / "g", **named) == made(tmp_path / "h", **named) != made(tmp_path / "i", **named, colour=0.5)


def test_a_spectrum_in_another_folder_is_a_file_of_the_scene(variant_rgb, tmp_path):
    """What includes a file has Mitsuba look in its own folder first."""
    part, spectrum, digests = tmp_path / "parts" / "part.xml", tmp_path / "parts" / "grey.spd", set()
    part.parent.mkdir()
    said = '<bsdf type="diffuse"><spectrum name="reflectance" filename="$grey.spd"/></bsdf>'
    part.write_text('<scene version="3.0.0"><include filename="more.xml"/></scene>')
    (part.parent / "more.xml").write_text(f'<scene version="3.0.0"><default name="grey" value="grey"/>{said}</scene>')
    (tmp_path / "scene.xml").write_text('<scene version="3.0.0"><include filename="parts/part.xml"/></scene>')
    for value in (0.5, 0.6):
        spectrum.write_text(f"400 {value}\n700 {value}")
        file = scene_file.SceneFile(tmp_path / "scene.xml", tmp_path)
        assert file.named_files() == [("$grey.spd", spectrum)]
        digests.add(file.digest())
    assert len(digests) == 2


def test_a_mesh_of_the_language_is_a_source_but_does_not_travel(variant_rgb, tmp_path):
    """The translation has what it says. What is watched is its own file, and its content is part of the digest."""
    path, mesh = tmp_path / "s.scn", tmp_path / "parts" / "wedge.obj"
    mesh.parent.mkdir()
    path.write_text("LIGHTS POINT position 9 9 9 CSG-TREE MESH 0 parts/wedge.obj SURFACE 0 TRANSFORM 0 END")
    digests = set()
    for top in (1, 2):
        mesh.write_text(f"v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 {top}\nf 1 3 2\nf 1 2 4\nf 2 3 4\nf 1 4 3")
        file = scene_file.SceneFile(path, tmp_path / "made")
        names = [path for _, path in file.named_files()]
        assert mesh not in names and file.sources() == [*names, mesh]
        scene = LoadedScene(path, lambda _, file=file: (file, loaded := file.load(), loaded.sensors()[0]))
        assert scene.files == [mesh] and scene.scene.bbox().max.z == top
        digests.add(file.digest())
    assert len(digests) == 2
