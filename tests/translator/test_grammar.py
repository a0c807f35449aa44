"""The grammar by properties: parsing, formatting, and files that are nearly right."""

import dataclasses
import itertools
import warnings
from pathlib import Path

import prosim_scene
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from prosim_scene import SceneError, model
from prosim_scene.language.words import ROWS, WORDS, normalise

EXAMPLES = Path(__file__).parents[2] / "examples"

pytestmark = pytest.mark.filterwarnings("ignore::prosim_scene.SceneWarning")
quick = settings(max_examples=30, deadline=None, suppress_health_check=list(HealthCheck))

# ---- Scenes as token lists, so that remarks and layout can be put between any two tokens -----------------------------

number = (
    st.floats(-1e6, 1e6).map(repr) | st.integers(-999, 999).map(str) | st.sampled_from(["80.", ".5", "-18.", "1e-3"])
)
positive = st.floats(1e-3, 1e3).map(repr)
unit = st.floats(0, 1).map(repr)


def word(spelling):
    """Any spelling of a keyword, in any case."""
    return st.sampled_from(ROWS[normalise(spelling)][0].spellings).flatmap(
        lambda w: st.sampled_from([w, w.upper(), w.lower(), w.title()])
    )


def words(spelling, *values):
    """A keyword and its values, flat."""
    return st.tuples(word(spelling), st.sampled_from([[], [":"], ["="]]), *values).map(
        lambda t: [t[0], *t[1], *(x for v in t[2:] for x in (v if isinstance(v, list | tuple) else [v]))]
    )


def some(*options):
    """Any of the given token lists, each at most once, in any order."""
    return (
        st.lists(st.sampled_from(range(len(options))), unique=True)
        .flatmap(lambda chosen: st.tuples(*(options[i] for i in chosen)))
        .map(lambda lists: [t for tokens in lists for t in tokens])
    )


def three(value):
    return st.lists(value, min_size=3, max_size=3)


light = st.tuples(
    word("AREA") | word("POINT"),
    words("POSITION", three(number)),
    some(
        words("INTENSITY", three(positive)),
        words("raio", positive),
        words("EXPONENT", positive),
        words("DIRECTION", st.just(["0", "-1", ".5"])),
        words("ANGLE", st.just("45")),
        st.sampled_from(["UNIFORM", "CONE", "SPOT", "uniforme"]).map(lambda w: [w]),
    ),
).map(lambda t: [t[0], *t[1], *t[2]])

view = some(
    words("RESOLUTION", st.just(["40", "30"])),
    words("WINDOW", st.just(["-1", "-2", "3", "4"])),
    words("OBS", three(number)),
    words("VPN", three(number)),
    words("VRP", three(number), st.sampled_from([[], ["-"]])),
    words("VUP", three(number)),
)

surface = st.one_of(
    st.tuples(word("MATERIAL"), word("lambertiano")).map(list),
    st.tuples(word("MATERIAL"), word("condutor"), st.sampled_from(["ouro", "Cu", "silver"])).map(list),
    st.tuples(word("MATERIAL"), word("dieletrico"), words("n-refr", positive)).map(lambda t: [*t[:2], *t[2]]),
    st.tuples(
        word("MATERIAL"), word("dieletrico"), st.sampled_from(["bk7", "Água"]), words("transmitância", st.just(".25"))
    ).map(lambda t: [*t[:3], *t[3]]),
    some(words("KA", three(unit)), words("KD", three(unit)), words("KS", unit), words("RUG", positive)),
    some(words("KD", unit), words("m", st.floats(1e-3, 1).map(repr))),
)
step = st.one_of(
    st.tuples(st.sampled_from(["SCALE", "escala"]), st.booleans(), three(positive)),
    st.tuples(st.sampled_from(["TRANSLATE", "translação"]), st.booleans(), three(number)),
    st.tuples(
        st.sampled_from(["ROTATE-X", "rotate-y", "ROTATE-Z"]), st.booleans(), st.lists(number, min_size=1, max_size=1)
    ),
).map(lambda t: [t[0], *(["(", *t[2], ")"] if t[1] else t[2])])
slot = st.sampled_from(["NULL", "t-tijolo", "T-LISTRA", "t-fractal", "t-x", "nulo"])


@st.composite
def scenes(draw):
    """The tokens of a correct scene; a tuple of tokens belongs together."""
    leaves = draw(st.integers(1, 6))
    tree, need, left = [], 1, leaves - 1
    while need:
        if left and (need == 1 or draw(st.booleans())):
            tree.append(draw(st.sampled_from("+-*")))
            left, need = left - 1, need + 1
        else:
            tree += [
                draw(word("CUBE") | word("SPHERE") | word("CYLINDER") | word("CONE")),
                str(draw(st.integers(0, 3))),
                *draw(st.lists(slot, max_size=2)),
            ]
            need -= 1
    flag = st.sampled_from(["TRUE", "FALSE", "sim", "não", "1", "0"])
    statements = [
        words("NAME", st.sampled_from(["palito", "END", "CUBE", '"a b (c)"', "x.y", "1992"])),
        words("SAVE-RGB", st.just("TRUE"), flag, flag),
        words("MAX-LEVEL", st.just("2.")),
        words("NSAMPLES", st.just("3")),
        words("DO-SHADOW", flag),
        words("CAUSTICS", flag),
        words("AIR-INDEX", positive),
        words("AMBIENT", three(positive)),
        words("BACKGROUND", three(positive), st.sampled_from([[], ["NULL"], ["ceu.exr"], ['"o céu.exr"']])),
        st.tuples(word("LIGHTS"), st.lists(light, max_size=3)).map(lambda t: [t[0], *(x for li in t[1] for x in li)]),
        st.tuples(word("VIEW"), view).map(lambda t: [t[0], *t[1]]),
    ]
    chosen = [draw(s) for s in statements if draw(st.booleans())] + [[draw(word("CSG-TREE")), *tree]]
    chosen += [[draw(word("SURFACE")), str(i), *draw(surface)] for i in range(4)]
    chosen += [
        [draw(word("TRANSFORM")), str(i), *(x for s in draw(st.lists(step, max_size=3)) for x in s)] for i in range(4)
    ]
    chosen.append(
        [
            draw(word("TEXTURE")),
            "t-x",
            draw(word("FRACTAL")),
            *draw(some(words("COLOR0", three(unit)), words("OCTAVES", st.just("3")), words("SCALE", positive))),
        ]
    )
    draw(st.randoms(use_true_random=False)).shuffle(chosen)
    return [t for statement in chosen for t in statement] + [draw(word("END"))]


TAKES_ARGUMENT = {normalise(w) for row in WORDS if row.role == "STEP" for w in row.spellings}


@st.composite
def texts(draw):
    """A correct scene with remarks and white space anywhere."""
    tokens = draw(scenes())
    gaps = st.sampled_from(
        [" "] * 12 + ["\n", "\n\n", "\t", " (observação) ", "\n(a (b)\n  c)\n", " # remark (\n", '\n# "x\n']
    )
    pieces = []
    for token in tokens:
        gap = draw(gaps)
        # A parenthesis after SCALE is its argument, not a remark.
        pieces += [" " if pieces and normalise(pieces[-1].strip()) in TAKES_ARGUMENT else gap, token]
    return "".join(pieces) + draw(st.sampled_from(["", "\n", " (fim)\n", "\n(fim)\n# fim"]))


def plain(tokens):
    return " ".join(tokens)


@quick
@given(texts())
def test_formatting_keeps_the_meaning_and_the_remarks(text):
    scene = prosim_scene.parse(text, "x.scn")
    tidy = prosim_scene.format(text, "x.scn")
    assert prosim_scene.parse(tidy, "x.scn") == scene
    assert prosim_scene.format(tidy, "x.scn") == tidy
    for remark in ("(observação)", "(a (b)", "# remark ("):
        assert tidy.count(remark) == text.count(remark)


@pytest.mark.slow
@quick
@given(st.data())
def test_remarks_and_layout_do_not_change_the_meaning(data):
    tokens = data.draw(scenes())
    scene = prosim_scene.parse(plain(tokens))
    with_remarks = [tokens[0]]
    for before, token in itertools.pairwise(tokens):
        remark = "" if normalise(before) in TAKES_ARGUMENT else data.draw(st.sampled_from(["", "(x)", "#y\n"]))
        with_remarks += [remark, token]
    assert prosim_scene.parse("\n".join(with_remarks)) == scene


def judge(text):
    """Reading and formatting end, in a scene or in a SceneError."""
    try:
        scene = prosim_scene.parse(text, "x.scn")
    except SceneError:
        with pytest.raises(SceneError) as error:
            prosim_scene.format(text, "x.scn")
        assert len(str(error.value)) < 5000
    else:
        assert prosim_scene.parse(prosim_scene.format(text, "x.scn"), "x.scn") == scene


@pytest.mark.slow
@quick
@given(texts(), st.data())
def test_mutated_scenes_raise_scene_errors_or_nothing(text, data):
    for _ in range(data.draw(st.integers(1, 4))):
        a = data.draw(st.integers(0, len(text)))
        b = data.draw(st.integers(a, min(len(text), a + 40)))
        insert = data.draw(
            st.sampled_from(["", "(", ")", "#", '"', "+", "-", "*", "\n", "SCALE", "END", "1e400", "nan", "t-"])
            | st.text(max_size=5)
        )
        text = text[:a] + insert + text[b:]
    judge(text)


@pytest.mark.slow
@quick
@given(
    st.lists(
        st.sampled_from(
            [w for row in WORDS for w in row.spellings] + list('()+-*=:"#\n') + ["0", "1.5", "t-a", "a.png"]
        )
    ).map(" ".join)
    | st.text()
)
def test_any_text_raises_scene_errors_or_nothing(text):
    judge(text)


@pytest.mark.slow
@settings(max_examples=8, deadline=None, derandomize=True, suppress_health_check=list(HealthCheck))
@given(scenes())
def test_whole_translations_raise_scene_errors_or_nothing(tmp_path_factory, tokens):
    path = tmp_path_factory.mktemp("scene") / "x.scn"
    path.write_text(plain(tokens), encoding="utf-8")
    try:
        written = prosim_scene.translate(path, tolerance=200)  # coarse: only that it ends is wanted
    except SceneError:
        assert [p.name for p in path.parent.iterdir()] == ["x.scn"]
    else:
        assert written.read_text().endswith("</scene>\n")


@pytest.mark.parametrize("path", sorted(EXAMPLES.glob("*.scn")), ids=lambda p: p.stem)
def test_examples(path):
    text = prosim_scene.read(path)
    tidy = prosim_scene.format(text, path)
    assert prosim_scene.parse(tidy, path) == prosim_scene.parse(text, path)
    assert prosim_scene.format(tidy, path) == tidy


def test_both_languages_say_the_same():
    english = """NAME: a MAX-LEVEL: 2 DO-SHADOW: TRUE CAUSTICS: YES BACKGROUND: 1000 2000 3000 NONE
    LIGHTS AREA position 1 2 3 Intensity 4000 5000 6000 radius 7 SPOT direction 0 -1 0 angle 30 exponent 8
    VIEW RESOLUTION 10 10 OBSERVER 0 0 9
    CSG-TREE + + + CUBE 0 SPHERE 1 CYLINDER 2 CONE 3
    SURFACE 0 material conductor silver roughness = 5  SURFACE 1 material dielectric n-refr = 1.5
    SURFACE 2 material lambertian kd = .5  SURFACE 3 material composite n-refr = 1.5
    TRANSFORM 0 SCALE (1 2 3)  TRANSFORM 1 ROTATE-X (90)  TRANSFORM 2 TRANSLATE (1 2 3)  TRANSFORM 3 END"""
    portuguese = """NOME: a NÍVEL-MÁXIMO: 2 SOMBRA: SIM CÁUSTICAS: SIM FUNDO: 1000 2000 3000 NENHUM
    FONTES EXTENSA posição 1 2 3 intensidade 4000 5000 6000 raio 7 SPOT direção 0 -1 0 ângulo 30 expoente 8
    VISTA RESOLUÇÃO 10 10 OBSERVADOR 0 0 9
    ÁRVORE-CSG + + + CUBO 0 ESFERA 1 CILINDRO 2 CONE 3
    SUPERFÍCIE 0 material condutor prata rugosidade = 5  SUPERFÍCIE 1 material dielétrico n-refr = 1.5
    SUPERFÍCIE 2 material lambertiano kd = .5  SUPERFÍCIE 3 material composto n-refr = 1.5
    TRANSFORMAÇÃO 0 ESCALA (1 2 3)  TRANSFORMAÇÃO 1 ROTAÇÃO-X (90)  TRANSFORMAÇÃO 2 TRANSLAÇÃO (1 2 3)
    TRANSFORMAÇÃO 3 FIM"""
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert prosim_scene.parse(english) == prosim_scene.parse(portuguese)


def test_no_word_means_two_things_in_one_place():
    for rows in ROWS.values():
        assert len({(row.role) for row in rows}) == len(rows)


def test_every_row_sets_a_field_of_the_model():
    owners = {
        "SETTING": model.Scene,
        "LIGHT_PARAMETER": model.Light,
        "VIEW_PARAMETER": model.View,
        "VRP": model.View,
        "OPTIC": model.Surface,
        "METAL": model.Surface,
        "MATERIAL": model.Surface,
    }
    for row in WORDS:
        if row.role in owners:
            assert row.name in {field.name for field in dataclasses.fields(owners[row.role])}, row
