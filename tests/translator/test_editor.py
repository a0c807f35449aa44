"""The symbols, completions and meanings of a text, and its errors for an editor."""

import json
import re
import weakref
from pathlib import Path

from prosim_scene.editor.symbols import Symbol, Symbols, description
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


def labels(text):
    """The completions at the bar in a text."""
    at = text.index("|")
    _, found = Symbols(text.replace("|", "", 1)).completions(at)
    return [one.label for one in sorted(found, key=lambda one: one.sort_text[0])]


def test_text_with_an_error_is_freed_at_once():
    """A later garbage collection, after several keystrokes, would be a pause."""
    symbols = Symbols("SURFACE 0 kd x SURFACE 1 kd {1 +} END")
    reader = weakref.ref(symbols.reader)
    assert symbols.diagnostics
    del symbols
    assert reader() is None


def test_completion_offers_words_that_fit():
    assert {"leg", "CUBE"} <= set(labels("SOLID leg CUBE 1 CSG-TREE | END"))
    assert labels("|")[:2] == ["DEFAULT", "NAME"] and "END" in labels("SUR|")
    assert labels(SCENE.replace("CUBE 0", "CUBE |"))[:2] == ["0", "1"]
    assert labels(SCENE.replace("CUBE 0", "CU|"))[:4] == ["CUBE", "SPHERE", "CYLINDER", "CONE"]
    assert labels(SCENE.replace("SURFACE 1", "SURFACE |"))[0] == "1"
    assert {"t-brick", "t-mine", "NULL"} <= set(labels(SCENE.replace("t-listra", "t-|")))
    assert {"ouro", "cobre", "cu_palik"} <= set(labels(SCENE.replace("ouro", "o|")))
    assert "diamante" in labels("SURFACE 0 material dieletrico |")
    assert labels("SURFACE 0 material |")[:4] == ["conductor", "dielectric", "lambertian", "composite"]
    assert labels("SUPERFICIE 0 material |")[:4] == ["condutor", "dieletrico", "lambertiano", "composto"]
    assert labels("LIGHTS AREA |")[3:6] == ["position", "Intensity", "radius"]
    assert labels("LUZES EXTENSA |")[3:6] == ["posicao", "intensidade", "raio"]
    assert labels("LIGHTS AREA raio 2 VIEW |\nOBS 0 0 9 END")[:3] == ["RESOLUTION", "WINDOW", "OBS"]
    assert {"NULO", "t-tijolo"} <= set(labels("FUNDO 0 0 0 CSG CUBO 0 t|"))
    assert labels(SCENE.replace("ks 0", "k|"))[:3] == ["material", "metal", "ka"]
    assert labels("METHOD |")[:5] == ["adaptive", "fresnel", "facets", "phong", "threshold"]
    assert labels("METODO facetas |")[:2] == ["beckmann", "gaussiana"]
    assert labels("DO-SHADOW |")[:2] == ["TRUE", "FALSE"]
    assert labels(SCENE.replace("$turn / 60", "s|"))[:4] == ["$frame", "$time", "$turn", "sin"]
    assert labels(SCENE.replace("ks 0", "ks |")) == ["$frame", "$time", "$turn"]
    for inside in SCENE.replace("remark", "re|m"), SCENE.replace("(one)", "(o|)"), SCENE + "x|", "NAME: |":
        assert not set(labels(inside)) & {"kd", "CUBE", "END"}


def test_hovering_shows_meanings():
    symbols = Symbols(SCENE)
    for word, shift, expected in (
        ("raio", 0, "**radius** the radius"),
        ("kd", 0, "each a number from 0 to 1"),
        ("ROTATE-Y", 0, "degrees"),
        ("0 t-l", 0, "SURFACE 0 material condutor ouro m = .1\nTRANSFORM 0"),
        ("t-listra", 0, "stripes"),
        ("ouro", 0, "The metal **Au**\n\nNames: gold, au, ouro"),
        ("$turn / 3", 0, "= 30"),
        ("+ CUBE", 0, "union"),
    ):
        start, end, text = symbols.hover(SCENE.index(word) + shift)
        assert start <= SCENE.index(word) + shift < end and expected in text
    assert "1.5168" in Symbols("SURFACE 0 material dieletrico BK7 END").hover(30)[2]
    assert Symbols("SURFACE 0 material condutor ouros END").hover(30)[2] == "no metal has this name"
    assert symbols.hover(SCENE.index("remark")) is None


def test_every_word_has_a_meaning():
    for word in WORDS:
        assert word.meaning and description(word).startswith(f"**{word.canonical}**")


def test_references_find_every_use_of_a_symbol():
    text = """DEFAULT $a = 1 DEFAULT $ab = 2
CSG-TREE + CUBE: 07 + ESFERA (the (7) one) 7 - CONE # 7
7 CYLINDER={$a+$ab} t-7 SURFACE(a)7 kd {$a} 7 TRANSFORM 7 SCALE 7 7 7 TRANSFORM = 77
SURFACE 70 TEXTURE t-7 stripes seed 7 END 7"""
    for mark in ("\n", "\r\n"):
        symbols = Symbols(text.replace("\n", mark))
        assert len(symbols.table) == 6 and len(symbols.table[Symbol("index", "7")]) == 5


def test_the_grammar_of_editors_has_the_words_of_the_language():
    path = Path(__file__).parents[2] / "editors" / "vscode" / "syntaxes" / "scn.tmLanguage.json"
    patterns = [re.compile(one["match"]) for one in json.loads(path.read_text())["patterns"] if "match" in one]
    for word in WORDS:
        for spelling in word.spellings:
            assert any((found := pattern.match(spelling)) and found.end() == len(spelling) for pattern in patterns)
