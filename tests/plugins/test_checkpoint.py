"""Checkpoints as files: to the bit, complete or refused, and from time to time."""

import errno
import json
import tracemalloc
import zipfile
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import mitsuba as mi
import numpy as np
import OpenEXR
import pytest
from mitsuba_prosim import atomic
from mitsuba_prosim.engine import checkpoint, environment, plan
from mitsuba_prosim.engine.checkpoint import Checkpoint, CheckpointError, CheckpointWriter, NotACheckpointError
from scenes import penumbra

SAMPLING = dict.fromkeys(plan.SAMPLING, 0) | {"adaptive": "none"}
ATTRIBUTES = {
    "samples": {"seed": 0, "window": [0, 0, 5, 3]},
    "sampling": SAMPLING,
    "part": None,
    "uses_sobol": True,
    "shared": 0,
    "noise": [0.1 + 0.2, float("nan"), float("inf")],
    "estimates": [[4.5, 0.25]],
    "rounds": 1,
    "seconds": 1e-300,
    "finished": True,
}


def made(**attributes):
    rng = np.random.default_rng(1)
    bits = rng.integers(0, 2**32, (3, 15), dtype=np.uint32)  # whatever 32 bits may be: NaNs, denormals, -0
    bits[0, :4] = 0x7FC12345, 0xFF812345, 0x80000000, 1
    pixels = {"total": bits[0].view(np.float32), "index": bits[1]}
    return Checkpoint(ATTRIBUTES | attributes, pixels, {"total": bits[2]}, {"job": {"scene": "é\udcff"}})


def parts(of=3, **attributes):
    return [
        Checkpoint(ATTRIBUTES | {"part": [k, of], **attributes}, {"index": np.arange(k)}, {}, {"digest": "a"})
        for k in range(1, of + 1)
    ]


def test_a_checkpoint_is_read_as_it_was_written(variant_rgb, tmp_path):
    before, path = made(), tmp_path / "a.state.npz"
    checkpoint.save(before, path)
    after = checkpoint.load(path)
    mine, theirs = (
        [(name, array.dtype, array.tobytes()) for part in (c.pixels, c.second) for name, array in part.items()]
        for c in (before, after)
    )
    assert mine == theirs
    assert json.dumps(after.attributes) == json.dumps(before.attributes) and after.about == before.about


def test_truncated_checkpoint_is_refused(variant_rgb, tmp_path):
    path = tmp_path / "a.state.npz"
    checkpoint.save(made(), path)
    content = path.read_bytes()
    for size in (0, 5, 300, len(content) // 2, len(content) - 90, len(content) - 1):
        path.write_bytes(content[:size])
        with pytest.raises(CheckpointError, match=r"is no checkpoint|is damaged or not complete"):
            checkpoint.load(path)
    seed, sead = (f'"{name}"'.encode("utf-32-le") for name in ("seed", "sead"))  # as a file of NumPy has texts
    for old, new in ((np.uint32(0x7FC12345).tobytes(), bytes(4)), (seed, sead)):
        assert old in content
        path.write_bytes(content.replace(old, new))
        with pytest.raises(CheckpointError, match="is damaged"):
            checkpoint.load(path)
    OpenEXR.File({}, {"R": np.zeros((2, 2), np.float32)}).write(str(path))
    np.savez(tmp_path / "another.npz", image=np.zeros(5))
    for foreign in path, tmp_path / "another.npz":
        with pytest.raises(NotACheckpointError, match="is no checkpoint"):
            checkpoint.load(foreign)
    with pytest.raises(FileNotFoundError):
        checkpoint.load(tmp_path / "nothing")
    with pytest.raises(OSError, match="No space"):
        made().write(Path("/dev/full"))


def test_checkpoint_with_a_flipped_bit_in_the_header_of_an_array_is_refused(variant_rgb, tmp_path):
    """A shorter header of NumPy hides the end of the member, where zipfile compares the checksum."""
    path = tmp_path / "a.state.npz"
    checkpoint.save(replace(made(), pixels={"total": np.ones(10**5, np.float32)}), path)
    content = bytearray(path.read_bytes())
    begin = content.index(b"\x93NUMPY", content.index(b"pixels.total.npy"))
    content[begin + 8] ^= 2  # the length of the header
    path.write_bytes(content)
    with pytest.raises(CheckpointError, match="is damaged"):
        checkpoint.load(path)


@pytest.mark.parametrize("compression", [zipfile.ZIP_DEFLATED, zipfile.ZIP_LZMA])
def test_checkpoint_with_compressed_members_is_refused_before_they_are_read(variant_rgb, tmp_path, compression):
    path = tmp_path / "a.state.npz"
    checkpoint.save(made(), path)
    with zipfile.ZipFile(path) as archive:
        members = {name: archive.read(name) for name in archive.namelist()}
    few, many = members["pixels.total.npy"], bytes(4 * 10**6)
    members["pixels.total.npy"] = few.replace(b"(15,)       ", b"(1000000,)  ") + many
    with zipfile.ZipFile(path, "w", compression, compresslevel=1) as archive:
        for name, content in members.items():
            archive.writestr(name, content)
    del members, few, many
    tracemalloc.start()
    try:
        with pytest.raises(CheckpointError, match="is damaged"):
            checkpoint.load(path)
        assert tracemalloc.get_traced_memory()[1] < 10**6
    finally:
        tracemalloc.stop()


def test_a_checkpoint_of_another_version_or_variant_is_refused(variant_rgb, tmp_path, monkeypatch):
    path, here = tmp_path / "a.state.npz", environment.this_environment()
    assert all(here.values()) and here["variant"] == mi.variant()
    for name, says in ("mitsuba-prosim", "here"), ("variant", "llvm_ad_rgb here"):
        checkpoint.save(replace(made(), environment=here | {name: "0.0"}), path)
        with pytest.raises(CheckpointError, match=f"{name} 0.0 there, .*{says}"):
            checkpoint.load(path)
    checkpoint.save(replace(made(), environment=here | {"processor": "another"}), path)
    with pytest.warns(UserWarning, match="processor another there"):
        checkpoint.load(path)
    with monkeypatch.context() as patch:
        patch.setattr(checkpoint, "FORMAT", checkpoint.FORMAT + 1)
        checkpoint.save(made(), path)
    with pytest.raises(CheckpointError, match=r"has format \d+, and this version reads format"):
        checkpoint.load(path)


def test_parts_that_are_missing_doubled_unfinished_or_of_another_image_are_refused(variant_rgb, tmp_path):
    first, second, third, foreign, other, open_, whole = paths = [tmp_path / f"{name}.npz" for name in "123fouw"]
    more = [parts(samples={"seed": 7, "window": [0, 0, 5, 3]})[2], parts(2)[1], parts(finished=False)[2], made()]
    for path, part in zip(paths, parts() + more):
        checkpoint.save(part, path)
    for names, says in [
        ([first, third], "of 3 parts, these are missing: 2"),
        ([second], "of 3 parts, these are missing: 1, 3"),
        ([first, second, third, first.parent / "." / "2.npz", whole], "is the state of a whole image"),
        ([first, second, foreign], "f.npz is not of the image that .*1.npz is a part of .seed: 7 here, 0 there"),
        ([first, other], "number of parts: 2 here, 3 there"),
        ([first, second, open_], "u.npz is not finished; continue it first: prosim resume"),
        ([first, whole, third], "w.npz is the state of a whole image"),
    ]:
        with pytest.raises(CheckpointError, match=says):
            checkpoint.merge(names)
    (tmp_path / "copy.npz").write_bytes(second.read_bytes())
    with pytest.raises(CheckpointError, match=r"2.npz: another file has the same part"):
        checkpoint.merge([first, second, third, tmp_path / "copy.npz"])
    elsewhere = environment.this_environment() | {"processor": "another"}
    for path, part in zip((first, second), parts()):
        checkpoint.save(replace(part, environment=elsewhere), path)
    with pytest.warns(UserWarning, match=r"^made elsewhere: .*1.npz \(processor another .*; .*2.npz \(") as said:
        merged = checkpoint.merge([third, first, second])
    assert len(said) == 1
    assert merged.part is None and merged.attributes["seconds"] == pytest.approx(3e-300, rel=1e-9)


def test_a_checkpoint_is_written_every_few_seconds_and_seldom_if_that_takes_long(tmp_path, variant_rgb, monkeypatch):
    clock, cost, written = [0.0], [0.01], []

    def write(contents):
        written.append(clock[0])
        clock[0] += abs(cost[0])
        if cost[0] < 0:
            raise OSError(errno.ENOSPC, "full")

    monkeypatch.setattr("time.perf_counter", lambda: clock[0])
    monkeypatch.setattr(atomic, "write", write)
    writer, render = CheckpointWriter(tmp_path / "a", {}), SimpleNamespace(checkpoint=made)

    def until(seconds):
        del written[:]
        while clock[0] < seconds:
            writer(render)
            clock[0] += 0.25
        return np.diff(written)

    assert np.all(np.abs(until(60) - 4.1) <= 0.25)
    cost[0] = 0.5
    assert np.all(np.abs(until(300)[2:] - 25.5) <= 0.25)  # a fiftieth of the time
    cost[0] = -0.01
    with pytest.warns(UserWarning, match="full; the render continues") as said:
        until(clock[0] + 100)
    assert len(written) > 10 and len(said) == 1


@pytest.mark.parametrize("wrong", [{"begin": "here.state.npz"}, {"part": (1, 4)}])
def test_names_of_files_and_pairs_are_not_checkpoints_and_parts(variant_rgb, wrong):
    scene = mi.load_dict(penumbra(size=4, type="prosim"))
    with pytest.raises(TypeError, match=r"prosim: .* is .*; give a (Checkpoint|Part) of mitsuba_prosim.engine"):
        scene.integrator().progressive(scene, **wrong)
