"""What an editor is told: the same as of a whole text, however it came to be."""

import json
import random
import re
from pathlib import Path

import prosim_scene
import pytest
from prosim_scene.editor import colours, meanings, metals, places
from prosim_scene.editor.completing import completions, hover
from prosim_scene.editor.evaluating import evaluate
from prosim_scene.language import trees
from prosim_scene.language.judging import judge
from prosim_scene.language.messages import MOST
from prosim_scene.language.names import METALS
from prosim_scene.language.reading import Reading
from prosim_scene.language.shapes import Shapes
from prosim_scene.language.words import WORDS

SCENE = """(a scene)
DEFAULT $turn = 30
NAME: a
LIGHTS AREA position 5 5 {$turn / 3} raio 2 # a remark
CSG-TREE + CUBE 0 t-listra - SPHERE 1 CYLINDER 1
(another (one))
SURFACE 0 material condutor ouro m = .1
SURFACE 1 kd = {$turn / 60} ks 0
TRANSFORM 0
TRANSFORM 1 ROTATE-Y ($turn) SCALE 2 2 2
TEXTURE t-mine fractal scale 3
END
"""


def told(text):
    """What is said of a text, in order, and the scene, if it is right."""
    found, document = judge(text if isinstance(text, Reading) else Reading(text))
    return sorted((one.start, one.end, one.reason, one.error) for one in found), document and document.scene


def labels(text, offset=None):
    """What fits at the bar in a text."""
    at = text.index("|")
    found = completions(Reading(text.replace("|", "", 1)), at)
    assert len({one.start for one in found}) <= 1
    return [one.label for one in sorted(found, key=lambda one: one.rank)]


@pytest.mark.filterwarnings("ignore::prosim_scene.SceneWarning")
def test_what_is_right_is_the_same_scene():
    found, scene = told(SCENE)
    assert not found and scene == prosim_scene.parse(SCENE)


@pytest.mark.parametrize(
    "text",
    ["VIEW OBS 1 2 END", "SURFACE 0 kd 1 2\nEND", "NSAMPLES {1/0} END", "CSG CUBE 1 - CUBE 2 END", "CSG (", "x", "CSG"],
)
def test_an_error_is_the_one_of_the_translator(text):
    with pytest.raises(prosim_scene.SceneError) as caught:
        prosim_scene.parse(text)
    found, scene = told(text)
    assert scene is None and found[-1][2] == caught.value.reason and found[-1][0] == caught.value.place.start


def test_every_wrong_statement_is_told_of():
    found, _ = told("VIEW OBS 1 2\nSURFACE 0 kd 1 2\nNSAMPLES 3 3\nNAMEX: y\nCSG (\nDEFAULT $a 2\nAMBIENT {$b} 1 1\n")
    assert [reason.split(";")[0] for *_, reason, _ in found] == [
        "found 2 numbers after OBS",
        "found 2 numbers after kd",
        "unknown word 'NAMEX'",
        "this remark is not closed",
        "nothing above says what $b stands for",
        "the file ends here and END is missing",
    ]
    assert [one[2] for one in told("SURFACE 0 ka 1\nSURFACE 0 ka 1 END")[0]] == [
        "SURFACE 0 is given twice; the first is on line 1"
    ]


def test_warnings_are_told_and_those_of_the_tree_too():
    found, document = judge(Reading(SCENE.replace("LIGHTS AREA", "# LIGHTS AREA")))
    assert [(one.reason, one.error) for one in found] == [("the scene has no lights", False)]
    hidden = SCENE.replace("- SPHERE 1 CYLINDER 1", "SPHERE 1").replace(
        "SCALE 2 2 2", "SCALE .1 .1 .1 TRANSLATE .5 .5 .5"
    )
    found, document = judge(Reading(hidden))
    assert not found and [one.reason for one in evaluate(document, None)] == [
        "nothing is seen of SPHERE 1 (line 5): no face of it is left in the result"
    ]


REGULAR = "\n".join(
    [
        "LIGHTS AREA position 9 9 9\nCSG-TREE\n+ - * + +\nCUBE 0 ESFERA 1 t-brick (leg 1) CONE: 2 NULL t-listra",
        "CUBE 3 a.png CUBE 4 # a foot\nCYLINDER 5",
        *(f"SURFACE {i} (the {i})\n  material composto n-refr = 1.{i} kd = .{i} .2 .1 ks .1" for i in range(6)),
        *(f"TRANSFORM {i} # {i}\n  SCALE (1 .{i + 1} 1) SCALE 1 2 1 ROTATE-X: {i}" for i in range(6)),
        "TEXTURE t-x stripes\nEND\n",
    ]
)

PIECES = [
    *"(){}#$\n 01.\"'",
    "END",
    "END\n",
    "$turn",
    "SURFACE 0 ",
    "\nSURFACE 1\n",
    "CUBE 0 ",
    "- ",
    "DEFAULT $turn = 4\n",
]


@pytest.mark.parametrize("seed", [0, 1, pytest.param(2, marks=pytest.mark.slow)])
def test_a_text_that_changes_is_read_as_if_it_were_new(seed):
    choice = random.Random(seed)
    scene = (SCENE, REGULAR)[seed % 2]
    text, reading = scene, Reading(scene)
    for _ in range(40):
        start = choice.randrange(len(text) + 1)
        end = min(len(text), start + choice.choice([0, 0, 1, 3, 40]))
        text = text[:start] + choice.choice([*PIECES, text[end : end + 30]]) + text[end:]
        reading.change(text)
        new = Reading(text)
        assert told(reading) == told(new)
        assert [(t.type, str(t), at) for _, t, at in reading.tokens()] == [
            (t.type, str(t), at) for _, t, at in new.tokens()
        ]
        if choice.random() < 0.2:
            text = scene
            reading.change(text)


@pytest.mark.parametrize("seed, count", [(0, 20), pytest.param(1, 60, marks=pytest.mark.slow)])
def test_what_is_filled_in_is_as_if_it_were_read_word_by_word(seed, count, monkeypatch):
    choice = random.Random(seed)
    texts = [REGULAR]
    for _ in range(count):
        words = re.split("( )", REGULAR)
        for at in choice.sample(range(0, len(words), 2), choice.choice([1, 1, 2, 5])):
            words[at] = choice.choice([*words, *PIECES, "1e999", "0", "-1", "2.5", "SURFCE", "(x", "9876543210"])
        texts.append("".join(words))
    known = [Reading(text) for text in texts]
    filled = [sum(unit.text is not None for unit in reading.units) for reading in known]
    assert filled[0] == 11 and sum(filled) > 6 * count  # the first of each shape is parsed
    monkeypatch.setattr(Shapes, "read", lambda *_: None)
    monkeypatch.setattr(trees, "read", lambda *_: None)
    for text, reading in zip(texts, known):
        parsed = Reading(text)
        assert told(reading) == told(parsed)
        document, expected = judge(reading)[1], judge(parsed)[1]
        assert document is None or dict(document.places) == dict(expected.places)
        assert [(t.type, str(t), at) for _, t, at in reading.tokens()] == [
            (t.type, str(t), at) for _, t, at in parsed.tokens()
        ]


def test_of_very_many_wrong_statements_the_first_are_told_and_nothing_that_follows():
    found, _ = told("CSG-TREE CUBE 999\n" + "".join(f"SURFACE {i} kd 2\n" for i in range(200)))
    assert {reason.split(";")[0] for *_, reason, _ in found} == {"found '2' after kd"} and len(found) == MOST + 1


def test_what_has_not_changed_is_not_read_again():
    reading = Reading(SCENE)
    before = list(reading.units)
    reading.change(SCENE.replace("kd =", "ka ="))
    assert [a is b for a, b in zip(before, reading.units)] == [True] * 5 + [False] + [True] * 4
    reading.change(SCENE)
    before = list(reading.units)
    reading.change(SCENE.replace("= 30", "= 60"))  # and what it means: of LIGHTS, SURFACE 1 and TRANSFORM 1
    assert [a is b for a, b in zip(before, reading.units)].count(True) == 6


def test_completion_knows_what_fits():
    assert labels("|")[:2] == ["DEFAULT", "NAME"] and "END" in labels("SUR|")
    assert labels(SCENE.replace("CUBE 0", "CUBE |"))[:2] == ["0", "1"]
    assert labels(SCENE.replace("CUBE 0", "CU|"))[:4] == ["CUBE", "SPHERE", "CYLINDER", "CONE"]
    assert labels(SCENE.replace("SURFACE 1", "SURFACE |"))[0] == "1"
    assert {"t-tijolo", "t-mine", "NULL"} <= set(labels(SCENE.replace("t-listra", "t-|")))
    assert {"ouro", "cobre", "cu_palik"} <= set(labels(SCENE.replace("ouro", "o|")))
    assert {"vidro", "diamante"} & set(labels("SURFACE 0 material dieletrico |"))
    assert labels("SURFACE 0 material |")[:4] == ["condutor", "dieletrico", "lambertiano", "composto"]
    assert labels(SCENE.replace("ks 0", "k|"))[:3] == ["material", "metal", "ka"]
    assert labels("DO-SHADOW |")[:2] == ["TRUE", "FALSE"]
    assert labels(SCENE.replace("$turn / 60", "s|"))[:4] == ["$frame", "$time", "$turn", "sin"]
    assert labels(SCENE.replace("ks 0", "ks |")) == ["$frame", "$time", "$turn"]
    for inside in SCENE.replace("remark", "re|m"), SCENE.replace("(one)", "(o|)"), SCENE + "x|", "NAME: |":
        assert not set(labels(inside)) & {"kd", "CUBE", "END"}


def test_hovering_says_what_is_meant():
    reading = Reading(SCENE)

    def said(word, shift=0):
        start, end, text = hover(reading, SCENE.index(word) + shift)
        assert start <= SCENE.index(word) + shift < end
        return text

    assert said("raio").startswith("**raio** the radius\n\nRadius of the sphere") and "radius" in said("raio")
    assert (
        "each 0 or more, 1 at most" in said("kd") and "in degrees" in said("ROTATE-Y") and "degrees" in said("ROTATE-Y")
    )
    assert "SURFACE 0 material condutor ouro" in said("0 t-l") and "TRANSFORM 0" in said("0 t-l")
    assert "Stripes" in said("t-listra") and "Au" in said("ouro") and "= 30" in said("$turn / 3")
    assert "1.5168" in hover(Reading("SURFACE 0 material dieletrico BK7 END"), 30)[2]
    assert "union" in said("+ CUBE") and hover(reading, SCENE.index("remark")) is None


def test_a_metal_says_what_it_is():
    said = hover(Reading(SCENE), SCENE.index("ouro"))[2]
    assert said.split("\n\n") == [
        "**gold**, the table Au",
        "Yellow: of white light that falls straight on it reflects 1.02 0.78 0.34 (red, green, blue)",
        "n = 0.239 and k = 2.97 at 589.3 nm; measured from 299 to 886 nm",
        "From: luxpop.com, which names no source",
        "Also: gold, au",
    ]
    assert set(metals.MEASURED) == set(METALS.values())
    wrong = SCENE.replace("ouro", "ouros")
    assert hover(Reading(wrong), wrong.index("ouros"))[2] == "a metal that nobody knows"
    colours = {name: metals.colour(metals.MEASURED[METALS[name]].rgb) for name in ("cu", "ag", "cr", "ni", "be", "ta")}
    assert list(colours.values()) == ["red", "white", "bluish light grey", "yellowish grey", "grey", "violet dark grey"]
    (gold,) = [one for one in completions(Reading(SCENE), SCENE.index("ouro")) if one.label == "ouro"]
    assert gold.detail == "Au" and gold.documentation == said


def test_every_word_has_a_meaning():
    for word in WORDS:
        assert meanings.described(word).startswith(f"**{word.canonical}**")
    assert set(meanings.MEANINGS) == {(word.role, word.name) for word in WORDS}


def test_symbols_are_found_and_renamed():
    reading = Reading(SCENE)
    here = places.at(reading, SCENE.index("SPHERE 1") + 7)
    assert [SCENE[: o.start].count("\n") for o in places.definitions(reading, here.symbol)] == [7, 9]
    for word, shift, new, count in (("SPHERE 1", 7, "7", 4), ("$turn", 1, "$angle", 4), ("t-mine", 2, "t-yours", 1)):
        here = places.at(reading, SCENE.index(word) + shift)
        found = places.renamed(reading, here.symbol, new)
        assert len(found) == count
        text = SCENE
        for one in reversed(found):
            text = text[: one.start] + new + text[one.end :]
        assert told(text)[1] is not None and here.symbol not in {o.symbol for o in places.occurrences(Reading(text))}
        assert len(list(places.occurrences(Reading(text)))) == len(list(places.occurrences(reading)))


def test_a_symbol_is_found_wherever_it_may_stand():
    text = """DEFAULT $a = 1 DEFAULT $ab = 2
CSG-TREE + CUBE: 07 + ESFERA (the (7) one) 7 - CONE # 7
7 CYLINDER={$a+$ab} t-7 SURFACE(a)7 kd {$a} 7 TRANSFORM 7 SCALE 7 7 7 TRANSFORM = 77
SURFACE 70 TEXTURE t-7 stripes seed 7 END 7"""
    for mark in ("\n", "\r\n"):
        reading = Reading(text.replace("\n", mark))
        symbols = {one.symbol for one in places.occurrences(reading)}
        assert len(symbols) == 6
        for symbol in symbols:
            everywhere = [one for one in places.occurrences(reading) if one.symbol == symbol]
            assert list(places.occurrences(reading, symbol)) == everywhere
        assert len(list(places.occurrences(reading, places.Symbol("index", "7")))) == 5


@pytest.mark.parametrize(
    "word, new, says",
    [("0 t-l", "1", "there already"), ("0 t-l", "x", "no index"), ("t-listra", "stripes", "t- and a word"),
     ("$turn", "a-b", "cannot be a name"), ("$turn", "$frame", "")],
)  # fmt: skip
def test_what_cannot_be_renamed(word, new, says):
    reading = Reading(SCENE)
    here = places.at(reading, SCENE.index(word))
    if says:
        with pytest.raises(ValueError, match=says):
            places.renamed(reading, here.symbol, new)


def test_the_grammar_of_editors_has_the_words_of_the_language():
    path = Path(__file__).parents[2] / "editors" / "vscode" / "syntaxes" / "scn.tmLanguage.json"
    assert json.loads(path.read_text()) == colours.textmate()  # python -m prosim_scene.editor.colours > PATH
    patterns = [re.compile(one["match"]) for one in colours.textmate()["patterns"] if "match" in one]
    for word in WORDS:
        for spelling in word.spellings:
            assert any((found := pattern.match(spelling)) and found.end() == len(spelling) for pattern in patterns)


def large(count):
    """A scene of so many primitives, of eight lines each."""
    names = [f"{('CUBE', 'SPHERE', 'CYLINDER', 'CONE')[i % 4]} {i}" for i in range(count)]
    tables = [
        f"SURFACE {i}\n  material lambertiano\n  kd = .5 .5 .4\nTRANSFORM {i}\n  SCALE (.4 .4 .4)\n  ROTATE-Y ({i})\n"
        f"  TRANSLATE ({i % 35} 0 {i // 35})" for i in range(count)
    ]  # fmt: skip
    return "\n".join(["LIGHTS AREA position 9 9 9", "CSG-TREE", "+ " * (count - 1), *names, *tables, "END\n"])


@pytest.mark.slow
def test_a_keystroke_in_a_long_scene_reads_one_statement_anew():
    """Of 10,000 lines; on a machine at rest it takes 40 to 60 ms."""
    text = large(1250)
    reading = Reading(text)
    assert not judge(reading)[0]
    for word in ("kd = ", "SCALE (", "position "):
        at = text.index(word, 0 if word == "position " else len(text) // 2) + len(word)
        text = text[:at] + "0" + text[at:]
        before = {id(unit) for unit in reading.units}
        reading.change(text)
        assert sum(id(unit) not in before for unit in reading.units) == 1 and len(reading.units) == len(before)
        assert not judge(reading)[0]
