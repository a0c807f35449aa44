"""What may be meant by options that there are not: those of other renderers, and what one would guess."""

import re

#: An option of commands which have what is meant -> what they say of it, and of the names that are guessed for it.
SAID = (
    (
        "--resolution",
        "The size of the image is --resolution WxH, such as --resolution 640x480.",
        "--width --height --size --res --dimensions --image-size --film-size -w -r -W -H +w +h",
    ),
    (
        "--mode",
        "What computes is said by -m VARIANT, such as -m llvm_ad_rgb for the processor and -m cuda_ad_rgb for a GPU of "
        "NVIDIA's; prosim doctor says which this machine can run.",
        "--variant --backend --device --gpu --cuda --cpu --llvm --metal --optix",
    ),
    (
        "--paths",
        "The scene says its integrator; --paths follows every path of light, as path does.",
        "--integrator --gi --global-illumination --path-tracing --renderer --engine",
    ),
    (
        "--max-level",
        "How deep rays are followed is --max-level, such as --max-level 8.",
        "--max-depth --depth --bounces --max-bounces --recursion --rr-depth",
    ),
    ("--rounds", "Name integrators after the scene: prosim compare SCENE prosim path.", "--integrator --with"),
    (
        "--samples",
        "Samples are --samples N, at most N*N a pixel, or --spp, or as many as --noise or --time ask for.",
        "--sample-count --samples-per-pixel --sampling --aa --antialiasing --antialias --passes -n +a +am +r +j",
    ),
    (
        "--noise",
        "How good the image is to be is --noise, such as --noise 0.005, or --samples, or --time.",
        "--quality --error --tolerable-noise --rmse +q",
    ),
    ("--time", "The time is --time SECONDS, such as --time 60.", "--timeout --time-limit --max-time --seconds"),
    ("--threads", "The number of threads is -t, such as -t 4.", "--nthreads --cores --jobs --processors --cpus -j +wt"),
    ("--sensor", "Which of the scene's cameras is -s, such as -s 1.", "--camera --cam -c"),
    ("--crop", "A part of the image is --crop X,Y,W,H.", "--region --border --roi"),
    ("--exposure", "The PNG is made brighter by --exposure STOPS.", "--gamma --brightness --tonemap --tone-mapping"),
    ("--denoise", "An image is denoised by --denoise.", "--denoiser --oidn"),
    (
        "--frames",
        "Frames are --frames, such as --frames 0:48.",
        "--frame --animation --film --start --end --nframes +k +kf +kff +kfi +ki",
    ),
    (
        "--keep",
        "A render that may be gone on with is one with --keep; prosim resume goes on with it.",
        "--resume --continue --checkpoint --save +c",
    ),
    ("--view", "prosim watch shows the image while the scene is written.", "--preview --gui --live +d"),
    (
        "--exposure",
        "-o says where the image goes; it is written as EXR and as PNG.",
        "--format --png --exr --out --image --filename -f +o +f +fn",
    ),
)  # fmt: skip
#: An option as POV-Ray has it: a plus, letters and a value.
PLUS = re.compile(r"(?<![^\s('])\+[a-z]+(?=[\d.]|[\s')]|$)", re.IGNORECASE)
GUESSED: dict[str, dict[str, str]] = {}
for _option, _said, _names in SAID:
    for _name in _names.split():
        GUESSED.setdefault(_name, {})[_option] = _said


def meant(guess: str, known: set[str]) -> str | None:
    """What to say of an option that a command has not which has those ``known``; None where nothing is meant by it."""
    rows = GUESSED.get(guess.lower() if len(guess) > 2 else guess, {})
    return next((said for option, said in rows.items() if option in known), None)


def meant_by_plus(message: str, known: set[str]) -> str | None:
    """What to say of the first option with a plus that a message is about, as :func:`meant` does."""
    found = (meant(guess.lower(), known) for guess in PLUS.findall(message))
    return next((said for said in found if said), None)
