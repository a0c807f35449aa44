"""The grammar by properties: parsing, formatting, and files that are nearly right; the canonical layout."""

import dataclasses
import random
import re
from pathlib import Path

import prosim_scene
import pytest
from prosim_scene import SceneError, model
from prosim_scene.geometry.solids import matrices
from prosim_scene.language.reader import Reader
from prosim_scene.language.words import ROLES, TRANSLATIONS, WORDS, WORDS_BY_SPELLING, find_word, normalise

ROOT = Path(__file__).parents[2]
EXAMPLES = sorted((ROOT / "examples").glob("*.scn"))
PAGES = [(ROOT / "docs" / f"{name}.md").read_text(encoding="utf-8") for name in ("language", "coming_from")]
MANUAL = re.findall(r"```scn\n(.*?)```", "".join(PAGES), re.DOTALL)
TEXTS = [*map(prosim_scene.read, EXAMPLES), *(text for text in MANUAL if "END" in text)]
GAPS = [*[" "] * 12, "\n", "\n\n", "\t", " (observação) ", "\n(a (b)\n  c)\n", " # remark (\n", '\n# "x\n']

pytestmark = pytest.mark.filterwarnings("ignore::prosim_scene.SceneWarning")


def variant(text, rng):
    """The same scene in other spellings, with other comments and white space."""
    pieces = []
    for token in Reader(text).tokens:
        if token.role == "COMMENT":
            continue
        word = text[token.start : token.end]
        if token.role in ROLES and word[0] not in "${":
            word = rng.choice(find_word(token.role, token.text).spellings)
            word = rng.choice([word, word.upper(), word.lower(), word.title()])
            word += rng.choice(["", "", ":", " ="]) if find_word(token.role, token.text).numbers.count else ""
        # A parenthesis after SCALE is its argument, not a comment.
        pieces += [word, " " if token.role == "STEP" else rng.choice(GAPS)]
    return "".join(pieces) + rng.choice(["", "\n", " (fim)\n", "\n(fim)\n# fim"])


def mutated(text, rng):
    """The text with parts removed, inserted or moved."""
    for _ in range(rng.randint(1, 4)):
        a, b, c = sorted(rng.randrange(len(text) + 1) for _ in range(3))
        b, c = min(b, a + 40), min(c, a + 80)
        inserted = rng.choice([*'()#"+-*\n', "", "SCALE ", "END ", "1e400", "nan", "t-", " 3 ", "{$x}", text[b:c]])
        text = text[:a] + inserted + text[b:]
    return text


def check(text, folder=None):
    """Reading, formatting and translation end, in a scene or in a SceneError."""
    try:
        scene = prosim_scene.parse(text, "x.scn")
    except SceneError:
        return
    assert prosim_scene.parse(prosim_scene.format(text, "x.scn"), "x.scn") == scene
    if folder and len(scene.csg) < 20:
        path = folder / "x.scn"
        path.write_text(text, encoding="utf-8")
        try:
            written = prosim_scene.translate(path, tolerance=200)  # coarse: only the end matters
        except SceneError:
            return
        assert written.read_text().endswith("</scene>\n")


@pytest.mark.parametrize("number", range(len(TEXTS)))
def test_spellings_comments_and_layout_do_not_change_the_scene(number):
    text, rng = TEXTS[number], random.Random(number)
    scene, other = prosim_scene.parse(text, "x.scn"), variant(text, rng)
    assert prosim_scene.parse(other, "x.scn") == scene
    assert prosim_scene.parse(prosim_scene.format(text), "x.scn") == scene
    tidy = prosim_scene.format(other, "x.scn")
    assert prosim_scene.parse(tidy, "x.scn") == scene and prosim_scene.format(tidy, "x.scn") == tidy
    for comment in ("(observação)", "(a (b)", "# remark ("):
        assert tidy.count(comment) == other.count(comment)
    assert spelled(tidy) == spelled(other)


def spelled(text):
    """The words and numbers of a scene, as the writer wrote them; parentheses belong to the layout."""
    tokens = Reader(text).tokens
    return [text[t.start : t.end] for t in tokens if t.role not in ("COMMENT", "LPAR", "RPAR")]


@pytest.mark.parametrize("path", EXAMPLES, ids=lambda path: path.stem)
def test_examples_are_formatted_and_use_one_language(path):
    """Those of this project are in English; palito.scn has the words of the thesis."""
    text = prosim_scene.read(path)
    assert prosim_scene.format(text, path) == text
    used = {normalise(word) for word in spelled(text)} - {path.stem}  # NAME is no word of the language
    english, portuguese = ({normalise(word) for words in column for word in words} for column in zip(*TRANSLATIONS))
    expected = {"composto", "condutor", "obs", "raio", "rug", "t-tijolo", "t-listra"}
    assert (used & portuguese) - english == (expected if path.stem == "palito" else set())


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(10))
def test_mutated_scenes_raise_scene_errors_or_nothing(seed, tmp_path):
    rng = random.Random(seed)
    for _ in range(50):
        check(mutated(variant(rng.choice(TEXTS), rng), rng))
    for _ in range(10):
        check(mutated(rng.choice(MANUAL), rng), tmp_path)


def test_every_row_has_one_meaning_and_sets_a_field_of_the_model():
    for same_spelling in WORDS_BY_SPELLING.values():
        assert len({word.role for word in same_spelling}) == len(same_spelling)
    owners = {"SETTING": model.Scene, "LIGHT_PARAMETER": model.Light, "VIEW_PARAMETER": model.View}
    owners |= dict.fromkeys(["CHOICE", "METHOD_PARAMETER"], model.Method)
    owners |= dict.fromkeys(["OPTIC", "METAL", "MATERIAL"], model.Surface)
    for word in WORDS:
        if word.role in owners:
            assert word.name in {field.name for field in dataclasses.fields(owners[word.role])}, word


# ---- The canonical layout, and files that are rewritten in it

REST = "\n".join(f"SURFACE {i}\nTRANSFORM {i}" for i in range(5)) + "\nEND\n"


def tree(text):
    """The lines of the tree in canonical layout, without the common indentation."""
    tidy = prosim_scene.format(f"CSG-TREE {text}\n{REST}")
    assert prosim_scene.format(tidy) == tidy
    lines = tidy[: tidy.index("\nSURFACE 0")].splitlines()[1:]
    return "\n".join(line[4:] for line in lines).rstrip()


def test_the_tree_shows_its_shape():
    assert tree("+ + + CUBE 0 CUBE 1 CUBE 2 CUBE 3") == "+ + +\n    CUBE 0\n    CUBE 1\n    CUBE 2\n    CUBE 3"
    assert tree("- + CUBE 0 SPHERE 1 - CYLINDER 2 * CONE 3 CUBE 4") == (
        "- +\n    CUBE 0\n    SPHERE 1\n    -\n        CYLINDER 2\n        *\n            CONE 3\n            CUBE 4"
    )
    assert tree("cubo 0 t-tijolo") == "cubo 0 t-tijolo"


def test_formatter_keeps_comments_before_the_next_word():
    assert tree("- (a)\n CUBE 0 (b)\n(c)\n# d\n + CUBE 1 CUBE 2 # e") == (
        "- (a)\n    CUBE 0 (b)\n    (c)\n    # d\n    +\n        CUBE 1\n        CUBE 2 # e"
    )
    assert tree("+ (a) - CUBE 0 CUBE 1 CUBE 2") == "+ (a)\n    -\n        CUBE 0\n        CUBE 1\n    CUBE 2"


def test_words_and_numbers_stay_as_the_writer_wrote_them():
    tidy = prosim_scene.format("texture t-x fractal escala=03.50 TRANSFORM 0 Escala 1. .2 +3 Fim")
    assert tidy == "texture t-x\n    fractal\n    escala = 03.50\n\nTRANSFORM 0\n    Escala (1. .2 +3)\n\nFim\n"
    tidy = prosim_scene.format("TEXTURE t-x brick tijolo 1 TEXTURE t-tijolo brick = 1 1 1 END")
    assert tidy.startswith("TEXTURE t-x\n    brick\n    tijolo = 1\n\nTEXTURE t-tijolo\n    brick = 1 1 1\n")
    assert "    VRP 0 8 10 -\n" in prosim_scene.format("VIEW VRP 0 8 10 - OBS 0 0 9 END")


TURNED = "ROTATE-X (30) SCALE (2 1 3) TRANSLATE (4 5 6)"


@pytest.mark.parametrize("last", ["", " 0 0 0 1"])
@pytest.mark.parametrize("parentheses", ["({})", "{}"])
def test_matrix_is_a_step(last, parentheses):
    """Row by row, with the translation in the fourth column, and after the steps before it."""

    def matrix(steps, written=str):
        tree = "CSG-TREE + CUBE 0 CUBE 1 SURFACE 0 SURFACE 1 TRANSFORM 1 MATRIX 1 0 0 0 0 1 0 0 0 0 1 0"
        transforms = prosim_scene.parse(written(f"{tree} TRANSFORM 0 {steps} END")).transforms
        return matrices([transforms[0], transforms[1]])[0]

    rows = matrix(TURNED)[:3].ravel().tolist()
    step = f"MATRIX {parentheses.format(' '.join(map(repr, rows)) + last)}"
    assert matrix(step)[:3].ravel() == pytest.approx(rows)
    for written in (str, prosim_scene.format):
        assert matrix(f"ROTATE-Z (20) {step}", written) == pytest.approx(matrix(f"ROTATE-Z (20) {TURNED}"), abs=1e-12)
