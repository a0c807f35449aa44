"""Image files, as far as Mitsuba tells them by their first bytes, whatever their names end in."""

from pathlib import Path

#: What a file begins with, by format.
BEGINNINGS: dict[str, tuple[bytes, ...]] = {
    "PNG": (b"\x89PNG\r\n\x1a\n",),
    "JPEG": (b"\xff\xd8",),
    "OpenEXR": (b"\x76\x2f\x31\x01",),
    "RGBE": (b"#?",),
    "PFM": (b"PF", b"Pf"),
    "PPM": (b"P6",),
    "BMP": (b"BM",),
}

#: What a TGA file ends with, of version 2, the only one that Mitsuba knows.
TGA = b"TRUEVISION-XFILE.\0"


def is_picture(path: Path) -> bool:
    """Whether ``path`` is a picture of some format that Mitsuba reads. Raises OSError where it can't be read."""
    with path.open("rb") as file:
        head = file.read(8)
        file.seek(max(path.stat().st_size - len(TGA), 0))
        return file.read() == TGA or any(head.startswith(beginning) for beginning in BEGINNINGS.values())
