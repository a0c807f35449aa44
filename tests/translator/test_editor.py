"""What an editor is told of a text: errors, completions, meanings, symbols."""

import json
import re
from pathlib import Path

import prosim_scene
import pytest
from prosim_scene import descriptions
from prosim_scene.evaluation import evaluate
from prosim_scene.language.analysis import analyse
from prosim_scene.language.diagnostics import MOST
from prosim_scene.language.words import METALS, WORDS
from prosim_scene.symbols import Symbol, Symbols

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
    _, found, document = analyse(text)
    return sorted((one.start, one.end, one.reason, one.error) for one in found), document and document.scene


def labels(text):
    """What fits at the bar in a text."""
    at = text.index("|")
    found = Symbols(text.replace("|", "", 1)).completions(at)
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
    assert scene is None and found[-1][2] == caught.value.reason and found[-1][0] == caught.value.span.start


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
    _, found, document = analyse(SCENE.replace("LIGHTS AREA", "# LIGHTS AREA"))
    assert [(one.reason, one.error) for one in found] == [("the scene has no lights", False)]
    hidden = SCENE.replace("- SPHERE 1 CYLINDER 1", "SPHERE 1").replace(
        "SCALE 2 2 2", "SCALE .1 .1 .1 TRANSLATE .5 .5 .5"
    )
    _, found, document = analyse(hidden)
    assert not found and [one.reason for one in evaluate(document, None)] == [
        "nothing is seen of SPHERE 1 (line 5): no face of it is left in the result"
    ]


def test_of_very_many_wrong_statements_the_first_are_told_and_nothing_that_follows():
    found, _ = told("CSG-TREE CUBE 999\n" + "".join(f"SURFACE {i} kd 2\n" for i in range(200)))
    assert {reason.split(";")[0] for *_, reason, _ in found} == {"found '2' after kd"} and len(found) == MOST + 1


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
    symbols = Symbols(SCENE)

    def said(word, shift=0):
        start, end, text = symbols.hover(SCENE.index(word) + shift)
        assert start <= SCENE.index(word) + shift < end
        return text

    assert said("raio").startswith("**raio** the radius\n\nRadius of the sphere") and "radius" in said("raio")
    assert (
        "each 0 or more, 1 at most" in said("kd") and "in degrees" in said("ROTATE-Y") and "degrees" in said("ROTATE-Y")
    )
    assert "SURFACE 0 material condutor ouro" in said("0 t-l") and "TRANSFORM 0" in said("0 t-l")
    assert "Stripes" in said("t-listra") and "Au" in said("ouro") and "= 30" in said("$turn / 3")
    assert "1.5168" in Symbols("SURFACE 0 material dieletrico BK7 END").hover(30)[2]
    assert "union" in said("+ CUBE") and symbols.hover(SCENE.index("remark")) is None


def test_a_metal_says_what_it_is():
    said = Symbols(SCENE).hover(SCENE.index("ouro"))[2]
    assert said.split("\n\n") == [
        "**gold**, the table Au",
        "Yellow: of white light that falls straight on it reflects 1.02 0.78 0.34 (red, green, blue)",
        "n = 0.239 and k = 2.97 at 589.3 nm; measured from 299 to 886 nm",
        "From: luxpop.com, which names no source",
        "Also: gold, au",
    ]
    assert set(descriptions.MEASURED) == set(METALS.values())
    wrong = SCENE.replace("ouro", "ouros")
    assert Symbols(wrong).hover(wrong.index("ouros"))[2] == "a metal that nobody knows"
    colours = {
        name: descriptions.colour(descriptions.MEASURED[METALS[name]].rgb)
        for name in ("cu", "ag", "cr", "ni", "be", "ta")
    }
    assert list(colours.values()) == ["red", "white", "bluish light grey", "yellowish grey", "grey", "violet dark grey"]
    (gold,) = [one for one in Symbols(SCENE).completions(SCENE.index("ouro")) if one.label == "ouro"]
    assert gold.detail == "Au" and gold.documentation == said


def test_every_word_has_a_meaning():
    for word in WORDS:
        assert descriptions.of_word(word).startswith(f"**{word.canonical}**")
    assert set(descriptions.MEANINGS) == {(word.role, word.name) for word in WORDS}


def test_symbols_are_found_and_renamed():
    symbols = Symbols(SCENE)
    here = symbols.at(SCENE.index("SPHERE 1") + 7)
    defined = [one for one in symbols.occurrences(here.symbol) if one.defines]
    assert [SCENE[: one.start].count("\n") for one in defined] == [7, 9]
    for word, shift, new, count in (("SPHERE 1", 7, "7", 4), ("$turn", 1, "$angle", 4), ("t-mine", 2, "t-yours", 1)):
        here = symbols.at(SCENE.index(word) + shift)
        found = symbols.renamed(here.symbol, new)
        assert len(found) == count
        text = SCENE
        for one in reversed(found):
            text = text[: one.start] + new + text[one.end :]
        assert told(text)[1] is not None and here.symbol not in Symbols(text).table
        assert [len(one) for one in Symbols(text).table.values()] == [len(one) for one in symbols.table.values()]


def test_a_symbol_is_found_wherever_it_may_stand():
    text = """DEFAULT $a = 1 DEFAULT $ab = 2
CSG-TREE + CUBE: 07 + ESFERA (the (7) one) 7 - CONE # 7
7 CYLINDER={$a+$ab} t-7 SURFACE(a)7 kd {$a} 7 TRANSFORM 7 SCALE 7 7 7 TRANSFORM = 77
SURFACE 70 TEXTURE t-7 stripes seed 7 END 7"""
    for mark in ("\n", "\r\n"):
        symbols = Symbols(text.replace("\n", mark))
        assert len(symbols.table) == 6 and len(symbols.occurrences(Symbol("index", "7"))) == 5


@pytest.mark.parametrize(
    "word, new, says",
    [("0 t-l", "1", "there already"), ("0 t-l", "x", "no index"), ("t-listra", "stripes", "t- and a word"),
     ("$turn", "a-b", "cannot be a name")],
)  # fmt: skip
def test_what_cannot_be_renamed(word, new, says):
    symbols = Symbols(SCENE)
    here = symbols.at(SCENE.index(word))
    with pytest.raises(ValueError, match=says):
        symbols.renamed(here.symbol, new)


def test_the_grammar_of_editors_has_the_words_of_the_language():
    path = Path(__file__).parents[2] / "editors" / "vscode" / "syntaxes" / "scn.tmLanguage.json"
    patterns = [re.compile(one["match"]) for one in json.loads(path.read_text())["patterns"] if "match" in one]
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
